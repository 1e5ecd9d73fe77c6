"""Draws the panels of a run on axes of matplotlib: paths on the map, velocities, contacts, rates."""

from __future__ import annotations

from typing import Any

import numpy as np

from gibson_sim.bags.plots.run_data import F64, Floor, RecordedRun, RobotRun, Track

INK, COMMAND_COLOUR, RED = "#111827", "#9ca3af", "#dc2626"
ROBOT_COLOURS = ("#1d4ed8", "#c2410c", "#047857", "#7c3aed", "#be185d", "#0e7490", "#a16207", "#4d7c0f")
"""Colours of robots; they repeat."""
ESTIMATE = "#047857"
"""Colour of the estimate of a single robot."""
COMMAND_STYLE: tuple[str, dict[str, Any]] = ("commanded (cmd_vel)", {"linewidth": 1.6, "linestyle": "--"})
TRUE_STYLE: tuple[str, dict[str, Any]] = ("ground truth", {"linewidth": 1.3})
WHEEL_STYLE: tuple[str, dict[str, Any]] = ("wheel odometry", {"linewidth": 1.1, "alpha": 0.5})
"""Labels and lines of velocities."""
PATH_STYLE: tuple[str, dict[str, Any]] = ("true path", {"linewidth": 2.2, "alpha": 0.85})
ODOMETRY_STYLE: tuple[str, dict[str, Any]] = ("odometry", {"linewidth": 1.6, "linestyle": (0, (4, 2)), "zorder": 4})
ESTIMATE_STYLE: tuple[str, dict[str, Any]] = ("estimate", {"linewidth": 1.6, "linestyle": (0, (1, 1.2)), "zorder": 4})
"""Labels and lines of paths."""
_GOAL_STYLE: dict[str, Any] = {
    "marker": "*",
    "linestyle": "none",
    "color": "#f59e0b",
    "markeredgecolor": INK,
    "markersize": 15,
    "zorder": 4.5,
}
"""Marker of the goal."""
_FLOOR_COLOURS = ((1.0, 1.0, 1.0), (0.61, 0.64, 0.69), (0.925, 0.933, 0.945))
"""Colours of a free, an occupied and an unknown cell."""
_MARGIN_M = 1.0
"""Minimum margin about the paths, metres."""
_WHOLE_MAP_M, _LARGE_MAP = 25.0, 4.0
"""Maximum size of a map that is always shown whole, metres; a larger map is cropped to the paths if it is larger than they are by this factor."""
_HOLD_S = 0.5
"""Gap after a command, s, after which it is no longer drawn."""
_MOST_CONTACTS, MOST_TOPICS = 12, 45
"""Maximum number of rows of contacts, and of topics."""
_LEGEND_COLUMNS = 4
"""Maximum number of columns of the legend of velocities."""
_MOST_BINS = 120
"""Maximum number of columns of the rates of topics."""
_LEAST_SPAN = 0.1
"""Minimum height of a velocity axis, m/s and rad/s: smaller motion is a robot that settles on its wheels."""
_MOVES = 0.01
"""Minimum velocity of a moving robot, m/s and rad/s."""
_IDLE_SHARE, IDLE_MARGIN_S = 0.3, 2.0
"""Minimum share of a run for its idle end to be left out of the motion panels; duration of the idle end that is still shown, s."""
_NORMAL, _MOST_RATE = 1.0, 1.8
"""Rates relative to the usual rate: the usual one, and the one that is drawn darkest."""
_SHADES = ("#ffffff", "#dbeafe", "#60a5fa", "#1e40af")
"""Colours of rates, from none to ``_MOST_RATE``."""
_MARKS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600)
"""Intervals between time marks along a path, s."""


def colours(run: RecordedRun) -> dict[str, str]:
    """Returns a colour for each robot."""
    return {robot.name: ROBOT_COLOURS[i % len(ROBOT_COLOURS)] for i, robot in enumerate(run.robots)}


def contact_rows(run: RecordedRun) -> list[tuple[str, str]]:
    """Returns (robot, other) of the contacts that are shown, those that lasted longest, in the order of their first contact."""
    seconds: dict[tuple[str, str], float] = {}
    for robot in run.robots:
        for touch in robot.touches:
            key = (robot.name, touch.other)
            seconds[key] = seconds.get(key, 0.0) + touch.end - touch.begin + 1e-3
    longest = sorted(seconds, key=lambda key: -seconds[key])[:_MOST_CONTACTS]
    return [key for key in seconds if key in longest]


def draw_paths(axis: Any, run: RecordedRun, goal: tuple[float, float] | None = None) -> None:
    """Draws the map, the paths of the robots, their starts and ends, and the points of contact.

    Args:
        axis: axis of matplotlib.
        run: the run.
        goal: x, y of the goal, map frame, metres; None = unknown.
    """
    if run.floor is not None:
        _draw_floor(axis, run.floor)
    tint, alone, numbers = colours(run), len(run.robots) == 1, {key: i + 1 for i, key in enumerate(contact_rows(run))}
    for robot in run.robots:
        for track, name, style in _tracks(robot, tint[robot.name], alone):
            axis.plot(track.x, track.y, label=name, **style)
        reference = robot.reference
        if reference is None:
            continue
        axis.plot(reference.x[:1], reference.y[:1], "o", color=INK if alone else tint[robot.name], markersize=7, zorder=5)
        _draw_end(axis, reference, INK if alone else tint[robot.name])
        if alone:
            _draw_times(axis, run, reference, goal)
        for touch in robot.touches:
            number = numbers.get((robot.name, touch.other))
            if number is not None:
                _draw_touch(axis, *reference.at(touch.begin)[:2], number)
    if goal is not None:
        axis.plot(*goal, label="goal", **_GOAL_STYLE)
    axis.set(title=_path_title(run), xlabel="x, m", ylabel="y, m")
    axis.set_aspect("equal", adjustable="box" if run.floor is not None else "datalim")
    if run.floor is not None:
        axis.grid(False)
        axis.set_facecolor(_FLOOR_COLOURS[2])
        left, right, bottom, top = _window(run, run.floor, goal)
        axis.set(xlim=(left, right), ylim=(bottom, top))
    if any(robot.reference is not None for robot in run.robots):
        handles_and_labels = axis.get_legend_handles_labels() if alone else _styles_and_robots(run, *_path_styles(run))
        axis.legend(*handles_and_labels, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=3 if alone else 4, fontsize=8.5)
    else:
        axis.text(
            0.5,
            0.5,
            "no odometry and no pose in the bag",
            ha="center",
            va="center",
            transform=axis.transAxes,
            color=COMMAND_COLOUR,
        )


def _path_styles(run: RecordedRun) -> list[tuple[str, dict[str, Any]]]:
    """Returns the styles of the available paths."""
    kinds = (("truth", PATH_STYLE), ("odometry", ODOMETRY_STYLE), ("estimate", ESTIMATE_STYLE))
    return [style for kind, style in kinds if any(getattr(robot, kind) is not None for robot in run.robots)]


def path_aspect(run: RecordedRun) -> float:
    """Returns width by height of the shown part of the map; 1 without a map."""
    if run.floor is None:
        return 1.0
    left, right, bottom, top = _window(run, run.floor)
    return (right - left) / max(top - bottom, 1e-6)


def _path_title(run: RecordedRun) -> str:
    names = ", ".join(robot.name for robot in run.robots if robot.name)
    where = f"path on {run.floor.source}" if run.floor is not None else "path"
    return f"{run.folder.resolve().name}{f' ({names})' if names else ''}, {run.end - run.begin:.1f} s: {where}"


def _tracks(robot: RobotRun, colour: str, alone: bool) -> list[tuple[Track, str, dict[str, Any]]]:
    """Returns the tracks of a robot with their labels and styles, the wheels' above the truth where both are the same."""
    onto = (
        ", from its true start"
        if robot.truth is not None
        else ", from its start on the map"
        if robot.estimate is not None
        else ""
    )
    candidates = (
        (robot.truth, "", INK, PATH_STYLE),
        (robot.odometry, onto, colour, ODOMETRY_STYLE),
        (robot.estimate, f" ({robot.estimate.source})" if robot.estimate is not None else "", ESTIMATE, ESTIMATE_STYLE),
    )
    return [
        (track, f"{label}{more}", {**style, "color": default_colour if alone else colour})
        for track, more, default_colour, (label, style) in candidates
        if track is not None
    ]


def _draw_floor(axis: Any, floor: Floor) -> None:
    free, occupied, unknown = (np.array(colour, dtype=np.float32) for colour in _FLOOR_COLOURS)
    part = np.clip(floor.cells.astype(np.float32) / 100.0, 0.0, 1.0)[..., None]
    pixels = np.where(floor.cells[..., None] < 0, unknown, free + part * (occupied - free))
    axis.imshow(pixels, extent=floor.extent, origin="lower", interpolation="nearest", zorder=0)


def _window(run: RecordedRun, floor: Floor, goal: tuple[float, float] | None = None) -> tuple[float, float, float, float]:
    """Returns left, right, bottom and top of the shown part of the map, metres."""
    mapped = np.argwhere(floor.cells >= 0)
    left, right, bottom, top = floor.extent
    if len(mapped):
        (row0, column0), (row1, column1) = mapped.min(axis=0), mapped.max(axis=0) + 1
        x, y = floor.origin
        left, right = x + column0 * floor.resolution, x + column1 * floor.resolution
        bottom, top = y + row0 * floor.resolution, y + row1 * floor.resolution
    tracks = [track for robot in run.robots for track in (robot.truth, robot.odometry, robot.estimate) if track is not None]
    goals = () if goal is None else (np.array([goal]),)
    xs, ys = (np.concatenate([*(getattr(t, axis) for t in tracks), *(g[:, i] for g in goals)]) for i, axis in enumerate("xy"))
    size = max(float(np.ptp(xs)), float(np.ptp(ys)), 2.0 * _MARGIN_M)
    margin = max(_MARGIN_M, 0.25 * size)
    if max(right - left, top - bottom) > max(_WHOLE_MAP_M, _LARGE_MAP * size):
        return float(xs.min()) - margin, float(xs.max()) + margin, float(ys.min()) - margin, float(ys.max()) + margin
    return (
        min(left, float(xs.min()) - 0.3),
        max(right, float(xs.max()) + 0.3),
        min(bottom, float(ys.min()) - 0.3),
        max(top, float(ys.max()) + 0.3),
    )


def _draw_end(axis: Any, track: Track, colour: str) -> None:
    """Draws a triangle at the last pose, which points forward."""
    yaw = float(track.yaw[-1])
    axis.plot(track.x[-1:], track.y[-1:], marker=(3, 0, float(np.degrees(yaw)) - 90.0), color=colour, markersize=11, zorder=5)


def _draw_touch(axis: Any, x: float, y: float, number: int) -> None:
    """Draws a red dot with the number of the contact beside it."""
    axis.plot([x], [y], "o", color=RED, markersize=5, zorder=6)
    axis.annotate(
        str(number), (x, y), xytext=(-9, -9), textcoords="offset points", ha="center", va="center", fontsize=8, color=RED,
        weight="bold", zorder=7, bbox={"boxstyle": "circle,pad=0.22", "facecolor": "white", "edgecolor": RED, "linewidth": 1.2},
    )  # fmt: skip


def _draw_times(axis: Any, run: RecordedRun, track: Track, goal: tuple[float, float] | None) -> None:
    """Marks the path with times, which the other panels have on their axes; no marks while the robot stands still."""
    seconds = run.end - run.begin
    every = float(next((mark for mark in _MARKS if seconds / mark <= 12), np.ceil(seconds / 12)))
    shown = (float(f(v)) for v in (track.x, track.y) for f in (np.min, np.max))
    left, right, bottom, top = shown if run.floor is None else _window(run, run.floor, goal)
    min_spacing = 0.06 * max(right - left, top - bottom, 1.0)
    last_mark = float(track.x[0]), float(track.y[0])
    others = np.array([last_mark, (track.x[-1], track.y[-1]), *([goal] if goal is not None else [])])
    for t in np.arange(np.ceil((run.begin + 1e-6) / every) * every, float(track.t[-1]) + 1e-9, every):
        x, y, _ = track.at(float(t))
        if t < track.t[0] or np.hypot(x - last_mark[0], y - last_mark[1]) < min_spacing:
            continue
        last_mark = x, y
        # Beside the mark, away from a start, end or goal that the text could cover.
        distances = np.hypot(*(others - last_mark).T)
        nearest = int(np.argmin(distances))
        is_left = bool(distances[nearest] < 3.0 * min_spacing and others[nearest, 0] > x)
        axis.plot([x], [y], "o", color=INK, markersize=3, zorder=5)
        axis.annotate(
            f"{t:g} s", (x, y), xytext=(-5 if is_left else 5, 5), textcoords="offset points", ha="right" if is_left else "left",
            fontsize=7.5, color=INK, zorder=6, bbox={"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
        )  # fmt: skip


def velocity_parts(run: RecordedRun) -> list[tuple[str, str]]:
    """Returns name and label of the shown components of velocities; sideways only if it is commanded or measured."""
    all_velocities = [v for robot in run.robots for v in (robot.commands, robot.by_wheels, robot.in_truth) if v is not None]
    has_sideways = any(np.abs(v.sideways).max(initial=0.0) > 0.02 for v in all_velocities)
    sideways = [("sideways", "sideways, m/s")] if has_sideways else []
    return [("forward", "forward, m/s"), *sideways, ("turning", "turning, rad/s")]


def draw_velocities(axis: Any, run: RecordedRun, part: str, label: str) -> None:
    """Draws one component of the velocities: commanded, by wheel odometry, and ground truth."""
    tint, alone = colours(run), len(run.robots) == 1
    for robot in run.robots:
        colour = tint[robot.name]
        for velocities, default_colour, (name, style) in (
            (robot.commands, COMMAND_COLOUR, COMMAND_STYLE),
            (robot.in_truth, INK, TRUE_STYLE),
            (robot.by_wheels, colour, WHEEL_STYLE),
        ):
            if velocities is None:
                continue
            t, values = velocities.t, getattr(velocities, part)
            if velocities is robot.commands:
                t, values = _held(t, values, run.end)
            axis.plot(t, values, label=name, **{**style, "color": default_colour if alone else colour})
        for touch in robot.touches:
            if touch.is_press:
                axis.axvspan(touch.begin, touch.end, color=RED, alpha=0.08, linewidth=0)
    axis.set(ylabel=label, xlim=motion_limits(run))
    low, high = axis.get_ylim()
    if high - low < _LEAST_SPAN:
        axis.set_ylim((low + high - _LEAST_SPAN) / 2.0, (low + high + _LEAST_SPAN) / 2.0)
    if not axis.get_legend_handles_labels()[0]:
        axis.text(0.5, 0.5, "no velocities in the bag", ha="center", va="center", transform=axis.transAxes, color=COMMAND_COLOUR)


def _time_limits(run: RecordedRun) -> tuple[float, float]:
    """Returns the limits of the time axes, s; a run's first message comes a step after 0."""
    return (0.0 if 0.0 < run.begin < 0.05 * run.end else run.begin), run.end


def motion_limits(run: RecordedRun) -> tuple[float, float]:
    """Returns the limits of the time axes of motion, s, without a long idle end of the run (no motion, contact or command)."""
    begin, end = _time_limits(run)
    last = max((t for robot in run.robots for t in _times_of_motion(robot)), default=end) + IDLE_MARGIN_S
    return begin, last if end - last > _IDLE_SHARE * (end - begin) else end


def _times_of_motion(robot: RobotRun) -> list[float]:
    """Returns the last times, s, at which a robot moved, was commanded to move, and touched something, as far as it did."""
    times = [touch.end for touch in robot.touches]
    for velocities in (robot.commands, robot.by_wheels, robot.in_truth):
        if velocities is not None:
            fast = np.maximum(np.hypot(velocities.forward, velocities.sideways), np.abs(velocities.turning)) > _MOVES
            times += [float(t) for t in velocities.t[fast][-1:]]
    return times


def _held(t: F64, values: F64, end: float) -> tuple[F64, F64]:
    """Returns a line that holds each command until the next, and ends ``_HOLD_S`` after the last one of a series."""
    until = np.append(t[1:], end)
    stops = np.minimum(until, t + _HOLD_S)
    breaks = np.where(until - t > _HOLD_S, np.nan, values)
    return np.column_stack([t, stops, stops]).ravel(), np.column_stack([values, values, breaks]).ravel()


def draw_contacts(axis: Any, run: RecordedRun) -> None:
    """Draws the intervals of contact, one row per touched object, with the numbers of ``draw_paths``."""
    rows, tint, alone = contact_rows(run), colours(run), len(run.robots) == 1
    axis.set(xlim=motion_limits(run), ylim=(len(rows) + 0.1 or 1.0, -0.6) if rows else (0, 1))
    if not rows:
        text = "touched nothing" if run.has_contact_topics else "the bag has no contacts: record collisions, contacts or bumper"
        axis.text(0.5, 0.5, text, ha="center", va="center", transform=axis.transAxes, color="#6b7280")
        axis.set_yticks([])
        axis.grid(False)
        return
    shortest = 0.004 * (run.end - run.begin)
    forces = dict.fromkeys(rows, 0.0)
    for robot in run.robots:
        for touch in robot.touches:
            key = (robot.name, touch.other)
            if key in forces:
                forces[key] = max(forces[key], touch.force)
                width = max(touch.end - touch.begin, shortest)
                axis.barh(
                    rows.index(key), width, left=touch.begin, height=0.6, color=RED if alone else tint[robot.name], alpha=0.85
                )
    names = [other or "bumper" if alone or not robot else f"{robot}: {other or 'bumper'}" for robot, other in rows]
    axis.set_yticks(range(len(rows)), [f"{i + 1}  {name}" for i, name in enumerate(names)], fontsize=8.5)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.grid(axis="y", visible=False)
    for row, key in enumerate(rows):
        if forces[key] >= 0.5:
            axis.text(
                1.005,
                row,
                f"max {forces[key]:.0f} N",
                transform=axis.get_yaxis_transform(),
                va="center",
                fontsize=8,
                color="#4b5563",
            )


def rates(run: RecordedRun) -> tuple[F64, F64, list[tuple[str, float]]]:
    """Returns the rates of topics over time.

    Returns:
        The edges of the bins, (B + 1,), s; the rate in each bin relative to the topic's usual one, (T, B); name and usual rate, Hz, of each
        topic. Of topics with fewer than three messages in a bin, the mean of three bins.
    """
    edges = _bins(run.begin, run.end)
    widths = np.diff(edges)
    names, parts = [], []
    for arrivals in run.arrivals[:MOST_TOPICS]:
        rate = np.histogram(arrivals.t, edges)[0] / widths
        usual = float(np.median(rate[rate > 0.0])) if rate.any() else 1.0
        if usual * widths[0] < 3.0 and len(rate) >= 3:
            ones = np.ones(3)
            rate = np.convolve(rate * widths, ones, "same") / np.convolve(widths, ones, "same")
            usual = float(np.median(rate[rate > 0.0])) if rate.any() else 1.0
            rate = np.minimum(rate, usual)
        names.append((arrivals.topic, usual))
        parts.append(rate / usual)
    return edges, np.array(parts, dtype=np.float64).reshape(len(names), len(widths)), names


def _bins(begin: float, end: float) -> F64:
    """Returns the edges of bins of a round number of seconds; the first and the last are cut at the ends of the recording."""
    width = next(
        (mark for mark in (0.5, *_MARKS) if (end - begin) / mark <= (20 if mark < 1 else _MOST_BINS)),
        np.ceil((end - begin) / _MOST_BINS),
    )
    first = np.floor(begin / width + 1e-6) * width
    edges = np.arange(first, max(end, first + 0.1 * width), width)  # a recording of microseconds may end before ``first``
    if end - edges[-1] < 0.5 * width and len(edges) > 1:
        edges = edges[:-1]
    edges = np.append(edges, end if end > edges[-1] else edges[-1] + width)
    if begin - edges[0] > 0.1 * width:
        edges[0] = begin
    return np.asarray(edges, dtype=np.float64)


def draw_rates(axis: Any, run: RecordedRun) -> None:
    """Draws the rate of each topic over time: one row each, white where no message arrived, with its usual rate beside it."""
    edges, parts, names = rates(run)
    axis.set(xlim=_time_limits(run))
    axis.grid(False)
    if not names:
        axis.text(
            0.5, 0.5, "no topic has several messages", ha="center", va="center", transform=axis.transAxes, color=COMMAND_COLOUR
        )
        return
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Patch

    shades = LinearSegmentedColormap.from_list("rates", _SHADES)
    axis.pcolormesh(edges, np.arange(len(names) + 1), parts, cmap=shades, vmin=0.0, vmax=_MOST_RATE, linewidth=0, rasterized=True)
    meanings = (
        (0.0, "no message"),
        (0.5, "half"),
        (_NORMAL, "usual rate (on the right)"),
        (_MOST_RATE, f"{_MOST_RATE:g} times that, or more"),
    )
    patches = [
        Patch(facecolor=shades(part / _MOST_RATE), edgecolor="#9ca3af", linewidth=0.6, label=text) for part, text in meanings
    ]
    axis.legend(
        handles=patches, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(patches), fontsize=8.5, borderaxespad=0.2
    )
    axis.set_yticks(np.arange(len(names)) + 0.5, [name for name, _ in names], fontsize=8)
    axis.tick_params(axis="y", length=0)
    axis.set_ylim(len(names), 0)
    axis.hlines(np.arange(1, len(names)), *_time_limits(run), color="white", linewidth=1.5)
    for row, (_, rate) in enumerate(names):
        axis.text(
            1.005, row + 0.5, _rate_text(rate), transform=axis.get_yaxis_transform(), va="center", fontsize=8, color="#4b5563"
        )


def _rate_text(rate: float) -> str:
    return f"{rate:.0f} Hz" if rate >= 9.5 else f"{rate:.1f} Hz"


def draw_legend(figure: Any, axis: Any, run: RecordedRun) -> None:
    """Draws the legend of the velocities above the title of their first panel: lines, and for several robots, their colours."""
    handles, labels = axis.get_legend_handles_labels()
    if not handles:
        return
    if len(run.robots) > 1:
        handles, labels = _styles_and_robots(run, COMMAND_STYLE, TRUE_STYLE, WHEEL_STYLE)
    figure.legend(handles, labels, loc="outside upper right", ncols=min(len(handles), _LEGEND_COLUMNS), fontsize=8.5)


def _styles_and_robots(run: RecordedRun, *styles: tuple[str, dict[str, Any]]) -> tuple[list[Any], list[str]]:
    """Returns handles and labels of a legend of several robots: one for each line style and one for each robot's colour."""
    from matplotlib.lines import Line2D

    lines = [(label, Line2D([], [], color="#6b7280", **style)) for label, style in styles]
    lines += [(name, Line2D([], [], color=colour, linewidth=4.0)) for name, colour in colours(run).items()]
    return [line for _, line in lines], [label for label, _ in lines]
