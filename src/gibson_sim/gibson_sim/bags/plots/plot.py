"""Writes the plots of a bag: all panels in one PNG, or one self-contained HTML page."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.bags.check import BagReport, check_bag
from gibson_sim.bags.plots import panels
from gibson_sim.bags.plots.load import load_run
from gibson_sim.bags.plots.run_data import RecordedRun
from gibson_sim.bags.plots.style import PAGE_STYLE, drawn, require_matplotlib, svg_element
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S
from gibson_sim.writing import write_file

SUFFIXES = (".png", ".html")
_WIDTH = 15.0
"""Width of a picture, inches."""
_PAGE_STYLE = (
    PAGE_STYLE
    + """
body { max-width: 1180px; }
ul { margin: .8em 0; padding-left: 1.2em; } li.contact { color: #b91c1c; } li.problem { color: #b91c1c; font-weight: 600; }
.scroll { overflow-x: auto; }
td.some { color: #b91c1c; font-weight: 600; }
svg { display: block; } svg.path { max-width: 760px; margin: 0 auto; }
"""
)


def check_name(path: Path) -> None:
    """Checks the name of a file to write.

    Raises:
        ConfigError: its suffix is neither .png nor .html.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"bag plot {quoted(str(path))}: the name must end in {' or '.join(SUFFIXES)}")


def write_plots(bag: Path, paths: list[Path], robot: str = "", created: str = "") -> list[Path]:
    """Writes the plots of a bag to files; returns their paths.

    Args:
        bag: folder of the bag.
        paths: files, each a PNG or an HTML page by its suffix; their folders are created if they do not exist.
        robot: namespace of the only robot to show; empty = all.
        created: line at the end of a page.

    Raises:
        RecordError: the bag cannot be read.
        ConfigError: the bag has no such robot, or a suffix is not known.
        EnvironmentProblemError: matplotlib is missing.
        WriteError: a file cannot be written.
    """
    for path in paths:
        check_name(path)
    require_matplotlib("a plot")
    run = load_run(bag, robot)
    report = check_bag(bag) if any(path.suffix.lower() == ".html" for path in paths) else None
    for path in paths:
        write_file(path, plots_png(run) if report is None or path.suffix.lower() == ".png" else plots_page(run, report, created))
    return paths


def plots_png(run: RecordedRun) -> bytes:
    """Returns all panels in one PNG."""
    lines, rows = len(panels.velocity_parts(run)), len(panels.contact_rows(run))
    topics = min(len(run.arrivals), panels.MOST_TOPICS)
    above, below = max(6.6, 2.1 * lines + 0.5 + 0.24 * max(rows, 2)), 0.9 + 0.19 * max(topics, 2)
    beside = float(np.clip(0.85 * above * panels.path_aspect(run) + 0.8, 4.5, 8.0))

    def draw(figure: Any) -> None:
        top, bottom = figure.subfigures(2, 1, height_ratios=[above, below])
        left, right = top.subfigures(1, 2, width_ratios=[beside, _WIDTH - beside])
        panels.draw_paths(left.subplots(), run)
        draw_motion(right, run)
        _draw_rates(bottom, run, is_titled=True)

    return drawn((_WIDTH, above + below + 0.4), draw, form="png")


def plots_page(run: RecordedRun, report: BagReport, created: str = "") -> str:
    """Returns one HTML page without references to other files: findings, panels as SVG, a table of all topics."""
    parts = panels.velocity_parts(run)
    rows, topics = len(panels.contact_rows(run)), min(len(run.arrivals), panels.MOST_TOPICS)
    path = _svg("path", (8.6, 8.0), lambda figure: panels.draw_paths(figure.subplots(), run))
    motion = _svg("motion", (11.0, 2.0 * len(parts) + 0.9 + 0.24 * max(rows, 2)), lambda figure: draw_motion(figure, run))
    over_time = _svg("rates", (11.0, 0.9 + 0.2 * max(topics, 2)), lambda figure: _draw_rates(figure, run, is_titled=False))
    findings = "".join(_finding(line) for line in (*report.findings(), *(f"note: {note}" for note in run.notes)))
    count = sum(topic.info.count for topic in report.topics)
    head = (
        f"<h1>{html.escape(run.folder.resolve().name)}</h1>"
        f'<p class="quiet"><code>{html.escape(str(run.folder))}</code> · {run.end - run.begin:.1f} s · {count:,} messages on '
        f"{len(report.topics)} topics · {html.escape(run.time_label)}</p><ul>{findings}</ul>"
    )
    body = (
        f"{head}<h2>Path</h2>{_caption(_PATH_CAPTION)}{path}"
        f"<h2>Velocities and contacts</h2>{_caption(_MOTION_CAPTION)}{motion}"
        f"<h2>Rates of topics</h2>{_caption(_RATES_CAPTION)}{over_time}"
        f'<h2>Topics</h2><div class="scroll">{_table(report)}</div>'
    )
    footer = f'<p class="quiet">{html.escape(created)}</p>' if created else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{html.escape(run.folder.resolve().name)}</title>'
        f"<style>{_PAGE_STYLE}</style></head><body>{body}{footer}</body></html>\n"
    )


_PATH_CAPTION = (
    "A dot is the start, a triangle the end and its heading; red dots are contacts, with the numbers that they have below."
)
_MOTION_CAPTION = (
    "Commanded, by wheel odometry, and ground truth, where recorded. Red: the robot is in contact. A long rest at the "
    "end is left out."
)
_RATES_CAPTION = "Darker is more messages than usual in that time, white is none; the number is the usual rate."


def draw_motion(figure: Any, run: RecordedRun) -> None:
    """Draws velocities and contacts above one another, over the same time."""
    parts, rows = panels.velocity_parts(run), len(panels.contact_rows(run))
    axes = figure.subplots(len(parts) + 1, 1, sharex=True, height_ratios=[2.0] * len(parts) + [0.3 + 0.24 * max(rows, 2)])
    for axis, (part, label) in zip(axes[:-1], parts, strict=True):
        panels.draw_velocities(axis, run, part, label)
    panels.draw_legend(figure, axes[0], run)
    axes[0].set_title("Velocities")
    panels.draw_contacts(axes[-1], run)
    end = panels.motion_limits(run)[1]
    rest = f"; at rest from {end - panels.IDLE_MARGIN_S:.1f} s to the end at {run.end:.1f} s" if end < run.end else ""
    axes[-1].set(title="Contacts", xlabel=f"{run.time_label}{rest}")


def _draw_rates(figure: Any, run: RecordedRun, *, is_titled: bool) -> None:
    axis = figure.subplots()
    panels.draw_rates(axis, run)
    left_out = len(run.arrivals) - panels.MOST_TOPICS
    axis.set(xlabel=run.time_label)
    if is_titled or left_out > 0:
        axis.set_title(f"Rates of topics{f' ({left_out} more are left out)' if left_out > 0 else ''}")


def _svg(name: str, size: tuple[float, float], draw: Any) -> str:
    element = svg_element(drawn(size, draw, form="svg").decode(), name)
    return element.replace("<svg", f'<svg class="{name}" role="img"', 1)


def _caption(text: str) -> str:
    return f'<p class="quiet">{html.escape(text)}</p>'


def _finding(line: str) -> str:
    kind = "contact" if line.startswith("contact:") else "problem" if line.startswith("PROBLEM:") else ""
    return f"<li{f' class={chr(34)}{kind}{chr(34)}' if kind else ''}>{html.escape(line)}</li>"


def _table(report: BagReport) -> str:
    heads = ("topic", "messages", "rate, Hz", "missing", "first, s", "last, s")
    lines = [f"<tr>{''.join(f'<th{_NUMBER * (i > 0)}>{name}</th>' for i, name in enumerate(heads))}</tr>"]
    for topic in report.topics:
        count = topic.info.count
        cells = [
            str(count),
            f"{topic.rate_hz:.2f}" if topic.rate_hz else "–",
            "–" if topic.missing is None else str(topic.missing),
            *(f"{time_ns / NS_PER_S:.3f}" if count else "–" for time_ns in (topic.first_ns, topic.last_ns)),
        ]
        numbers = "".join(
            f'<td class="number{" some" if i == 2 and topic.missing else ""}">{cell}</td>' for i, cell in enumerate(cells)
        )
        lines.append(f"<tr><td><code>{html.escape(topic.info.name)}</code></td>{numbers}</tr>")
    return f"<table>{''.join(lines)}</table>"


_NUMBER = ' class="number"'
