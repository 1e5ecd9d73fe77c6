"""Plots of the reports, with matplotlib, which is optional."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.writing import replacing
from gibson_sim_bench.reports.paper import MODES
from gibson_sim_bench.rows import FREE, HOST, IN_PROCESS, LOCKSTEP, Table1
from gibson_sim_bench.scaling import KINDS, ScalingReport
from gibson_sim_bench.soak import SoakReport

_COLORS = {IN_PROCESS: "#1b6ca8", LOCKSTEP: "#e07b39", FREE: "#5b8c5a"}


def require_matplotlib() -> None:
    """Checks that matplotlib is installed.

    Raises:
        ConfigError: it is not.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise ConfigError("plots need matplotlib: pip install 'gibson_sim[analysis]'")


def _figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def plot_table1(report: Table1, path: Path) -> None:
    """Plots the rates of all modes, configurations and numbers of substeps, beside those of the paper."""
    rows = [row for row in report.rows if row.substeps and row.to == HOST]
    counts = sorted({row.substeps for row in rows}, reverse=True)
    figure, axes = _figure(4.2 * max(1, len(counts)), 3.6, columns=max(1, len(counts)))
    names = [mode.name for mode in MODES]
    for axis, substeps in zip(axes[0], counts, strict=False):
        for offset, way in zip((-0.25, 0.0, 0.25), _COLORS, strict=True):
            here = {row.mode: row.fps for row in rows if (row.substeps, row.way) == (substeps, way)}
            places = [k + offset for k, name in enumerate(names) if name in here]
            axis.barh(places, [here[name] for name in names if name in here], height=0.23, color=_COLORS[way], label=way)
        paper = [(k, mode.v2) for k, mode in enumerate(MODES) if mode.v2 is not None]
        axis.plot([v2 for _, v2 in paper], [k for k, _ in paper], "k|", markersize=22, label="paper, GTX 1080 Ti")
        axis.set_xscale("log")
        axis.set_yticks(range(len(names)), names if axis is axes[0][0] else [""] * len(names))
        axis.invert_yaxis()
        axis.set_title(f"{substeps} physics step{'s' if substeps > 1 else ''} a frame", fontsize=10)
        axis.set_xlabel("frames/s")
        axis.grid(axis="x", alpha=0.3)
    if counts:
        figure.legend(*axes[0][0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=4)
    with replacing(path) as draft:
        figure.savefig(draft)


def plot_scaling(report: ScalingReport, path: Path) -> None:
    """Plots time and memory against each quantity."""
    kinds = [kind for kind in KINDS if any(row.kind == kind.name for row in report.rows)]
    columns = min(4, max(1, len(kinds)))
    figure, axes = _figure(3.2 * columns, 2.8 * -(-len(kinds) // columns), -(-len(kinds) // columns), columns)
    cells = axes.ravel()
    for axis, kind in zip(cells, kinds, strict=False):
        rows = [row for row in report.rows if row.kind == kind.name]
        together = kind.name in ("environments", "processes")
        axis.plot([r.value for r in rows], [r.per_s if together else r.ms for r in rows], "o-", color="#1b6ca8")
        axis.set_ylabel("steps/s, all together" if together else "ms", color="#1b6ca8")
        axis.set_ylim(0.0, 1.15 * max(r.per_s if together else r.ms for r in rows))
        axis.set_xlabel(kind.name)
        if len(rows) > 2 and rows[-1].value > 10 * max(1, rows[0].value):
            axis.set_xscale("symlog")
        axis.set_xticks([r.value for r in rows], [_short(r.value) for r in rows])
        axis.minorticks_off()
        memory = axis.twinx()
        memory.plot([r.value for r in rows], [r.mb for r in rows], "s--", color="#e07b39", markersize=3, linewidth=1)
        memory.set_ylabel("MB", color="#e07b39")
        memory.set_ylim(0.0, 1.15 * max(r.mb for r in rows))
        axis.grid(alpha=0.3)
    for axis in cells[len(kinds) :]:
        axis.set_visible(False)
    with replacing(path) as draft:
        figure.savefig(draft)


def _short(value: int) -> str:
    """Returns 100 k for 100,000."""
    return f"{value // 1_000_000} M" if value >= 1_000_000 else f"{value // 1_000} k" if value >= 10_000 else str(value)


def plot_soak(report: SoakReport, path: Path) -> None:
    """Plots memory and rates of both parts over time."""
    figure, axes = _figure(9.0, 5.0, 2, 2)
    for column, (title, samples) in enumerate((("environment steps", report.environment), ("free-running", report.running))):
        for row, (ending, label) in enumerate(((" MB", "resident MB"), (" /s", "a second, of its median"))):
            axis = axes[row][column]
            for name, values in samples.values.items():
                if name.endswith(ending):
                    axis.plot(
                        _minutes(samples.seconds, len(values)),
                        _scaled(values, ending),
                        label=name.removesuffix(ending),
                        linewidth=1,
                    )
            axis.set_ylabel(label)
            top = axis.get_ylim()[1]
            axis.set_ylim(0.0, 1.1 * top)
            axis.grid(alpha=0.3)
            if axis.lines:
                axis.legend(fontsize=7)
        axes[0][column].set_title(title, fontsize=10)
        axes[1][column].set_xlabel("minutes")
    with replacing(path) as draft:
        figure.savefig(draft)


def _minutes(seconds: Sequence[float], count: int) -> list[float]:
    """Returns the times of ``count`` samples, minutes: rates may have a few samples more or fewer than memory."""
    last = seconds[-1] if seconds else float(count)
    return [last * (k + 1) / count / 60.0 for k in range(count)]


def _scaled(values: Sequence[float], ending: str) -> list[float]:
    if ending == " MB":
        return list(values)
    middle = sorted(values)[len(values) // 2] or 1.0
    return [value / middle for value in values]
