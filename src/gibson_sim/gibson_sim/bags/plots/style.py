"""The look of plots of bags, and matplotlib, which is optional."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

from gibson_sim.errors import EnvironmentProblemError

STYLE = {
    "font.family": "sans-serif", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#e5e7eb", "axes.axisbelow": True, "axes.edgecolor": "#6b7280", "legend.frameon": False, "svg.fonttype": "none",
    "svg.hashsalt": "gibson_sim", "axes.titlesize": 11, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "path.simplify_threshold": 0.5,
}  # fmt: skip
"""Settings of matplotlib for all plots."""


def require_matplotlib(what: str, instead: str = "") -> None:
    """Checks that matplotlib is installed.

    Args:
        what: needs it, as the subject of a sentence.
        instead: what else the user can do, as the end of a sentence.

    Raises:
        EnvironmentProblemError: it is missing.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise EnvironmentProblemError(
            f"{what} needs matplotlib, which is not installed: `pip install 'gibson_sim[analysis]'`{instead}"
        ) from error


def drawn(size: tuple[float, float], draw: Callable[[Any], None], *, form: str, dpi: float = 120.0) -> bytes:
    """Returns the file of a figure in the common style.

    Args:
        size: width and height, inches.
        draw: receives the figure, whose layout is constrained.
        form: ``svg`` or ``png``.
        dpi: pixels an inch of a PNG, and of images in an SVG.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained", dpi=dpi)
        draw(figure)
        file = io.BytesIO()
        metadata = {"Date": None} if form == "svg" else None
        figure.savefig(file, format=form, dpi=dpi, metadata=metadata, bbox_inches="tight", pad_inches=0.12)
    return file.getvalue()


def svg_element(text: str, prefix: str) -> str:
    """Returns the ``<svg>`` element of a file, its ids made unique on a page by a prefix."""
    svg = text[text.index("<svg") :]
    return re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{prefix}-", svg)
