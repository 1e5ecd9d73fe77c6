"""Report of a table: text for the terminal or Markdown, and an HTML page with film strips, beside the figures of the paper."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from gibson_sim_bench.path_following.plan import method_text, parts_of
from gibson_sim_bench.path_following.table import Cell, Difference, Table2
from gibson_sim_bench.reports.render import table
from gibson_sim_learn.path_following.domains import DOMAINS

PAPER = {6.6: (0.90, 0.983), 8.4: (0.80, 0.867), 12.7: (0.80, 0.933)}
"""Length, metres -> success rate and coverage of the paper's Table 2, on a real robot, ten trials each."""
PAPER_TRIALS = 10
NOT_COMPARABLE = (
    "The paper's robot was real: these figures are sim-to-sim. Nothing here shows how a follower does on a robot.",
    "The paper has ten trials for each length (9 of 10: an interval of 0.60 to 0.98); it gives neither intervals nor baselines.",
    "The paper's robot had two fisheye cameras that see all around; ours has one pinhole camera of 100 degrees unless --camera says otherwise.",
    "Lengths are those of the paper; places, turns and furniture are others.",
    "The paper does not count what touches the robot apart from success; here any touch of anything but the floor is a failure.",
    "Intervals take runs for independent; the runs of a case share a few paths, so that another draw of paths can differ by more.",
)
_HEAD = (
    "case",
    "domain",
    "method",
    "runs",
    "success",
    "95 % interval",
    "coverage",
    "collisions/m",
    "SPL",
    "deviation m",
    "place within a node",
    "s of CPU",
)
_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}"
    "td:nth-child(-n+3),th:nth-child(-n+3){text-align:left}img{max-width:100%;border:1px solid #ccc}figure{margin:1.2em 0}"
)


def report_text(found: Table2, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    parts = ["\n".join(f"- {line}" if markdown else line for line in _facts(found))]
    for title, head, body, left in _tables(found):
        parts += [f"## {title}" if markdown else f"{title}:", table(head, body, markdown, left=left)]
    parts += ["## What is not comparable" if markdown else "What is not comparable:"]
    parts.append("\n".join(f"- {line}" for line in NOT_COMPARABLE))
    return "\n\n".join(parts)


def report_page(found: Table2, strips: Mapping[str, Path], folder: Path) -> str:
    """Returns the page.

    Args:
        found: the table.
        strips: film strips by their captions.
        folder: of the page, which links to them.
    """
    parts = ["<h1>Following paths by images: sim-to-sim</h1>", _items(_facts(found))]
    for title, head, body, _ in _tables(found):
        rows = "".join(_html_row(row, "td") for row in body)
        parts.append(f"<h2>{html.escape(title)}</h2><table>{_html_row(head, 'th')}{rows}</table>")
    parts.append(f"<h2>What is not comparable</h2>{_items(NOT_COMPARABLE)}")
    if strips:
        parts.append(
            "<h2>Film strips</h2><p>Above: what the camera saw. Below: the recorded images nearest to there. Map: recorded blue, driven red, "
            "the first collision a ring, moved objects orange, obstacles on the path pink.</p>"
        )
    for caption, file in strips.items():
        link = html.escape(file.relative_to(folder).as_posix())
        parts.append(
            f'<figure><figcaption>{html.escape(caption)}</figcaption><img src="{link}" alt="{html.escape(caption)}"></figure>'
        )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Table 2, sim-to-sim</title><style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>\n"
    )


def _facts(found: Table2) -> list[str]:
    plan = found.plan
    lines = [
        f"{found.machine}; {found.cores} cores usable; Gibson Sim {found.version}; {found.date[:10]}.",
        f"{found.runs} of {found.planned} runs; scenes {', '.join(plan['scenes'])}; {plan['paths']} paths a case; seed {plan['seed']}; "
        f"camera {plan['camera']}.",
        "Success: within 0.5 m of the end, and nothing touched. Coverage: share of the path's places that the robot came within 0.5 m of.",
        *(f"{name}: {method_text(name)}{_digest(found, name)}." for name in plan["methods"]),
        *(f"{name}: {DOMAINS[name].text}." for name in plan["domains"]),
    ]
    return [*lines, *(f"Failed: {line}" for line in found.errors)]


def _digest(found: Table2, method: str) -> str:
    digest = {"learned": found.policy, "goggles": found.goggles}.get(parts_of(method)[1] or method, "")
    return f" ({digest})" if digest else ""


def _tables(found: Table2) -> list[tuple[str, Sequence[str], Sequence[Sequence[str]], Sequence[int]]]:
    """Returns title, head, rows and left-aligned columns of each table."""
    out: list[tuple[str, Sequence[str], Sequence[Sequence[str]], Sequence[int]]] = [
        ("Runs", _HEAD, [_cell(cell) for cell in found.cells] + _paper(found), (0, 1, 2))
    ]
    if found.differences:
        head = ("domain", "case", "pair", "pairs", "difference", "95 % interval", "only first", "only second")
        out.append(("Paired differences of success", head, [_difference(one) for one in found.differences], (0, 1, 2)))
    kinds = [(f"{c.length:g} m", c.domain, c.method, kind, str(count)) for c in found.cells for kind, count in c.kinds.items()]
    if kinds:
        out.append(("Kinds of failure", ("case", "domain", "method", "what", "runs"), kinds, (0, 1, 2, 3)))
    return out


def _cell(cell: Cell) -> tuple[str, ...]:
    return (
        f"{cell.length:g} m",
        cell.domain,
        cell.method,
        str(cell.runs),
        f"{cell.rate:.2f}",
        f"{cell.low:.2f} to {cell.high:.2f}",
        f"{cell.coverage:.3f}",
        f"{cell.collisions_per_metre:.3f}",
        f"{cell.spl:.2f}",
        f"{cell.deviation:.3f}",
        "-" if math.isnan(cell.near_places) else f"{cell.near_places:.3f}",
        f"{cell.seconds:.1f}",
    )


def _paper(found: Table2) -> list[tuple[str, ...]]:
    lengths = sorted({cell.length for cell in found.cells})
    return [
        (
            f"{length:g} m",
            "real robot",
            "the paper",
            str(PAPER_TRIALS),
            f"{PAPER[length][0]:.2f}",
            "-",
            f"{PAPER[length][1]:.3f}",
            *5 * ("-",),
        )
        for length in lengths
        if length in PAPER
    ]


def _difference(one: Difference) -> tuple[str, ...]:
    return (
        one.domain,
        "all" if math.isnan(one.length) else f"{one.length:g} m",
        f"{one.method} minus {one.other}",
        str(one.pairs),
        f"{one.value:+.2f}",
        f"{one.low:+.2f} to {one.high:+.2f}",
        str(one.better),
        str(one.worse),
    )


def _html_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _items(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{html.escape(line)}</li>' for line in lines)}</ul>"
