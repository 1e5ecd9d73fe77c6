"""Detects failure events in the evidence of a run, each with its time of onset. Rules and limits: ``docs/trial_verdicts.md``.

An event is not yet a cause: ``cause.py`` decides which events precede a failure and contributed to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.plots.touches import Touch
from gibson_sim.trials.judging.evidence import Commands, Estimate, Evidence, Poses, compose, errors
from gibson_sim.trials.judging.obstacles import Obstacles, body_obstacles
from gibson_sim.trials.records import CauseKind, Outcome, RunSpec

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

GRID_S = 0.1
"""Sampling period of the motion, s: the robot's pose changes little meanwhile."""
JUMP_M, JUMP_RAD = 0.5, math.radians(30.0)
"""Least change of map -> odom between two updates that counts as a jump, at the robot: a filter corrects by centimetres, and half a metre is
another place in a room."""
JUMP_WORSE_M, JUMP_WORSE_RAD = 0.25, math.radians(15.0)
"""Least growth of the error against the truth in a jump: a jump back to the truth is a recovery."""
OFF_M, OFF_RAD = 0.5, math.radians(30.0)
"""Error against the truth from which the localisation counts as off: a plan based on it leads the robot's circle into a wall."""
BACK_M, BACK_RAD = 0.25, math.radians(15.0)
"""Error below which the localisation has recovered: half of the above, as hysteresis, so that an error near the limit is one event."""
OFF_S = 1.0
"""Least time with an error above ``OFF_M`` or ``OFF_RAD``, s: shorter excursions are latency."""
STANDS_S = 2.0
"""Time window in which a robot has to follow its commands, s: longer than any acceleration from rest and any latency."""
COMMANDED_M, COMMANDED_RAD = 0.1, 0.2
"""Least commanded motion in this window: on average 0.05 m/s or 0.1 rad/s."""
COMMANDED_SHARE = 0.9
"""Least share of this window with nonzero commands."""
FOLLOWED_SHARE = 0.1
"""Share of the commanded motion up to which a robot counts as standing."""
STANDS_M, STANDS_RAD = 0.02, math.radians(2.0)
"""Motion in this window up to which a robot counts as standing: contact jitter."""
BEFORE_IMPACT_S = 0.5
"""Time before a contact over which the robot's speed is averaged, s."""
WHEELS_SHARE = 0.5
"""Share of the commanded motion, by odometry, from which the wheels count as turning."""
SLIP_S = 5.0
"""Time over which odometry and truth are compared, s."""
SLIP_RATIO = 1.5
"""Least ratio of the odometry's motion to the true motion that counts as slip: a third of the motion is lost."""
SLIP_M, SLIP_RAD = 0.3, math.radians(45.0)
"""Least excess of the odometry's motion over the true motion in this time."""
BAD_SHARE = 0.1
"""Least share of commands that are not finite: a single one is rejected and does no harm."""
STOPPED_S = 5.0
"""Least time without a nonzero command at the end of a run after which the stack counts as no longer commanding, s."""
ZERO_VELOCITY = 1e-3
"""Velocity up to which a command counts as zero, m/s and rad/s."""
PLAN_TOLERANCE = 0.5
"""Fraction of a map cell by which the robot's circle may overlap an obstacle along a plan: planners use cell centres."""
PLAN_TOLERANCE_M = 0.02
"""The same for bodies, metres."""
PLAN_BEGIN_M = 0.3
"""Length at the beginning of a plan that is ignored, m: the robot stands there, so it fits."""
PLAN_SAME_M = 1.0
"""Greatest distance between overlaps of two consecutive plans with one obstacle that count as the same overlap, metres."""
PLAN_NEAR_M = 0.5
"""Greatest distance between the robot's circle and an overlap of its plan with an obstacle at which the two are related, m."""

_REPORTED_RAD = math.radians(5.0)
"""Least rotation in a jump that is reported."""


@dataclass(frozen=True, slots=True)
class Event:
    """A failure event."""

    kind: CauseKind
    begin: float
    """Onset, s since the goal; negative = before the goal."""
    end: float
    """End of the event, s since the goal; the end of the run if the event lasted."""
    what: str
    """A clause with a subject, in the past tense, without time and place."""
    xy: tuple[float, float] | None = None
    """True position of the robot at the onset, map frame, metres; None = unknown."""
    spots: tuple[tuple[float, float], ...] = ()
    """Positions near which the event is relevant, map frame, metres; empty = everywhere."""
    other: str = ""
    """Name of the obstacle or body involved."""
    room: float = 0.0
    """Least clearance left to the robot, metres: of simultaneous plans, the tightest comes first."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Commands and motion, sampled at a period of ``GRID_S``."""

    t: F64
    """(N,), s since the goal."""
    truth: F64 | None
    odometry: F64 | None
    """(3, N): x, y, yaw, metres and radians; None = unknown."""
    forward: F64
    sideways: F64
    turning: F64
    """(N,), the command in force, m/s and rad/s; 0 without one."""

    @property
    def is_commanded(self) -> Bools:
        """(N,): whether the command in force is nonzero."""
        return np.asarray(np.maximum.reduce([np.abs(self.forward), np.abs(self.sideways), np.abs(self.turning)]) > ZERO_VELOCITY)

    @classmethod
    def of(cls, evidence: Evidence, timeout: float) -> Motion:
        """Returns the motion of a run; commands hold for ``timeout`` seconds."""
        t = np.arange(0.0, evidence.duration + GRID_S / 2.0, GRID_S)
        truth = None if evidence.truth is None else evidence.truth.at(t)
        odometry = None if evidence.odometry is None else evidence.odometry.at(t)
        return cls(t, truth, odometry, *_commands_in_force(evidence.commands, t, timeout))


def find_events(
    run: RunSpec, outcome: Outcome, evidence: Evidence, walls: Obstacles | None, within: float
) -> list[Event]:  # fmt: skip
    """Returns all events of a run except its collisions, ordered by onset.

    Args:
        run: the planned run.
        outcome: outcome of the run.
        evidence: evidence from its bag.
        walls: occupied cells of the map; None = unknown.
        within: distance from the goal at which it counts as reached, metres.
    """
    motion = Motion.of(evidence, float(run.physics.get("cmd_vel_timeout", 0.5)))
    events = [*_bad_commands(outcome, evidence), *_standing(run, evidence, motion), *_slips(evidence, motion)]
    events += _without_plan_or_command(run, evidence, motion, within)
    if evidence.estimate is not None:
        events += _localisation(evidence.estimate, evidence.truth, evidence.duration)
    if walls is not None:
        events += _plans(run, evidence, walls)
    return sorted(events, key=lambda event: event.begin)


def collision(run: RunSpec, evidence: Evidence, touch: Touch) -> Event:
    """Returns a contact as an event."""
    other = name_of(run, touch.other)
    xy, what = None, f"the robot hit {other}"
    if evidence.truth is not None:
        before = max(0.0, touch.begin - BEFORE_IMPACT_S)
        (x0, y0, _), (x, y, _) = evidence.truth.at(before), evidence.truth.at(touch.begin)
        xy, driven = (float(x), float(y)), math.hypot(x - x0, y - y0)
        if driven >= STANDS_M:
            what += f" at {driven / (touch.begin - before):.2f} m/s"
        elif touch.other in {person.name for person in run.people}:
            what = f"{other} walked into the standing robot"
    return Event("collision", touch.begin, max(touch.end, touch.begin), what, xy, other=touch.other)


def name_of(run: RunSpec, body: str) -> str:
    """Returns the designation of a body in a text."""
    if body in {person.name for person in run.people}:
        return f"the person {body}"
    if body in run.closed_doors:
        return f"the closed door {body}"
    return body or "something"


def _commands_in_force(commands: Commands | None, t: F64, timeout: float) -> tuple[F64, F64, F64]:
    """Returns forward, sideways and turning velocity in force at times (N,), each (N,): those of the last finite command, 0 if too old."""
    if commands is None or not commands.is_finite.any():
        return np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    finite = commands.is_finite
    index = np.searchsorted(commands.t[finite], t + 1e-9, side="right") - 1
    valid = (index >= 0) & (t - commands.t[finite][index] <= timeout)
    forward, sideways, turning = (
        np.where(valid, values[finite][index], 0.0) for values in (commands.forward, commands.sideways, commands.turning)
    )
    return forward, sideways, turning


def _xy(evidence: Evidence, t: float) -> tuple[float, float] | None:
    if evidence.truth is None:
        return None
    x, y, _ = evidence.truth.at(t)
    return float(x), float(y)


def _intervals(mask: Bools) -> list[tuple[int, int]]:
    """Returns the first and last index of each interval of True in a mask (N,)."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def _bad_commands(outcome: Outcome, evidence: Evidence) -> Iterator[Event]:
    """Yields events for commands that are not finite or of an unsupported type."""
    if evidence.unsupported_commands and evidence.commands is None:
        what = f"the stack sent commands that no robot accepts: {evidence.unsupported_commands}, must be Twist or TwistStamped on cmd_vel"
        yield Event("command ignored", 0.0, evidence.duration, what, _xy(evidence, 0.0))
    bad = ~evidence.commands.is_finite if evidence.commands is not None else np.zeros(0, dtype=bool)
    if evidence.commands is not None and bad.mean() >= BAD_SHARE:
        times = evidence.commands.t[bad]
        number, total = int(bad.sum()), len(bad)
        what = f"the stack sent commands that are not finite ({number} of {total} on {evidence.commands.topic})"
        begin, end = float(times[0]), float(times[-1])
        yield Event("bad command", begin, end, what, _xy(evidence, begin))
    elif outcome.refused_commands - int(bad.sum()) > BAD_SHARE * (len(bad) + outcome.refused_commands):
        what = f"the simulation rejected {outcome.refused_commands} commands, which were not finite or malformed"
        yield Event("bad command", 0.0, evidence.duration, what, _xy(evidence, 0.0))


def _without_plan_or_command(run: RunSpec, evidence: Evidence, motion: Motion, within: float) -> Iterator[Event]:
    """Yields events for a stack that never planned, never commanded, or stopped commanding before the goal."""
    moving = motion.is_commanded
    if evidence.commands is not None and (~evidence.commands.is_finite).mean() >= BAD_SHARE:
        return
    if moving.any():
        last = float(motion.t[np.flatnonzero(moving)[-1]])
        is_at_goal = evidence.truth is not None and math.dist(evidence.truth.last[:2], run.goal[:2]) <= within
        if evidence.duration - last >= STOPPED_S and not is_at_goal:
            what = f"the stack sent its last nonzero command {evidence.duration - last:.1f} s before the end"
            yield Event("no command", last, evidence.duration, what, _xy(evidence, last))
    elif not evidence.unsupported_commands:
        commands = "no command" if evidence.commands is None else "only zero commands"
        if evidence.plans:
            begin = evidence.plans[0].t
            yield Event("no command", begin, evidence.duration, f"the stack had a plan and sent {commands}", _xy(evidence, begin))
        else:
            what = f"the stack had its goal, but published no plan and sent {commands}"
            yield Event("no plan", 0.0, evidence.duration, what, _xy(evidence, 0.0))


def _standing(run: RunSpec, evidence: Evidence, motion: Motion) -> Iterator[Event]:
    """Yields events for a robot that stood although it was commanded to move: blocked, spinning wheels, or ignored commands."""
    span = round(STANDS_S / GRID_S)
    if motion.truth is None or len(motion.t) <= span:
        return
    forward, sideways, turning = (
        _sums(values, span)[:-1] * GRID_S for values in (motion.forward, motion.sideways, motion.turning)
    )
    commanded_m, commanded_rad = np.hypot(forward, sideways), np.abs(turning)
    moved_m, moved_rad = _moved(motion.truth, span)
    commanded = _sums(motion.is_commanded.astype(np.float64), span)[:-1] >= COMMANDED_SHARE * span
    go, turn = commanded_m >= COMMANDED_M, commanded_rad >= COMMANDED_RAD
    stands_m = moved_m <= np.maximum(STANDS_M, FOLLOWED_SHARE * commanded_m)
    stands_rad = moved_rad <= np.maximum(STANDS_RAD, FOLLOWED_SHARE * commanded_rad)
    x, y, _ = motion.truth
    intervals: list[tuple[int, int]] = []
    for first, last in _intervals(commanded & (go | turn) & (~go | stands_m) & (~turn | stands_rad)):
        # A pause in the commands does not end the interval.
        previous = intervals[-1] if intervals else None
        if (
            previous is not None
            and first - previous[1] <= 2 * span
            and math.hypot(x[first] - x[previous[1]], y[first] - y[previous[1]]) < STANDS_M
        ):
            intervals[-1] = previous[0], last
        else:
            intervals.append((first, last))
    for first, last in intervals:
        begin, end = float(motion.t[first]), float(motion.t[last + span])
        wheels = 0.0
        if motion.odometry is not None:
            odometry_m, odometry_rad = (moved[first] for moved in _moved(motion.odometry, span))
            wheels = float(
                max(odometry_m / max(commanded_m[first], COMMANDED_M), odometry_rad / max(commanded_rad[first], COMMANDED_RAD))
            )
        what = f"the robot stood for {end - begin:.1f} s although it was commanded to {'drive' if go[first] else 'turn'}"
        # A contact often begins before the robot stops.
        near = [touch for touch in evidence.touches or () if touch.end >= begin - GRID_S and touch.begin <= end]
        if near:
            begin = max(begin, near[0].begin)
            others = ", ".join(dict.fromkeys(name_of(run, touch.other) for touch in near[:3]))
            yield Event("blocked", begin, end, f"the robot was blocked by {others} for {end - begin:.1f} s", _xy(evidence, begin))
        elif wheels >= WHEELS_SHARE:
            yield Event("slipped", begin, end, f"{what}, and its wheels turned on the spot", _xy(evidence, begin))
        else:
            yield Event("command ignored", begin, end, what + _why_ignored(evidence, begin, end), _xy(evidence, begin))


def _why_ignored(evidence: Evidence, begin: float, end: float) -> str:
    """Returns the known reason why commands had no effect."""
    if evidence.touches is None:
        return ", and the bag does not show whether it touched anything"
    if evidence.applied is not None and not ((evidence.applied >= begin) & (evidence.applied <= end)).any():
        return ", and touched nothing: the simulation received none of the commands; their type or QoS does not match"
    return ", and touched nothing"


def _slips(evidence: Evidence, motion: Motion) -> Iterator[Event]:
    """Yields events for odometry that shows much more motion than the truth, while nothing was touched."""
    stride, span = 5, round(SLIP_S / GRID_S) // 5
    if motion.truth is None or motion.odometry is None:
        return
    t = motion.t[::stride]
    if len(t) <= span:
        return
    free = np.ones(len(t), dtype=bool)
    for touch in evidence.touches or ():
        free &= (t < touch.begin - GRID_S) | (t > touch.end + GRID_S)
    true_m, true_rad = _lengths(motion.truth[:, ::stride], span)
    odometry_m, odometry_rad = _lengths(motion.odometry[:, ::stride], span)
    slips = (odometry_m - true_m > SLIP_M) & (odometry_m > SLIP_RATIO * true_m)
    spins = (odometry_rad - true_rad > SLIP_RAD) & (odometry_rad > SLIP_RATIO * true_rad)
    untouched = _sums((~free).astype(np.float64), span + 1) == 0.0
    for first, last in _intervals((slips | spins) & untouched):
        if slips[first]:
            motions = f"odometry measured {odometry_m[first]:.2f} m in {SLIP_S:g} s, the robot moved {true_m[first]:.2f} m"
        else:
            by_wheels, turned = math.degrees(odometry_rad[first]), math.degrees(true_rad[first])
            motions = f"odometry measured {by_wheels:.0f} deg in {SLIP_S:g} s, the robot turned {turned:.0f} deg"
        begin = float(t[first])
        yield Event(
            "slipped", begin, float(t[min(last + span, len(t) - 1)]), f"the wheels slipped: {motions}", _xy(evidence, begin)
        )


def _sums(values: F64, width: int) -> F64:
    """Returns the moving sums (N - width + 1,) over ``width`` values of (N,); N is ``width`` or more."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[width:] - total[:-width])


def _moved(poses: F64, span: int) -> tuple[F64, F64]:
    """Returns displacement and rotation of poses (3, N) within windows of ``span`` steps, (N - span,) each, m and rad."""
    count, half = poses.shape[1] - span, span // 2
    begin, middle, end = poses[:, :count], poses[:, half : half + count], poses[:, span:]
    displacement = np.maximum(np.hypot(*(end - begin)[:2]), np.hypot(*(middle - begin)[:2]))
    return displacement, np.maximum(np.abs(end[2] - begin[2]), np.abs(middle[2] - begin[2]))


def _lengths(poses: F64, span: int) -> tuple[F64, F64]:
    """Returns path length and accumulated rotation of poses (3, N) in windows of ``span`` steps, (N - span,) each, m and rad."""
    steps = np.diff(poses, axis=1)
    metres, radians = (np.concatenate([[0.0], np.cumsum(values)]) for values in (np.hypot(steps[0], steps[1]), np.abs(steps[2])))
    return metres[span:] - metres[:-span], radians[span:] - radians[:-span]


def _localisation(estimate: Estimate, truth: Poses | None, duration: float) -> list[Event]:
    """Returns events for jumps of the estimate and for intervals in which it was off."""
    if truth is None:
        return [_jump(j, j.t, None) for j in _jumps(estimate, None)]
    t, (off, turned) = estimate.poses.t, errors(estimate.poses, truth)
    jumps = list(_jumps(estimate, truth))
    out: list[Event] = []
    last = -math.inf
    for jump in jumps:
        later = np.flatnonzero((t >= jump.t + GRID_S) & (off < BACK_M) & (turned < BACK_RAD))
        end = float(t[later[0]]) if len(later) else duration
        if jump.t > last:
            out.append(_jump(jump, end, truth))
            last = end
    for begin, end, index in _off(t, off, turned, duration):
        # A jump that started the interval is the event.
        if not any(event.begin - GRID_S <= begin <= event.end for event in out if event.kind == "localisation jumped"):
            worst, most = (float(values[index:][t[index:] <= end].max()) for values in (off, turned))
            what = f"the localisation was off for {end - begin:.1f} s, by up to {worst:.2f} m and {math.degrees(most):.0f} deg"
            x, y, _ = truth.at(begin)
            out.append(Event("localisation off", begin, end, what, (float(x), float(y))))
    return out


def _off(t: F64, off: F64, turned: F64, duration: float) -> Iterator[tuple[float, float, int]]:
    """Yields begin (s), end (s) and first index of intervals in which the estimate is off, from errors (N,) in metres and radians."""
    above, below = (off > OFF_M) | (turned > OFF_RAD), (off < BACK_M) & (turned < BACK_RAD)
    first = -1
    last_above = 0.0
    for i in range(len(t)):
        if above[i]:
            first = i if first < 0 else first
            last_above = float(t[i])
        if first >= 0 and (below[i] or i == len(t) - 1):
            if last_above - t[first] >= OFF_S:
                yield float(t[first]), float(t[i]) if below[i] else duration, first
            first = -1


@dataclass(frozen=True, slots=True)
class _Jump:
    """A large change of map -> odom."""

    t: float
    metres: float
    radians: float
    before: float
    after: float
    """Errors against the truth before and after the jump, metres; NaN = unknown."""


def _jumps(estimate: Estimate, truth: Poses | None) -> Iterator[_Jump]:
    odometry, corrections = estimate.odometry, estimate.corrections
    if odometry is None or len(corrections) < 2:
        return
    t = corrections[1:, 0]
    base = odometry.at(t)
    before, after = compose(corrections[:-1, 1:].T, base), compose(corrections[1:, 1:].T, base)
    metres, radians = np.hypot(*(after - before)[:2]), np.abs(after[2] - before[2])
    for i in np.flatnonzero((metres > JUMP_M) | (radians > JUMP_RAD)):
        # The evidence contains no odometry from before the run.
        if t[i] < odometry.t[0]:
            continue
        was = now = math.nan
        if truth is not None:
            (was, was_rad), (now, now_rad) = (_error(t[i : i + 1], poses[:, i : i + 1], truth) for poses in (before, after))
            if now - was < JUMP_WORSE_M and now_rad - was_rad < JUMP_WORSE_RAD:
                continue
        yield _Jump(float(t[i]), float(metres[i]), float(radians[i]), was, now)


def _error(t: F64, pose: F64, truth: Poses) -> tuple[float, float]:
    """Returns the error of one pose (3, 1) against the truth at its time (1,), metres and radians."""
    off, turned = errors(Poses(t, *pose), truth)
    return float(off[0]), float(turned[0])


def _jump(jump: _Jump, end: float, truth: Poses | None) -> Event:
    rotation = f" and {math.degrees(jump.radians):.0f} deg" if jump.radians >= _REPORTED_RAD else ""
    what = f"the localisation jumped by {jump.metres:.2f} m{rotation}"
    if truth is None:
        return Event("localisation jumped", jump.t, end, what)
    x, y, _ = truth.at(jump.t)
    what += f", from {jump.before:.2f} m off the truth to {jump.after:.2f} m"
    return Event("localisation jumped", jump.t, end, what, (float(x), float(y)))


@dataclass(slots=True)
class _Overlap:
    """A place at which consecutive plans lead too close to an obstacle."""

    obstacle: str
    begin: float
    """s since the goal."""
    what: str
    spots: list[tuple[float, float]]
    """Position of the overlap in each of the plans, map frame, metres."""
    room: float
    """Distance between the first plan and the obstacle, metres."""

    def is_same(self, obstacle: str, spot: tuple[float, float]) -> bool:
        """Returns whether an overlap with an obstacle at a spot is this one."""
        return obstacle == self.obstacle and math.dist(spot, self.spots[-1]) <= PLAN_SAME_M

    def event(self, end: float, evidence: Evidence) -> Event:
        """Returns the overlap as an event that ends at ``end``, s since the goal."""
        return Event(
            "plan through obstacle",
            self.begin,
            end,
            self.what,
            _xy(evidence, self.begin),
            tuple(self.spots),
            self.obstacle,
            self.room,
        )


def _plans(run: RunSpec, evidence: Evidence, walls: Obstacles) -> Iterator[Event]:
    """Yields events for plans along which the robot's circle overlaps the map or a body; consecutive plans at one place are one event."""
    if evidence.truth is None or not evidence.plans:
        return
    obstacles = [(walls, PLAN_TOLERANCE * walls.edge), *((body, PLAN_TOLERANCE_M) for body in body_obstacles(run))]
    active: list[_Overlap] = []
    for plan in evidence.plans:
        x, y, _ = evidence.truth.at(plan.t)
        points = _ahead(plan.points, (float(x), float(y)), walls.edge / 2.0)
        overlaps = [
            overlap for obstacle, tolerance in obstacles for overlap in _overlaps(points, obstacle, tolerance, run, plan.t)
        ]
        continued = []
        for overlap in active:
            same = next((new for new in overlaps if overlap.is_same(new.obstacle, new.spots[0])), None)
            if same is None:
                yield overlap.event(plan.t, evidence)
            else:
                overlaps.remove(same)
                overlap.spots += same.spots
                continued.append(overlap)
        active = continued + overlaps
    for overlap in active:
        yield overlap.event(evidence.duration, evidence)


def _ahead(points: F64, robot: tuple[float, float], step: float) -> F64:
    """Returns the part of a path (N, 2) ahead of the robot, from ``PLAN_BEGIN_M`` past its nearest point, as points (M, 2) at most ``step`` apart."""
    lengths = np.hypot(*np.diff(points, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, s[-1], max(2, math.ceil(s[-1] / step) + 1))
    dense = np.column_stack([np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])])
    distance = np.hypot(dense[:, 0] - robot[0], dense[:, 1] - robot[1])
    nearest = int(distance.argmin())
    return np.asarray(dense[at > at[nearest] + PLAN_BEGIN_M])


def _overlaps(points: F64, obstacle: Obstacles, tolerance: float, run: RunSpec, t: float) -> list[_Overlap]:
    """Returns the deepest overlap in each interval of a path (N, 2) along which the robot's circle overlaps an obstacle."""
    limit = run.radius - tolerance
    if not len(points) or limit <= 0.0:
        return []
    rough, _ = obstacle.tree.query(points, distance_upper_bound=limit + obstacle.edge)
    near = np.flatnonzero(np.isfinite(rough))
    distances = np.full(len(points), np.inf)
    if len(near):
        distances[near] = obstacle.distance(points[near])
    result = []
    for first, last in _intervals(distances < limit):
        worst = first + int(distances[first : last + 1].argmin())
        x, y = (float(c) for c in points[worst])
        what = (
            f"the plan led through {name_of(run, obstacle.name)} at ({x:.2f}, {y:.2f}): {distances[worst]:.2f} m from it, "
            f"with a robot radius of {run.radius:.2f} m"
        )
        result.append(_Overlap(obstacle.name, t, what, [(x, y)], float(distances[worst])))
    return result
