"""Finds the cause of a failed run: the earliest event that contributed to one of its failures.

Each failed verdict is a failure, with a time and the kinds of events that can cause it: a crash of the stack's process is never attributed
to slip, and a collision is not attributed to a localisation error that had recovered ten seconds earlier.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gibson_sim.quoting import clipped
from gibson_sim.trials.foreign_calls import ForeignCalls
from gibson_sim.trials.judging.events import GRID_S, PLAN_NEAR_M, Event, collision, find_events
from gibson_sim.trials.judging.evidence import Evidence, errors
from gibson_sim.trials.judging.measures import Measured
from gibson_sim.trials.judging.obstacles import place_text
from gibson_sim.trials.judging.verdicts import RUN, is_alive, touches_after_goal
from gibson_sim.trials.records import REFUSED_GOAL, Cause, CauseKind, Outcome, RunSpec, Verdict
from gibson_sim.trials.scenario.spec import Scenario

RECOVERED_S = 5.0
"""An event that ended longer than this before a momentary failure did not cause it, s: a robot drives two metres meanwhile."""
HELD_UP_S = 10.0
"""Time near an obstacle on its plan from which a robot counts as held up there, s."""
FINAL_S = 10.0
"""Time before the end during which a robot that is merely too slow still drives, s."""
DRIVES_MIN_M = 0.5
"""Least distance driven in this time by a robot that still drives, metres: less is turning on the spot and backing up."""
EXPLAINED_SHARE = 0.5
"""Least ratio of the localisation error to the distance to the goal that explains a goal reported too early."""
_UNINFORMATIVE: tuple[CauseKind, ...] = ("too slow", "verdict", "unknown")
"""Kinds that add no information to the verdicts."""
_MAX_FOLLOWING = 2
"""Number of events named after the first one."""
_STACK = "the stack"
"""Prefix of the outcome's detail for a stack that died."""
_MAX_LENGTH = 300
"""Largest length of a quoted text in a cause, characters."""

_RANKS: tuple[CauseKind, ...] = (
    "foreign call", "simulation failed", "never ready", "localisation jumped", "localisation off", "plan through obstacle", "bad command", "slipped",
    "command ignored", "collision", "blocked", "no plan", "no command", "stack silent", "stack died", "gave up", "too slow", "unknown",
    "verdict",
)  # fmt: skip
"""Order of events that began at the same time."""
_LOST: tuple[CauseKind, ...] = ("localisation jumped", "localisation off")
_MISGUIDED: tuple[CauseKind, ...] = (*_LOST, "plan through obstacle", "bad command", "slipped")
"""Kinds that lead a robot to a place where it must not be."""
_DELAYED: tuple[CauseKind, ...] = (*_MISGUIDED, "command ignored", "blocked", "no plan", "no command")
"""Kinds that keep a robot from its goal or delay it."""
_ENDS: Mapping[str, CauseKind] = {
    "simulation failed": "simulation failed",
    "never ready": "never ready",
    "stack silent": "stack silent",
    "stack died": "stack died",
    "interrupted": "unknown",
    "wall time limit": "too slow",
}
"""End of a run -> kind of cause."""


@dataclass(frozen=True, slots=True)
class _Failure:
    """A failed verdict."""

    itself: Event
    """The failure as an event, which is its own cause if no other event is."""
    kinds: tuple[CauseKind, ...] = ()
    """Kinds of events that can cause it."""
    at_once: bool = False
    """Whether it happened at one moment rather than over the whole run."""


def cause_without_bag(outcome: Outcome, why: str) -> Cause:
    """Returns the cause of a run without a goal or a bag, from its outcome alone.

    Args:
        outcome: outcome of the run.
        why: problem with the bag, one line.
    """
    if outcome.end in _ENDS:
        return Cause(_ENDS[outcome.end], f"{outcome.end}: {clipped(outcome.detail, _MAX_LENGTH)}")
    return Cause("unknown", clipped(why, _MAX_LENGTH))


def find_cause(
    scenario: Scenario,
    run: RunSpec,
    outcome: Outcome,
    evidence: Evidence,
    measured: Measured,
    verdicts: Sequence[Verdict],
    foreign: ForeignCalls | None = None,
) -> Cause | None:
    """Returns the cause of failure of a run with a goal and a bag; None = all its verdicts passed.

    Foreign calls are the cause whatever happened before them: a world that others change says nothing about the stack.
    """
    failures = [_failure(v, scenario, run, outcome, evidence, measured) for v in verdicts if not v.passed]
    if not failures:
        return None
    within = 0.0 if scenario.verdicts.reached is None else scenario.verdicts.reached.within
    events = find_events(run, outcome, evidence, measured.walls, within)
    if outcome.end == "gave up" and outcome.detail.endswith(REFUSED_GOAL):
        events = [event for event in events if event.kind not in ("no plan", "no command")]  # the stack never had a goal
    if any(verdict.name == "reached" and not verdict.passed for verdict in verdicts):
        events += [event for event in (_goal_mislocated(outcome, evidence, measured),) if event is not None]
    # An event is attributed to the first failure that it caused.
    causes = [(failure.itself, failure.itself) for failure in failures]
    for event in events:
        caused = [failure.itself for failure in failures if _is_caused_by(failure, event, run, evidence)]
        causes += [(event, min(caused, key=lambda failure: failure.begin))] if caused else []
    causes.sort(key=_sort_key)
    found = [event for event, _ in causes]
    if foreign is not None:
        call = _at("foreign call", foreign.time, foreign.what, evidence)
        found = [call, *(event for event in found if event.begin >= call.begin)]
    return _cause(found, run)


def _sort_key(cause: tuple[Event, Event]) -> tuple[object, ...]:
    """Returns the sort key of an event and the failure that it caused; a plan through the obstacle that was hit precedes other plans."""
    event, failure = cause
    return round(event.begin, 1), _RANKS.index(event.kind), failure.begin, event.other != failure.other, event.room


def _cause(events: list[Event], run: RunSpec) -> Cause:
    """Returns the cause for events in order: a sentence with what, where and when for the first one, and the events that followed."""
    first = events[0]
    if first.kind == "verdict":
        return Cause(first.kind, first.what, first.begin)
    where = "" if first.xy is None else f", {place_text(run, *first.xy)}"
    when = f"after {first.begin:.1f} s" if first.begin >= 0.0 else f"{-first.begin:.1f} s before the goal"
    text = f"{when}{where}: {first.what}"
    following, named_kinds = 0, {str(first.kind)}
    for event in events[1:]:
        if event.kind in named_kinds or event.kind in _UNINFORMATIVE or following == _MAX_FOLLOWING:
            continue
        later = event.begin - first.begin
        text += f"; {f'{later:.1f} s later' if later >= GRID_S else 'and'} {event.what}"
        named_kinds.add(event.kind)
        following += 1
    return Cause(first.kind, text, round(first.begin, 3))


def _is_caused_by(failure: _Failure, event: Event, run: RunSpec, evidence: Evidence) -> bool:
    """Returns whether an event contributed to a failure."""
    at = failure.itself.begin
    if event.kind not in failure.kinds or event.begin > at:
        return False
    if failure.at_once:
        lasts = event.end >= at - RECOVERED_S or (event.kind == "slipped" and evidence.estimate is None)
        return lasts and (not event.spots or _near(event, run, evidence, at))
    if not event.spots:
        return True
    times = np.arange(event.begin, evidence.duration, GRID_S)
    return _near(event, run, evidence, at) or sum(_near(event, run, evidence, float(t)) for t in times) * GRID_S >= HELD_UP_S


def _near(event: Event, run: RunSpec, evidence: Evidence, t: float) -> bool:
    """Returns whether the robot is near one of the spots of an event at a time, s since the goal."""
    assert evidence.truth is not None
    x, y, _ = evidence.truth.at(t)
    spots = np.array(event.spots)
    return bool(np.hypot(spots[:, 0] - x, spots[:, 1] - y).min() <= run.radius + PLAN_NEAR_M)


def _failure(
    verdict: Verdict, scenario: Scenario, run: RunSpec, outcome: Outcome, evidence: Evidence, measured: Measured
) -> _Failure:  # fmt: skip
    """Returns the failure of a run that a failed verdict reports."""
    name, end = verdict.name.partition(".")[0], evidence.duration
    itself = Event("verdict", end, end, f"{verdict.name}: {verdict.text}")
    if name in (RUN, "alive", "reached") and outcome.end in _ENDS:
        event = Event(_ENDS[outcome.end], end, end, _abort_text(outcome, measured))
        return _Failure(event, _DELAYED if outcome.end == "wall time limit" else ())
    if name == "alive" and not is_alive(outcome):
        return _Failure(Event("stack died", end, end, verdict.text))
    if name == RUN:
        begin = end if verdict.value is None else verdict.value
        return _Failure(Event("unknown", begin, end, verdict.text))
    if name == "reached" and evidence.truth is not None:
        if outcome.end == "reached":
            return _Failure(itself, (*_LOST, "slipped"), at_once=True)
        return _Failure(_not_reached(scenario, outcome, evidence, measured), _DELAYED)
    if name == "collisions" and evidence.touches is not None:
        touch = touches_after_goal(evidence)[scenario.verdicts.collisions or 0]
        return _Failure(collision(run, evidence, touch), _MISGUIDED, at_once=True)
    if name == "clearance" and measured.clearance is not None:
        return _Failure(_at("verdict", measured.clearance_time, itself.what, evidence), _MISGUIDED, at_once=True)
    if name in ("stay_within", "stay_out_of") and verdict.value is not None:
        return _Failure(_at("verdict", verdict.value, itself.what, evidence), _MISGUIDED, at_once=True)
    if name == "time":
        return _Failure(Event("too slow", end, end, verdict.text), _DELAYED)
    if name == "path_ratio" and verdict.value is not None:
        return _Failure(itself, _DELAYED)
    return _Failure(itself)


def _abort_text(outcome: Outcome, measured: Measured) -> str:
    """Returns a description of how a run was aborted."""
    detail, distance = clipped(outcome.detail, _MAX_LENGTH), measured.goal_distance
    if outcome.end == "stack died" and detail.startswith(_STACK) and distance is not None:
        return f"{_STACK}, {distance:.2f} m from the goal, {detail.removeprefix(_STACK).lstrip()}"
    return f"{outcome.end}: {detail}"


def _at(kind: CauseKind, t: float, what: str, evidence: Evidence) -> Event:
    """Returns an event at one moment, with the position of the robot."""
    if evidence.truth is None:
        return Event(kind, t, t, what)
    x, y, _ = evidence.truth.at(t)
    return Event(kind, t, t, what, (float(x), float(y)))


def _not_reached(scenario: Scenario, outcome: Outcome, evidence: Evidence, measured: Measured) -> Event:
    """Returns the end of a run that did not reach its goal as an event: gave up, too slow, or stuck."""
    assert evidence.truth is not None and measured.goal_distance is not None
    end, distance, required = evidence.duration, measured.goal_distance, scenario.verdicts.reached
    if outcome.end == "gave up":
        report = clipped(outcome.status or outcome.detail, _MAX_LENGTH)
        return _at("gave up", end, f"the stack gave up {distance:.2f} m from the goal: {report}", evidence)
    if required is not None and distance <= required.within:
        what = (
            f"reached: the robot was {distance:.2f} m from the goal at the end, but the stack did not report that it had arrived"
        )
        return _at("verdict", end, what, evidence)
    times = np.arange(max(0.0, end - FINAL_S), end + GRID_S / 2.0, GRID_S * 5)
    x, y, _ = evidence.truth.at(times)
    driven = float(np.hypot(np.diff(x), np.diff(y)).sum())
    if driven >= DRIVES_MIN_M:
        what = f"the robot was still driving at the time limit of {end:g} s, {distance:.2f} m from the goal"
        return _at("too slow", end, what, evidence)
    what = f"at the time limit of {end:g} s the robot was {distance:.2f} m from the goal, and had moved {driven:.2f} m in the last {FINAL_S:g} s"
    return _at("unknown", end, what, evidence)


def _goal_mislocated(outcome: Outcome, evidence: Evidence, measured: Measured) -> Event | None:
    """Returns the localisation error that explains why the stack mistook another place for the goal; None = it does not explain it."""
    truth, estimate, distance = evidence.truth, evidence.estimate, measured.goal_distance
    if outcome.end != "reached" or truth is None or estimate is None or not distance:
        return None
    off, _ = errors(estimate.poses, truth)
    explains = off >= EXPLAINED_SHARE * distance
    if not explains[-1]:
        return None
    small = np.flatnonzero(~explains)
    begin = float(estimate.poses.t[0 if not len(small) else int(small[-1]) + 1])
    x, y, _ = truth.at(begin)
    what = f"the localisation was off, by {off[-1]:.2f} m at the end, so that the stack mistook a place {distance:.2f} m away for the goal"
    return Event("localisation off", begin, evidence.duration, what, (float(x), float(y)))
