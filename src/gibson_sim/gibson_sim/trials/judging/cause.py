"""Names the first thing that went wrong in a failed run: the earliest event that has to do with one of its failures.

A failure is what a verdict says. Each has a time, and the kinds of events that can bring it about: the crash of the stack's process is never
blamed on slip, and a localisation that had recovered ten seconds before a collision is not blamed for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gibson_sim.quoting import clipped
from gibson_sim.trials.judging.events import GRID_S, PLAN_NEAR_M, Event, collision, find_events
from gibson_sim.trials.judging.evidence import Evidence, errors
from gibson_sim.trials.judging.measures import Measured
from gibson_sim.trials.judging.obstacles import place
from gibson_sim.trials.judging.verdicts import RUN, is_alive, touches_begun
from gibson_sim.trials.records import REFUSED_GOAL, Cause, CauseKind, Outcome, RunSpec, Verdict
from gibson_sim.trials.scenario_spec import Scenario

RECOVERED_S = 5.0
"""An event that was over this long before a failure at one moment did not bring it about, s: a robot drives two metres meanwhile."""
DWELLS_S = 10.0
"""Time near an obstacle on its plan from which a robot is held up there, s."""
LAST_S = 10.0
"""Time before the end in which a robot that is too slow still drives, s."""
DRIVES_M = 0.5
"""Least way in this time of a robot that drives, metres: less is turning on the spot and backing up."""
EXPLAINS = 0.5
"""Least share of the distance to the goal that the localisation's error has to be, to explain a robot that reported a goal too early."""
_NOT_TOLD: tuple[CauseKind, ...] = ("too slow", "verdict", "unknown")
"""What says no more than the verdicts do."""
_MOST_FOLLOWING = 2
"""Events that are told after the first one."""
_STACK = "the stack"
"""Begins the detail of an outcome of a stack that died."""
_LONGEST = 300
"""Longest text of others in a cause, characters."""

_RANKS: tuple[CauseKind, ...] = (
    "simulation failed", "never ready", "localisation jumped", "localisation off", "plan through obstacle", "bad command", "slipped",
    "command ignored", "collision", "blocked", "no plan", "no command", "stack silent", "stack died", "gave up", "too slow", "unknown",
    "verdict",
)  # fmt: skip
"""Order of events that began at one time."""
_LOST: tuple[CauseKind, ...] = ("localisation jumped", "localisation off")
_ASTRAY: tuple[CauseKind, ...] = (*_LOST, "plan through obstacle", "bad command", "slipped")
"""What leads a robot to where it must not be."""
_LATE: tuple[CauseKind, ...] = (*_ASTRAY, "command ignored", "blocked", "no plan", "no command")
"""What keeps a robot from its goal, or holds it up."""
_ENDS: Mapping[str, CauseKind] = {
    "simulation failed": "simulation failed",
    "never ready": "never ready",
    "stack silent": "stack silent",
    "stack died": "stack died",
    "interrupted": "unknown",
    "wall time limit": "too slow",
}
"""End of a run -> what it is called as a cause."""


@dataclass(frozen=True, slots=True)
class _Failure:
    """What a failed verdict says."""

    itself: Event
    """The failure as an event, which is to blame if nothing else is."""
    kinds: tuple[CauseKind, ...] = ()
    """What can bring it about."""
    at_once: bool = False
    """Whether it happened at one moment, and not over the whole run."""


def cause_without_bag(outcome: Outcome, why: str) -> Cause:
    """Returns the cause of a run without a goal or a bag, from its outcome alone.

    Args:
        outcome: of the run.
        why: what is wrong with the bag, one line.
    """
    if outcome.end in _ENDS:
        return Cause(_ENDS[outcome.end], f"{outcome.end}: {clipped(outcome.detail, _LONGEST)}")
    return Cause("unknown", clipped(why, _LONGEST))


def find_cause(
    scenario: Scenario, run: RunSpec, outcome: Outcome, evidence: Evidence, measured: Measured, verdicts: Sequence[Verdict]
) -> Cause | None:
    """Returns the first thing that went wrong in a run with a goal and a bag; None = all its verdicts are good."""
    failures = [_failure(v, scenario, run, outcome, evidence, measured) for v in verdicts if not v.passed]
    if not failures:
        return None
    within = 0.0 if scenario.verdicts.reached is None else scenario.verdicts.reached.within
    events = find_events(run, outcome, evidence, measured.walls, within)
    if outcome.end == "gave up" and outcome.detail.endswith(REFUSED_GOAL):
        events = [event for event in events if event.kind not in ("no plan", "no command")]  # it never had a goal
    if any(verdict.name == "reached" and not verdict.passed for verdict in verdicts):
        events += [lost for lost in (_at_the_wrong_place(outcome, evidence, measured),) if lost is not None]
    # What an event is told for is the first failure that it brought about.
    guilty = [(failure.itself, failure.itself) for failure in failures]
    for event in events:
        brought = [failure.itself for failure in failures if _brought_about(event, failure, run, evidence)]
        guilty += [(event, min(brought, key=lambda one: one.begin))] if brought else []
    guilty.sort(key=_order)
    return _told([event for event, _ in guilty], run)


def _order(told: tuple[Event, Event]) -> tuple[object, ...]:
    """Returns the key by which an event is sorted, with the failure that it brought about: of plans, that through what was hit is first."""
    event, failure = told
    return round(event.begin, 1), _RANKS.index(event.kind), failure.begin, event.other != failure.other, event.room


def _told(guilty: list[Event], run: RunSpec) -> Cause:
    """Returns the first of events as a sentence that tells what, where and when, with what followed."""
    first = guilty[0]
    if first.kind == "verdict":
        return Cause(first.kind, first.what, first.begin)
    where = "" if first.xy is None else f", {place(run, *first.xy)}"
    text = f"after {first.begin:.1f} s{where}: {first.what}"
    following, told = 0, {str(first.kind)}
    for event in guilty[1:]:
        if event.kind in told or event.kind in _NOT_TOLD or following == _MOST_FOLLOWING:
            continue
        later = event.begin - first.begin
        text += f"; {f'{later:.1f} s later' if later >= GRID_S else 'and'} {event.what}"
        told.add(event.kind)
        following += 1
    return Cause(first.kind, text, round(first.begin, 3))


def _brought_about(event: Event, failure: _Failure, run: RunSpec, evidence: Evidence) -> bool:
    """Returns whether an event has to do with a failure."""
    at = failure.itself.begin
    if event.kind not in failure.kinds or event.begin > at:
        return False
    if failure.at_once:
        lasts = event.end >= at - RECOVERED_S or (event.kind == "slipped" and evidence.estimate is None)
        return lasts and (not event.spots or _near(event, run, evidence, at))
    if not event.spots:
        return True
    times = np.arange(event.begin, evidence.duration, GRID_S)
    return _near(event, run, evidence, at) or sum(_near(event, run, evidence, float(t)) for t in times) * GRID_S >= DWELLS_S


def _near(event: Event, run: RunSpec, evidence: Evidence, t: float) -> bool:
    """Returns whether the robot is near one of the spots of an event at a time."""
    assert evidence.truth is not None
    x, y, _ = evidence.truth.at(t)
    spots = np.array(event.spots)
    return bool(np.hypot(spots[:, 0] - x, spots[:, 1] - y).min() <= run.radius + PLAN_NEAR_M)


def _failure(
    verdict: Verdict, scenario: Scenario, run: RunSpec, outcome: Outcome, evidence: Evidence, measured: Measured
) -> _Failure:  # fmt: skip
    """Returns what a failed verdict says about a run."""
    name, end = verdict.name.partition(".")[0], evidence.duration
    itself = Event("verdict", end, end, f"{verdict.name}: {verdict.text}")
    if name in (RUN, "alive", "reached") and outcome.end in _ENDS:
        how = Event(_ENDS[outcome.end], end, end, _ended(outcome, measured))
        return _Failure(how, _LATE if outcome.end == "wall time limit" else ())
    if name == "alive" and not is_alive(outcome):
        return _Failure(Event("stack died", end, end, verdict.text))
    if name == RUN:
        return _Failure(Event("unknown", end, end, verdict.text))
    if name == "reached" and evidence.truth is not None:
        if outcome.end == "reached":
            return _Failure(itself, (*_LOST, "slipped"), at_once=True)
        return _Failure(_not_reached(scenario, outcome, evidence, measured), _LATE)
    if name == "collisions" and evidence.touches is not None:
        touch = touches_begun(evidence)[scenario.verdicts.collisions or 0]
        return _Failure(collision(run, evidence, touch), _ASTRAY, at_once=True)
    if name == "clearance" and measured.clearance is not None:
        return _Failure(_at("verdict", measured.clearance_time, itself.what, evidence), _ASTRAY, at_once=True)
    if name in ("stay_within", "stay_out_of") and verdict.value is not None:
        return _Failure(_at("verdict", verdict.value, itself.what, evidence), _ASTRAY, at_once=True)
    if name == "time":
        return _Failure(Event("too slow", end, end, verdict.text), _LATE)
    if name == "path_ratio" and verdict.value is not None:
        return _Failure(itself, _LATE)
    return _Failure(itself)


def _ended(outcome: Outcome, measured: Measured) -> str:
    """Returns how a run was broken off."""
    detail, distance = clipped(outcome.detail, _LONGEST), measured.goal_distance
    if outcome.end == "stack died" and detail.startswith(_STACK) and distance is not None:
        return f"{_STACK}, {distance:.2f} m from the goal, {detail.removeprefix(_STACK).lstrip()}"
    return f"{outcome.end}: {detail}"


def _at(kind: CauseKind, t: float, what: str, evidence: Evidence) -> Event:
    """Returns an event at one moment, with the place of the robot."""
    if evidence.truth is None:
        return Event(kind, t, t, what)
    x, y, _ = evidence.truth.at(t)
    return Event(kind, t, t, what, (float(x), float(y)))


def _not_reached(scenario: Scenario, outcome: Outcome, evidence: Evidence, measured: Measured) -> Event:
    """Returns the end of a run that did not reach its goal as an event: gave up, too slow, or stuck."""
    assert evidence.truth is not None and measured.goal_distance is not None
    end, distance, wanted = evidence.duration, measured.goal_distance, scenario.verdicts.reached
    if outcome.end == "gave up":
        said = clipped(outcome.status or outcome.detail, _LONGEST)
        return _at("gave up", end, f"the stack gave up {distance:.2f} m from the goal: {said}", evidence)
    if wanted is not None and distance <= wanted.within:
        what = f"reached: the robot was {distance:.2f} m from the goal at the end, but the stack did not tell that it was there"
        return _at("verdict", end, what, evidence)
    times = np.arange(max(0.0, end - LAST_S), end + GRID_S / 2.0, GRID_S * 5)
    x, y, _ = evidence.truth.at(times)
    way = float(np.hypot(np.diff(x), np.diff(y)).sum())
    if way >= DRIVES_M:
        what = f"the robot was still driving at the time limit of {end:g} s, {distance:.2f} m from the goal"
        return _at("too slow", end, what, evidence)
    what = f"at the time limit of {end:g} s the robot was {distance:.2f} m from the goal, and had moved {way:.2f} m in the last {LAST_S:g} s"
    return _at("unknown", end, what, evidence)


def _at_the_wrong_place(outcome: Outcome, evidence: Evidence, measured: Measured) -> Event | None:
    """Returns the error of the localisation that explains why the stack took another place for the goal; None = it does not."""
    truth, estimate, distance = evidence.truth, evidence.estimate, measured.goal_distance
    if outcome.end != "reached" or truth is None or estimate is None or not distance:
        return None
    off, _ = errors(estimate.poses, truth)
    wrong = off >= EXPLAINS * distance
    if not wrong[-1]:
        return None
    right = np.flatnonzero(~wrong)
    begin = float(estimate.poses.t[0 if not len(right) else int(right[-1]) + 1])
    x, y, _ = truth.at(begin)
    what = f"the localisation was off, at the end by {off[-1]:.2f} m, so that the stack took a place {distance:.2f} m away for the goal"
    return Event("localisation off", begin, evidence.duration, what, (float(x), float(y)))
