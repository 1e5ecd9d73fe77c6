"""The HTML page of a trial: a self-contained file without scripts, safe for any output of a stack."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from gibson_sim.quoting import duration_text
from gibson_sim.reading import read_file
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.keeping import FILM, PICTURES
from gibson_sim.trials.report.log_tail import CONTROL, log_tail
from gibson_sim.trials.report.maps import SceneMap, map_svg, scene_map
from gibson_sim.trials.report.page_style import STYLE
from gibson_sim.trials.report.paths import read_path
from gibson_sim.trials.report.results import Rate, TrialResults
from gibson_sim.trials.report.words import (
    can_be_replayed,
    reason,
    replay_command,
    rerun_command,
    robot_name,
    route_text,
    scene_name,
    seconds_of,
)
from gibson_sim.trials.run_folder import BAG, RESULTS, SIMULATION_LOG, STACK_LOG, run_folder

FILE = "index.html"
_INITIALLY_OPEN = 3
"""Number of failed runs whose details are initially open."""
_MAX_PICTURES = 24_000_000
"""Largest total size of the page's pictures, bytes; pictures of later runs are omitted."""
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Content security policy: the page may load only embedded content."""


def trial_page(
    trial: TrialResults,
    folder: Path,
    options: Sequence[str] = (),
    created: str = "",
    maps: dict[str, SceneMap | None] | None = None,
) -> str:
    """Returns the page as HTML.

    Args:
        trial: the results.
        folder: folder of the trial, with the logs, paths and pictures of its runs.
        options: command-line options that affect the plan.
        created: last line of the page.
        maps: maps of the scenes by their names in the scenario; None = created from the scenes.
    """
    parts = [_head(trial), _comparison(trial), _groups(trial), _verdicts(trial), _causes(trial)]
    parts += [_maps(trial, folder, maps), _failures(trial, folder, options), _all_runs(trial), _about(trial)]
    footer = f'<p class="quiet">{_text(created)}</p>' if created else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{html.escape(_POLICY)}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{_text(trial.name)}: {_text(_short(trial.rate))}</title>'
        f"<style>{STYLE}</style></head><body>{''.join(parts)}{footer}</body></html>\n"
    )


def _text(value: str) -> str:
    """Returns a text escaped for HTML, without control characters and without lone surrogates, which UTF-8 cannot encode."""
    return html.escape(CONTROL.sub("�", value).encode("utf-8", errors="replace").decode())


def _short(rate: Rate) -> str:
    return f"{rate.passed} of {rate.count} passed"


def _percent(part: float) -> str:
    return f"{100.0 * part:.0f} %"


def _bar(rate: Rate) -> str:
    """Returns the rate as a mark and its interval as a bar."""
    low, high = rate.interval
    at = rate.passed / rate.count if rate.count else 0.0
    mark = f'<b style="left:{100 * at:.1f}%"></b>' if rate.count else ""
    return f'<span class="rate" aria-hidden="true"><i style="left:{100 * low:.1f}%;width:{100 * (high - low):.1f}%"></i>{mark}</span>'


def _head(trial: TrialResults) -> str:
    rate, outcomes = trial.rate, [result.outcome for result in trial.results]
    low, high = rate.interval
    facts = [
        f"<code>{_text(trial.file)}</code>",
        _text(trial.started.replace("T", " ").partition("+")[0] + " UTC") if trial.started else "",
        _text(trial.mode),
        f"{duration_text(trial.wall_time)} of wall time" if trial.wall_time else "",
        f"{duration_text(sum(max(o.end_ns, 0) for o in outcomes) / 1e9)} simulated",
    ]
    quiet = " · ".join(fact for fact in facts if fact)
    percent = (
        f" ({_percent(rate.passed / rate.count)}; 95 % interval {100 * low:.0f} to {100 * high:.0f} %)" if rate.count else ""
    )
    early = (
        ""
        if trial.is_complete
        else f'<p class="bad">Ended early: {rate.count} of {trial.planned} planned runs were executed.</p>'
    )
    real_time = (
        '<p class="quiet">In real time: a run with the stack differs each time. The replay of its bag is exact, bit for bit.</p>'
        if "real time" in trial.mode
        else ""
    )
    return (
        f'<h1>{_text(trial.name)}</h1><p class="quiet">{quiet}</p>'
        f'<p class="total"><b>{rate.passed} of {rate.count}</b> runs passed{percent}{_bar(rate)}</p>{early}{real_time}'
    )


def _links(trial: TrialResults, numbers: Iterable[int]) -> str:
    """Returns numbers of runs; those of failed runs link to their descriptions."""
    failed = {result.run.number for result in trial.failed}
    return ", ".join(f'<a href="#run-{n}">{n}</a>' if n in failed else str(n) for n in numbers)


def _comparison(trial: TrialResults) -> str:
    comparison = trial.comparison
    if not comparison:
        return ""
    lists = "".join(
        f"<p>Got {kind}: {_links(trial, comparison[kind])}</p>" for kind in ("worse", "better") if comparison.get(kind)
    )
    lines = [str(line) for line in comparison["text"]]
    kind = ' class="bad"' if comparison.get("decline") else ""
    items = "".join(f"<li{kind if i == 0 else ''}>{_text(line)}</li>" for i, line in enumerate(lines))
    other = f" with <code>{_text(str(comparison['file']))}</code>" if comparison.get("file") else ""
    return f"<h2>Comparison{other}</h2><ul>{items}</ul>{lists}"


_Column = tuple[str, bool]
"""Heading, and whether the column holds numbers."""


def _table(columns: Sequence[_Column], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table; the cells are HTML."""
    kinds = [' class="number"' if is_number else "" for _, is_number in columns]
    heads = "".join(f"<th{kind}>{name}</th>" for kind, (name, _) in zip(kinds, columns, strict=True))
    lines = "".join(
        f"<tr>{''.join(f'<td{kind}>{cell}</td>' for kind, cell in zip(kinds, row, strict=True))}</tr>" for row in rows
    )
    return f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table></div>'


def _rate_row(name: str, rate: Rate) -> tuple[str, ...]:
    low, high = rate.interval
    cells = (f"{rate.passed} of {rate.count}", _percent(rate.passed / rate.count), f"{100 * low:.0f} to {100 * high:.0f} %")
    return (name, *cells, _bar(rate))


_RATE_COLUMNS: tuple[_Column, ...] = (("passed", True), ("", True), ("95 % interval", True), ("0 to 100 %", False))


def _groups(trial: TrialResults) -> str:
    groups = trial.by(lambda result: f"{scene_name(result.run.scene)}, {robot_name(result.run.robot)}")
    if len(groups) < 2:
        return ""
    rows = [_rate_row(_text(name), rate) for name, rate in groups.items()]
    return f"<h2>Scenes and robots</h2>{_table((('scene, robot', False), *_RATE_COLUMNS), rows)}"


def _verdicts(trial: TrialResults) -> str:
    rows = [_rate_row(f"<code>{_text(name)}</code>", rate) for name, rate in trial.verdicts().items()]
    return f"<h2>Verdicts</h2>{_table((('verdict', False), *_RATE_COLUMNS), rows)}" if rows else ""


def _causes(trial: TrialResults) -> str:
    rows = [(_text(kind), str(len(numbers)), _links(trial, numbers)) for kind, numbers in trial.causes().items()]
    if not rows:
        return ""
    caption = '<p class="quiet">The earliest event that led to each failure.</p>'
    return f"<h2>Causes</h2>{caption}{_table((('cause', False), ('runs', True), ('numbers', False)), rows)}"


def _maps(trial: TrialResults, folder: Path, maps: dict[str, SceneMap | None] | None) -> str:
    parts = []
    for scene in dict.fromkeys(result.run.scene for result in trial.results):
        runs = [(r, read_path(run_folder(folder, r.run.number))) for r in trial.results if r.run.scene == scene]
        floor = scene_map(scene) if maps is None else maps.get(scene)
        svg = map_svg(floor, runs)
        title = ", ".join(filter(None, (scene_name(scene), "" if floor is None else floor.floor)))
        rate = Rate(sum(result.passed for result, _ in runs), len(runs))
        if svg:
            parts.append(f"<div><h3>{_text(title)}: {_short(rate)}</h3>{svg}</div>")
    caption = (
        '<p class="quiet">True paths of the robot: <span class="good">solid = passed</span>, <span class="bad">dashed = failed</span>, '
        "with the number of the run at its end, ✗. Circle: start. For failed runs, diamond: goal, square: spawned object.</p>"
    )
    return f"<h2>Paths</h2>{caption}<div class='maps'>{''.join(parts)}</div>" if parts else ""


def _failures(trial: TrialResults, folder: Path, options: Sequence[str]) -> str:
    if not trial.failed:
        return ""
    pictures = _Pictures()
    parts = [
        _failure(result, trial.file, folder, options, pictures, is_open=i < _INITIALLY_OPEN)
        for i, result in enumerate(trial.failed)
    ]
    left_out = (
        f'<p class="quiet">The pictures of {pictures.left_out} more failed runs are not embedded; they are in the folders of the runs.</p>'
        if pictures.left_out
        else ""
    )
    return f"<h2>Failed runs</h2>{left_out}{''.join(parts)}"


class _Pictures:
    """Pictures embedded in the page, up to a total size."""

    def __init__(self) -> None:
        self._room = _MAX_PICTURES
        self.left_out = 0
        """Number of runs whose pictures were omitted."""

    def of(self, folder: Path) -> str:
        """Returns the pictures in the folder of a run."""
        pictures = {name: data for name in PICTURES if (data := _bytes(folder / name))}
        size = sum(map(len, pictures.values()))
        if size > self._room:
            self.left_out += 1
            return ""
        self._room -= size
        figures = "".join(
            f'<figure{" class=wide" if name == FILM else ""}><img alt="{PICTURES[name]}" '
            f'src="data:image/{"jpeg" if name.endswith(".jpg") else "png"};base64,{base64.b64encode(data).decode()}"></figure>'
            for name, data in pictures.items()
        )
        return f'<div class="pictures">{figures}</div>' if figures else ""


def _bytes(path: Path) -> bytes:
    try:
        return read_file(path)
    except OSError:
        return b""


def _failure(result: RunResult, file: str, folder: Path, options: Sequence[str], pictures: _Pictures, *, is_open: bool) -> str:
    run, path = result.run, run_folder(folder, result.run.number)
    title = f"{scene_name(run.scene)}, {robot_name(run.robot)}, {route_text(run)}"
    kind = result.cause.kind if result.cause else result.outcome.end
    verdicts = "".join(
        f"<li{'' if verdict.passed else ' class=no'}><code>{_text(verdict.name)}</code> {_text(verdict.text)}</li>"
        for verdict in sorted(result.verdicts, key=lambda verdict: verdict.passed)
    )
    outcome = result.outcome
    ended = f"{outcome.end}: {outcome.detail}" if outcome.detail else outcome.end
    facts = [("ended", ended), ("last status", outcome.status), ("measured", _measures(result)), ("sampled", _sampled(result))]
    facts += [("refused commands", str(outcome.refused_commands) if outcome.refused_commands else "")]
    listed = "".join(f"<dt>{name}</dt><dd>{_text(value)}</dd>" for name, value in facts if value)
    log = log_tail(path / STACK_LOG)
    shown_log = (
        f'<h3>End of the stack\'s output</h3><pre class="log"><span>{_text(log)}</span></pre>'
        if log
        else '<p class="quiet">The stack printed nothing.</p>'
    )
    place = f"runs/{run.number:04d}"
    links = [
        f'<a href="{place}/{name}">{label}</a>'
        for name, label in ((BAG, "bag"), (STACK_LOG, "output of the stack"), (SIMULATION_LOG, "output of the simulation"))
        if (path / name).exists()
    ]
    commands = [("Run again, with the stack", rerun_command(file, run.number, options))]
    if can_be_replayed(folder, result):
        commands.insert(0, ("Replay bit for bit, without the stack", replay_command(folder, run.number)))
    shown = "".join(f'<h3>{name}</h3><pre class="command">{_text(command)}</pre>' for name, command in commands)
    return (
        f'<details class="run" id="run-{run.number}"{" open" if is_open else ""}><summary><b>{run.number}</b>'
        f'{_headline(kind, reason(result))} · <span class="quiet">{_text(title)}</span></summary>'
        f'<ul class="verdicts">{verdicts}</ul>{pictures.of(path)}<dl>{listed}</dl>{shown_log}{shown}'
        f'<p class="quiet">{" · ".join(links)}</p></details>'
    )


def _headline(kind: str, why: str) -> str:
    """Returns kind and reason of a failure, without repeating a kind that begins the reason."""
    return f'<span class="bad">{_text(kind)}:</span> {_text(why.removeprefix(f"{kind}: "))}'


_UNITS = {
    "time": "s", "length": "m", "clearance": "m", "goal_distance": "m", "rms_acceleration": "m/s²", "localisation_error": "m",
    "localisation_error_max": "m", "localisation_yaw_error": "rad", "yaw_error": "rad", "mean_speed": "m/s", "greatest_force": "N",
}  # fmt: skip


def _measures(result: RunResult) -> str:
    return ", ".join(
        f"{name.replace('_', ' ')} {value:.3g} {_UNITS.get(name, '')}".strip()
        for name, value in result.measures.items()
        if math.isfinite(value)
    )


def _sampled(result: RunResult) -> str:
    run = result.run
    parts = [f"seed {run.seed}", *(f"{name} {value:.3g}" for name, value in run.drawn.items())]
    parts += [f"closed {door}" for door in run.closed_doors]
    parts += [placed.name for placed in run.things] + [person.name for person in run.people]
    return ", ".join(parts)


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _all_runs(trial: TrialResults) -> str:
    columns: tuple[_Column, ...] = (
        ("run", True), ("scene, robot", False), ("start → goal, m", False), ("result", False), ("time, s", True), ("length, m", True),
        ("shortest, m", True), ("ratio", True), ("clearance, m", True),
    )  # fmt: skip
    rows = []
    for result in trial.results:
        run, measures = result.run, result.measures
        kind = result.cause.kind if result.cause else result.outcome.end
        label = (
            '<span class="good">✓ passed</span>'
            if result.passed
            else f'<a href="#run-{run.number}" class="bad">✗ {_text(kind)}</a>'
        )
        rows.append(
            (
                str(run.number),
                _text(f"{scene_name(run.scene)}, {robot_name(run.robot)}"),
                f'<span class="nowrap">{_text(route_text(run).replace("->", "→"))}</span>',
                f'<span class="nowrap">{label}</span>',
                _number(seconds_of(result), 1),
                _number(measures.get("length"), 1),
                _number(run.shortest, 1),
                _number(measures.get("path_ratio"), 2),
                _number(measures.get("clearance"), 2),
            )
        )
    return f"<h2>All runs</h2>{_table(columns, rows)}" if rows else ""


def _about(trial: TrialResults) -> str:
    outcomes = [result.outcome for result in trial.results]
    busy = sum(o.start_up_s + o.running_s + o.ending_s for o in outcomes)
    labels = {"name": "machine"}
    facts = [(labels.get(name, name), str(value)) for name, value in (*trial.machine.items(), *trial.versions.items())]
    facts.append(("workers", trial.workers))
    if busy > 0.0:
        starting = sum(o.start_up_s for o in outcomes) / busy
        running = sum(o.running_s for o in outcomes)
        simulated = sum(max(o.end_ns, 0) for o in outcomes) / 1e9
        facts.append(("start-up", f"{_percent(starting)} of the time of all workers"))
        if running > 0.0:
            facts.append(("pace", f"{simulated / running:.1f} simulated seconds per second for each worker while time advances"))
    listed = "".join(f"<dt>{_text(name)}</dt><dd>{_text(value)}</dd>" for name, value in facts)
    return f'<h2>Provenance</h2><dl>{listed}</dl><p class="quiet">All results: <a href="{RESULTS}">{RESULTS}</a></p>'
