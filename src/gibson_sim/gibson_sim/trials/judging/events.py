"""Finds in the evidence of a run what went wrong, each with the time at which it began. Rules and limits: ``docs/trial_verdicts.md``.

An event is no accusation: ``cause.py`` decides which of them lie before a failure and have to do with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.plots.touches import Touch
from gibson_sim.trials.judging.evidence import Commands, Estimate, Evidence, Poses, composed, errors
from gibson_sim.trials.judging.obstacles import Obstacles, things_of
from gibson_sim.trials.records import CauseKind, Outcome, RunSpec

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

GRID_S = 0.1
"""Period at which motion is looked at, s: the robot's pose changes little meanwhile."""
JUMP_M, JUMP_RAD = 0.5, math.radians(30.0)
"""Least change of map -> odom between two updates, at the robot, that is a jump: a filter corrects by centimetres, and half a metre is
another place in a room."""
JUMP_WORSE_M, JUMP_WORSE_RAD = 0.25, math.radians(15.0)
"""Least growth of the error against the truth in a jump: one that leads back to the truth is a recovery."""
OFF_M, OFF_RAD = 0.5, math.radians(30.0)
"""Error against the truth from which the localisation is off: a plan by it leads the robot's circle into a wall."""
BACK_M, BACK_RAD = 0.25, math.radians(15.0)
"""Error below which it has recovered: half of that, so that an error about the limit is one event."""
OFF_S = 1.0
"""Least time above that error, s: shorter ones are latency."""
STANDS_S = 2.0
"""Time over which a robot has to follow its commands, s: longer than any acceleration from rest, and than a latency."""
COMMANDED_M, COMMANDED_RAD = 0.1, 0.2
"""Least motion that commands have to ask for in this time: on average 0.05 m/s or 0.1 rad/s."""
COMMANDED_SHARE = 0.9
"""Least share of this time with commands other than zero."""
FOLLOWED = 0.1
"""Share of the commanded motion up to which a robot stands."""
STANDS_M, STANDS_RAD = 0.02, math.radians(2.0)
"""Motion in this time up to which a robot stands: the trembling of contacts."""
BEFORE_IMPACT_S = 0.5
"""Time before a contact over which the robot's speed is told, s."""
WHEELS = 0.5
"""Share of the commanded motion from which the wheels turned, by odometry."""
SLIP_S = 5.0
"""Time over which odometry and truth are compared, s."""
SLIP_RATIO = 1.5
"""Least ratio of the motion by odometry and the true one that is slip: a third of the motion is lost."""
SLIP_M, SLIP_RAD = 0.3, math.radians(45.0)
"""Least motion in this time that odometry tells beyond the truth."""
BAD_SHARE = 0.1
"""Least share of commands that are not finite: a single one is refused, and the next one comes."""
STOPPED_S = 5.0
"""Time without a command other than zero at the end of a run from which the stack had stopped commanding, s."""
ZERO = 1e-3
"""Velocity up to which a command is zero, m/s and rad/s."""
PLAN_TOLERANCE = 0.5
"""Part of a cell of the map by which the robot's circle may overlap an obstacle in a plan: planners work on centres of cells."""
PLAN_TOLERANCE_M = 0.02
"""The same, metres, for things."""
PLAN_BEGIN_M = 0.3
"""Length of a plan, m, that does not count: the robot stands there, so it fits."""
PLAN_SAME_M = 1.0
"""Greatest distance between places at which two consecutive plans overlap one obstacle that is one place, metres."""
PLAN_NEAR_M = 0.5
"""Greatest distance, m, between the robot's circle and where its plan overlaps an obstacle at which the two have to do with each other."""

_TOLD_RAD = math.radians(5.0)
"""Least turn in a jump that is told."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that went wrong."""

    kind: CauseKind
    begin: float
    """s since the goal; negative = before it."""
    end: float
    """When it was over; the end of the run if it never was."""
    what: str
    """A clause in the past tense with a subject, without time and place."""
    xy: tuple[float, float] | None = None
    """Where the robot truly was, map frame, metres; None = unknown."""
    spots: tuple[tuple[float, float], ...] = ()
    """Where it matters, metres; empty = everywhere."""
    other: str = ""
    """Name of the obstacle or body that it is about."""
    room: float = 0.0
    """Least room that it left the robot, metres: of plans of one time, the tightest comes first."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Commands and motion at a period of ``GRID_S``."""

    t: F64
    """(N,), s since the goal."""
    truth: F64 | None
    odometry: F64 | None
    """x, y, yaw, (3, N)."""
    forward: F64
    sideways: F64
    turning: F64
    """(N,), the command in force, m/s and rad/s; 0 without one."""

    @property
    def is_commanded(self) -> Bools:
        """(N,): whether the command in force is other than zero."""
        return np.asarray(np.maximum.reduce([np.abs(self.forward), np.abs(self.sideways), np.abs(self.turning)]) > ZERO)

    @classmethod
    def of(cls, evidence: Evidence, timeout: float) -> Motion:
        """Returns the motion of a run; commands hold for ``timeout`` seconds."""
        t = np.arange(0.0, evidence.duration + GRID_S / 2.0, GRID_S)
        truth = None if evidence.truth is None else evidence.truth.at(t)
        odometry = None if evidence.odometry is None else evidence.odometry.at(t)
        return cls(t, truth, odometry, *_held(evidence.commands, t, timeout))


def find_events(
    run: RunSpec, outcome: Outcome, evidence: Evidence, walls: Obstacles | None, within: float
) -> list[Event]:  # fmt: skip
    """Returns all events of a run but its collisions, in the order of their beginnings.

    Args:
        run: as it was planned.
        outcome: how it ended.
        evidence: what its bag tells.
        walls: occupied cells of the map; None = unknown.
        within: distance from the goal at which the robot is there, metres.
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
        xy, way = (float(x), float(y)), math.hypot(x - x0, y - y0)
        if way >= STANDS_M:
            what += f" at {way / (touch.begin - before):.2f} m/s"
        elif touch.other in {person.name for person in run.people}:
            what = f"{other} walked into the robot, which stood"
    return Event("collision", touch.begin, max(touch.end, touch.begin), what, xy, other=touch.other)


def name_of(run: RunSpec, body: str) -> str:
    """Returns what a body is called in a text."""
    if body in {person.name for person in run.people}:
        return f"the person {body}"
    if body in run.closed_doors:
        return f"the closed door {body}"
    return body or "something"


def _held(commands: Commands | None, t: F64, timeout: float) -> tuple[F64, F64, F64]:
    """Returns the velocities in force at times (N,): of the last finite command, unless it is too old."""
    if commands is None or not commands.is_finite.any():
        return np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    good = commands.is_finite
    at = np.searchsorted(commands.t[good], t + 1e-9, side="right") - 1
    valid = (at >= 0) & (t - commands.t[good][at] <= timeout)
    forward, sideways, turning = (
        np.where(valid, values[good][at], 0.0) for values in (commands.forward, commands.sideways, commands.turning)
    )
    return forward, sideways, turning


def _xy(evidence: Evidence, t: float) -> tuple[float, float] | None:
    if evidence.truth is None:
        return None
    x, y, _ = evidence.truth.at(t)
    return float(x), float(y)


def _stretches(mask: Bools) -> list[tuple[int, int]]:
    """Returns first and last index of each run of True in (N,)."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def _bad_commands(outcome: Outcome, evidence: Evidence) -> Iterator[Event]:
    """Yields commands that are not finite, or of a type that no robot takes."""
    if evidence.wrong_commands and evidence.commands is None:
        what = f"the stack sent commands that no robot takes: {evidence.wrong_commands}, must be Twist or TwistStamped on cmd_vel"
        yield Event("command ignored", 0.0, evidence.duration, what, _xy(evidence, 0.0))
    bad = ~evidence.commands.is_finite if evidence.commands is not None else np.zeros(0, dtype=bool)
    if evidence.commands is not None and bad.mean() >= BAD_SHARE:
        times = evidence.commands.t[bad]
        number, of = int(bad.sum()), len(bad)
        what = f"the stack sent commands that are not finite ({number} of {of} on {evidence.commands.topic})"
        begin, end = float(times[0]), float(times[-1])
        yield Event("bad command", begin, end, what, _xy(evidence, begin))
    elif outcome.refused_commands - int(bad.sum()) > BAD_SHARE * (len(bad) + outcome.refused_commands):
        what = f"the simulation refused {outcome.refused_commands} commands, which were not finite or of another form"
        yield Event("bad command", 0.0, evidence.duration, what, _xy(evidence, 0.0))


def _without_plan_or_command(run: RunSpec, evidence: Evidence, motion: Motion, within: float) -> Iterator[Event]:
    """Yields that the stack never planned or never commanded, or stopped commanding before the goal."""
    moving = motion.is_commanded
    if evidence.commands is not None and (~evidence.commands.is_finite).mean() >= BAD_SHARE:
        return
    if moving.any():
        last = float(motion.t[np.flatnonzero(moving)[-1]])
        is_there = evidence.truth is not None and math.dist(evidence.truth.last[:2], run.goal[:2]) <= within
        if evidence.duration - last >= STOPPED_S and not is_there:
            what = f"the stack sent its last command other than zero, {evidence.duration - last:.1f} s before the end"
            yield Event("no command", last, evidence.duration, what, _xy(evidence, last))
    elif not evidence.wrong_commands:
        commands = "no command" if evidence.commands is None else "only commands of zero"
        if evidence.plans:
            begin = evidence.plans[0].t
            yield Event("no command", begin, evidence.duration, f"the stack had a plan and sent {commands}", _xy(evidence, begin))
        else:
            what = f"the stack had its goal, but published no plan and sent {commands}"
            yield Event("no plan", 0.0, evidence.duration, what, _xy(evidence, 0.0))


def _standing(run: RunSpec, evidence: Evidence, motion: Motion) -> Iterator[Event]:
    """Yields when the robot stood although it was commanded to move: blocked, wheels that spin, or ignored commands."""
    span = round(STANDS_S / GRID_S)
    if motion.truth is None or len(motion.t) <= span:
        return
    forward, sideways, turning = (
        _sums(values, span)[:-1] * GRID_S for values in (motion.forward, motion.sideways, motion.turning)
    )
    asked_m, asked_rad = np.hypot(forward, sideways), np.abs(turning)
    moved_m, moved_rad = _moved(motion.truth, span)
    commanded = _sums(motion.is_commanded.astype(np.float64), span)[:-1] >= COMMANDED_SHARE * span
    go, turn = asked_m >= COMMANDED_M, asked_rad >= COMMANDED_RAD
    stands_m = moved_m <= np.maximum(STANDS_M, FOLLOWED * asked_m)
    stands_rad = moved_rad <= np.maximum(STANDS_RAD, FOLLOWED * asked_rad)
    x, y, _ = motion.truth
    stretches: list[tuple[int, int]] = []
    for first, last in _stretches(commanded & (go | turn) & (~go | stands_m) & (~turn | stands_rad)):
        # A pause in the commands does not end it.
        before = stretches[-1] if stretches else None
        if (
            before is not None
            and first - before[1] <= 2 * span
            and math.hypot(x[first] - x[before[1]], y[first] - y[before[1]]) < STANDS_M
        ):
            stretches[-1] = before[0], last
        else:
            stretches.append((first, last))
    for first, last in stretches:
        begin, end = float(motion.t[first]), float(motion.t[last + span])
        wheels = 0.0
        if motion.odometry is not None:
            told_m, told_rad = (moved[first] for moved in _moved(motion.odometry, span))
            wheels = float(max(told_m / max(asked_m[first], COMMANDED_M), told_rad / max(asked_rad[first], COMMANDED_RAD)))
        what = f"the robot stood for {end - begin:.1f} s although it was commanded to {'drive' if go[first] else 'turn'}"
        # Contacts outlast the moment at which a robot stops.
        near = [touch for touch in evidence.touches or () if touch.end >= begin - GRID_S and touch.begin <= end]
        if near:
            begin = max(begin, near[0].begin)
            others = ", ".join(dict.fromkeys(name_of(run, touch.other) for touch in near[:3]))
            yield Event("blocked", begin, end, f"the robot was blocked by {others} for {end - begin:.1f} s", _xy(evidence, begin))
        elif wheels >= WHEELS:
            yield Event("slipped", begin, end, f"{what}, and its wheels turned on the spot", _xy(evidence, begin))
        else:
            yield Event("command ignored", begin, end, what + _why_ignored(evidence, begin, end), _xy(evidence, begin))


def _why_ignored(evidence: Evidence, begin: float, end: float) -> str:
    """Returns what is known of why commands had no effect."""
    if evidence.touches is None:
        return ", and the bag does not tell whether it touched anything"
    if evidence.applied is not None and not ((evidence.applied >= begin) & (evidence.applied <= end)).any():
        return ", and touched nothing: the simulation received none of the commands, their type or QoS differs"
    return ", and touched nothing"


def _slips(evidence: Evidence, motion: Motion) -> Iterator[Event]:
    """Yields when odometry tells much more motion than there was, while nothing was touched."""
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
    odo_m, odo_rad = _lengths(motion.odometry[:, ::stride], span)
    slips = (odo_m - true_m > SLIP_M) & (odo_m > SLIP_RATIO * true_m)
    spins = (odo_rad - true_rad > SLIP_RAD) & (odo_rad > SLIP_RATIO * true_rad)
    untouched = _sums((~free).astype(np.float64), span + 1) == 0.0
    for first, last in _stretches((slips | spins) & untouched):
        if slips[first]:
            told = f"odometry told {odo_m[first]:.2f} m in {SLIP_S:g} s, the robot moved {true_m[first]:.2f} m"
        else:
            by_wheels, turned = math.degrees(odo_rad[first]), math.degrees(true_rad[first])
            told = f"odometry told {by_wheels:.0f} deg in {SLIP_S:g} s, the robot turned {turned:.0f} deg"
        begin = float(t[first])
        yield Event("slipped", begin, float(t[min(last + span, len(t) - 1)]), f"the wheels slipped: {told}", _xy(evidence, begin))


def _sums(values: F64, width: int) -> F64:
    """Returns (N - width + 1,): the sums of ``width`` neighbouring values of (N,), at least ``width`` of them."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[width:] - total[:-width])


def _moved(poses: F64, span: int) -> tuple[F64, F64]:
    """Returns how far and how much poses (3, N) have moved and turned within windows of ``span`` steps, (N - span,) each, m and rad."""
    count, half = poses.shape[1] - span, span // 2
    begin, middle, end = poses[:, :count], poses[:, half : half + count], poses[:, span:]
    far = np.maximum(np.hypot(*(end - begin)[:2]), np.hypot(*(middle - begin)[:2]))
    return far, np.maximum(np.abs(end[2] - begin[2]), np.abs(middle[2] - begin[2]))


def _lengths(poses: F64, span: int) -> tuple[F64, F64]:
    """Returns path length and sum of turns of poses (3, N) in windows of ``span`` steps, (N - span,) each, m and rad."""
    steps = np.diff(poses, axis=1)
    metres, radians = (np.concatenate([[0.0], np.cumsum(values)]) for values in (np.hypot(steps[0], steps[1]), np.abs(steps[2])))
    return metres[span:] - metres[:-span], radians[span:] - radians[:-span]


def _localisation(estimate: Estimate, truth: Poses | None, duration: float) -> list[Event]:
    """Returns jumps of the estimate, and times at which it was off."""
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
        # The jump that began it is the event.
        if not any(event.begin - GRID_S <= begin <= event.end for event in out if event.kind == "localisation jumped"):
            worst, most = (float(values[index:][t[index:] <= end].max()) for values in (off, turned))
            what = f"the localisation was off for {end - begin:.1f} s, by up to {worst:.2f} m and {math.degrees(most):.0f} deg"
            x, y, _ = truth.at(begin)
            out.append(Event("localisation off", begin, end, what, (float(x), float(y))))
    return out


def _off(t: F64, off: F64, turned: F64, duration: float) -> Iterator[tuple[float, float, int]]:
    """Yields begin, end and first index of times at which the estimate is off, from errors (N,) in metres and radians."""
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
    """Errors against the truth, metres; NaN = unknown."""


def _jumps(estimate: Estimate, truth: Poses | None) -> Iterator[_Jump]:
    odometry, corrections = estimate.odometry, estimate.corrections
    if odometry is None or len(corrections) < 2:
        return
    t = corrections[1:, 0]
    base = odometry.at(t)
    before, after = composed(corrections[:-1, 1:].T, base), composed(corrections[1:, 1:].T, base)
    metres, radians = np.hypot(*(after - before)[:2]), np.abs(after[2] - before[2])
    for i in np.flatnonzero((metres > JUMP_M) | (radians > JUMP_RAD)):
        # Odometry of before the run is not in the evidence.
        if t[i] < odometry.t[0]:
            continue
        was = now = math.nan
        if truth is not None:
            (was, was_rad), (now, now_rad) = (_error(t[i : i + 1], poses[:, i : i + 1], truth) for poses in (before, after))
            if now - was < JUMP_WORSE_M and now_rad - was_rad < JUMP_WORSE_RAD:
                continue
        yield _Jump(float(t[i]), float(metres[i]), float(radians[i]), was, now)


def _error(t: F64, pose: F64, truth: Poses) -> tuple[float, float]:
    """Returns how far one pose (3, 1) is from the truth at its time (1,), metres and radians."""
    off, turned = errors(Poses(t, *pose), truth)
    return float(off[0]), float(turned[0])


def _jump(jump: _Jump, end: float, truth: Poses | None) -> Event:
    turn = f" and {math.degrees(jump.radians):.0f} deg" if jump.radians >= _TOLD_RAD else ""
    what = f"the localisation jumped by {jump.metres:.2f} m{turn}"
    if truth is None:
        return Event("localisation jumped", jump.t, end, what)
    x, y, _ = truth.at(jump.t)
    what += f", from {jump.before:.2f} m off the truth to {jump.after:.2f} m"
    return Event("localisation jumped", jump.t, end, what, (float(x), float(y)))


@dataclass(slots=True)
class _Overlap:
    """A place at which one plan after the other leads too near to an obstacle."""

    obstacle: str
    begin: float
    """s since the goal."""
    what: str
    spots: list[tuple[float, float]]
    """Of each of the plans, metres."""
    room: float
    """Distance between the first plan and the obstacle, metres."""

    def is_at(self, obstacle: str, spot: tuple[float, float]) -> bool:
        """Returns whether another overlap is the same."""
        return obstacle == self.obstacle and math.dist(spot, self.spots[-1]) <= PLAN_SAME_M

    def event(self, end: float, evidence: Evidence) -> Event:
        """Returns it as an event."""
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
    """Yields plans along which, ahead of the robot, its circle overlaps the map or a thing; consecutive ones at one place are one event."""
    if evidence.truth is None or not evidence.plans:
        return
    obstacles = [(walls, PLAN_TOLERANCE * walls.edge), *((thing, PLAN_TOLERANCE_M) for thing in things_of(run))]
    going: list[_Overlap] = []
    for plan in evidence.plans:
        x, y, _ = evidence.truth.at(plan.t)
        points = _ahead(plan.points, (float(x), float(y)), walls.edge / 2.0)
        found = [place for obstacle, tolerance in obstacles for place in _overlaps(points, obstacle, tolerance, run, plan.t)]
        goes_on = []
        for one in going:
            again = next((new for new in found if one.is_at(new.obstacle, new.spots[0])), None)
            if again is None:
                yield one.event(plan.t, evidence)
            else:
                found.remove(again)
                one.spots += again.spots
                goes_on.append(one)
        going = goes_on + found
    for one in going:
        yield one.event(evidence.duration, evidence)


def _ahead(points: F64, robot: tuple[float, float], step: float) -> F64:
    """Returns a path (N, 2) as points at most ``step`` apart, from a bit after the point that is nearest to the robot, metres."""
    lengths = np.hypot(*np.diff(points, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, s[-1], max(2, math.ceil(s[-1] / step) + 1))
    dense = np.column_stack([np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])])
    distance = np.hypot(dense[:, 0] - robot[0], dense[:, 1] - robot[1])
    nearest = int(distance.argmin())
    return np.asarray(dense[at > at[nearest] + PLAN_BEGIN_M])


def _overlaps(points: F64, obstacle: Obstacles, tolerance: float, run: RunSpec, t: float) -> list[_Overlap]:
    """Returns the tightest place of each stretch of a path (N, 2) along which the robot's circle overlaps an obstacle."""
    limit = run.radius - tolerance
    if not len(points) or limit <= 0.0:
        return []
    rough, _ = obstacle.tree.query(points, distance_upper_bound=limit + obstacle.edge)
    near = np.flatnonzero(np.isfinite(rough))
    distances = np.full(len(points), np.inf)
    if len(near):
        distances[near] = obstacle.distance(points[near])
    out = []
    for first, last in _stretches(distances < limit):
        worst = first + int(distances[first : last + 1].argmin())
        x, y = (float(c) for c in points[worst])
        what = (
            f"the plan led through {name_of(run, obstacle.name)} at ({x:.2f}, {y:.2f}): {distances[worst]:.2f} m from it, "
            f"with a robot of {run.radius:.2f} m"
        )
        out.append(_Overlap(obstacle.name, t, what, [(x, y)], float(distances[worst])))
    return out
