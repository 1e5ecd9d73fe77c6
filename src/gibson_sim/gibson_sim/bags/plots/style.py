"""Style of the plots of bags, and the check for matplotlib, which is optional."""

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

PAGE_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; color: #111827; background: #fff; margin: 2em auto; padding: 0 1.2em; }
h1 { font-size: 1.6em; margin: 0 0 .2em; }
h2 { font-size: 1.2em; margin: 2em 0 .4em; border-bottom: 1px solid #e5e7eb; padding-bottom: .2em; }
.quiet { color: #4b5563; margin: .2em 0 .6em; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .28em .7em; border-bottom: 1px solid #e5e7eb; }
th { font-weight: 600; color: #374151; border-bottom: 2px solid #9ca3af; }
td.number, th.number { text-align: right; white-space: nowrap; }
code { font: .92em ui-monospace, Menlo, Consolas, monospace; }
svg { width: 100%; height: auto; }
"""
"""Style sheet of all pages about bags; each adds its own rules."""


def require_matplotlib(what: str, instead: str = "") -> None:
    """Checks that matplotlib is installed.

    Args:
        what: feature that needs it, as the subject of a sentence.
        instead: alternative for the user, as the end of the message.

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
        dpi: pixels per inch of a PNG, and of images in an SVG.
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
