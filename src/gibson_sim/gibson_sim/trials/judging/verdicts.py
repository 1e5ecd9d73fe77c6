"""The verdicts of a run: each key of ``Verdicts`` that a scenario sets yields a ``Verdict``, or one for each of its items."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.plots.touches import Touch
from gibson_sim.quoting import quoted
from gibson_sim.trials.foreign_calls import ForeignCalls
from gibson_sim.trials.judging.evidence import Evidence, Poses
from gibson_sim.trials.judging.measures import Measured
from gibson_sim.trials.predicates import predicate_verdict
from gibson_sim.trials.records import PAUSE, Outcome, RunSpec, Verdict
from gibson_sim.trials.scenario.spec import Reached, Region, Scenario

RUN = "run"
"""Name of the verdict on whether a run could be judged at all."""
NOT_JUDGED = ("simulation failed", "never ready", "stack silent", "interrupted", "wall time limit")
"""Ends after which no run passes."""
GAP_S, GAPS_S = 0.5, 1.0
"""Longest gap, and longest time of all gaps, that a bag may have between its ticks, s: on a busy machine, messages may be lost."""
_MAX_NAMED = 3
"""Number of collisions that a verdict names."""
_TRUTH = "ground_truth/odom"


def failed_verdicts(scenario: Scenario, outcome: Outcome, why: str) -> tuple[Verdict, ...]:
    """Returns the verdicts of a run without a goal or without a readable bag: all but ``alive`` have failed.

    Args:
        scenario: criteria of the verdicts.
        outcome: outcome of the run.
        why: reason, one line.
    """
    limits = scenario.verdicts
    names = [
        name
        for name in ("reached", "collisions", "clearance", "path_ratio", "time", "max_acceleration")
        if getattr(limits, name) is not None
    ]
    names += ["stay_within"] if limits.stay_within else []
    names += [f"stay_out_of.{region.name}" for region in limits.stay_out_of]
    names += [f"rates.{rate.topic.lstrip('/')}" for rate in limits.rates]
    names += [f"predicates.{predicate}" for predicate in limits.predicates]
    text = "not judged: the goal was not sent" if outcome.goal_ns < 0 else "not judged: the bag cannot be read"
    alive = (_alive(outcome),) if limits.alive else ()
    return (Verdict(RUN, False, why), *(Verdict(name, False, text) for name in names), *alive)


def verdicts_of(
    scenario: Scenario,
    run: RunSpec,
    outcome: Outcome,
    evidence: Evidence,
    measured: Measured,
    bag: Path,
    foreign: ForeignCalls | None = None,
) -> tuple[Verdict, ...]:
    """Returns all verdicts of a run with a goal and a bag; ``foreign``: what changed the world and was not the trial."""
    limits, truth = scenario.verdicts, evidence.truth
    verdicts = [_run(outcome, evidence, foreign)]
    if limits.reached is not None:
        verdicts.append(_reached(limits.reached, outcome, measured))
    if limits.collisions is not None:
        verdicts.append(_collisions(limits.collisions, evidence))
    if limits.clearance is not None:
        verdicts.append(_clearance(limits.clearance, evidence, measured))
    if limits.stay_within:
        verdicts.append(_stay_within(limits.stay_within, truth))
    verdicts += [_stay_out_of(region, truth) for region in limits.stay_out_of]
    if limits.path_ratio is not None:
        verdicts.append(_path_ratio(limits.path_ratio, run, measured))
    if limits.time is not None:
        verdicts.append(_at_most("time", evidence.decided, limits.time, "s", "the run took"))
    if limits.max_acceleration is not None:
        verdicts.append(_acceleration(limits.max_acceleration, evidence, measured))
    verdicts += [_rate(rate.topic, rate.least, evidence) for rate in limits.rates]
    if limits.alive:
        verdicts.append(_alive(outcome))
    verdicts += [predicate_verdict(predicate, scenario.path.parent, bag, run) for predicate in limits.predicates]
    return tuple(verdicts)


def touches_after_goal(evidence: Evidence) -> list[Touch]:
    """Returns the contacts that began after the goal was given."""
    return [touch for touch in evidence.touches or () if touch.begin >= 0.0]


def inside_any(regions: tuple[Region, ...], truth: Poses) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the true positions inside at least one region."""
    return np.asarray(np.any([inside(region, truth) for region in regions], axis=0))


def inside(region: Region, truth: Poses) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the true positions inside a region."""
    x, y = truth.x, truth.y
    is_inside = np.zeros(len(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(region.corners, (*region.corners[1:], region.corners[0]), strict=True):
        if y0 != y1:
            is_inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return is_inside


def is_alive(outcome: Outcome) -> bool:
    """Returns whether the stack's process ran until the end; it may exit by itself only after its end was reported, and with code 0."""
    if outcome.end == "stack died" or outcome.exit_code not in (None, 0):
        return False
    return outcome.exit_code is None or outcome.end in ("reached", "gave up")


def _run(outcome: Outcome, evidence: Evidence, foreign: ForeignCalls | None) -> Verdict:
    """Judges whether the run was completed, by the trial alone, and recorded without a gap."""
    if foreign is not None:
        return Verdict(RUN, False, foreign.what, foreign.time)
    if outcome.end in NOT_JUDGED:
        return Verdict(RUN, False, f"{outcome.end}: {outcome.detail}")
    missing = evidence.duration - evidence.last
    if missing > 1.0:
        return Verdict(RUN, False, f"the bag ends {missing:.1f} s before the run does: the rest of the run is unknown")
    if evidence.first > 1.0:
        return Verdict(
            RUN, False, f"the bag begins {evidence.first:.1f} s after the goal was sent: the beginning of the run is unknown"
        )
    longest, missing = max((gap.length for gap in evidence.gaps), default=0.0), sum(gap.length for gap in evidence.gaps)
    if longest > GAP_S or missing > GAPS_S:
        first = next(gap for gap in evidence.gaps if longest <= GAP_S or gap.length > GAP_S)
        others = f", and {missing - first.length:.1f} s in other gaps" if missing - first.length > 0.05 else ""
        nodes = " or ".join(quoted(name) for name in outcome.callers.get(PAUSE, ())[:_MAX_NAMED])
        why = (
            f"recording was paused, by node {nodes}, or messages were lost"
            if nodes
            else "recording was paused, or messages were lost"
        )
        text = f"the bag lacks {first.length:.1f} s from {first.begin:.1f} s after the goal{others}: {why}; what happened then is unknown"
        return Verdict(RUN, False, text, first.begin)
    return Verdict(RUN, True, "the run was completed and recorded")


def _missing(name: str, what: str) -> Verdict:
    return Verdict(name, False, f"cannot be judged: {what} is missing from the bag")


def _at_most(name: str, value: float, limit: float, unit: str, what: str) -> Verdict:
    passed, unit = value <= limit, f" {unit}" if unit else ""
    return Verdict(
        name, passed, f"{what} {value:.2f}{unit}, {'at most' if passed else 'more than'} {limit:g}{unit}", value, limit
    )


def _reached(required: Reached, outcome: Outcome, measured: Measured) -> Verdict:
    name, distance, yaw_error = "reached", measured.goal_distance, measured.yaw_error
    if distance is None or yaw_error is None:
        return _missing(name, _TRUTH)
    text, passed = f"the robot ended {distance:.2f} m from the goal, at most {required.within:g} m", distance <= required.within
    if required.yaw_within_deg is not None:
        text += f", with a heading error of {math.degrees(yaw_error):.0f} deg, at most {required.yaw_within_deg:g} deg"
        passed = passed and math.degrees(yaw_error) <= required.yaw_within_deg
    if outcome.end != "reached":
        text, passed = f"{text}; the run ended differently: {outcome.end}", False
    return Verdict(name, passed, text, distance, required.within)


def _collisions(limit: int, evidence: Evidence) -> Verdict:
    if evidence.touches is None:
        return _missing("collisions", "a topic of collisions, contacts or a bumper")
    touches = touches_after_goal(evidence)
    if not touches:
        return Verdict("collisions", True, "the robot touched nothing but the floor", 0.0, float(limit))
    named = [f"{touch.other or 'something'} at {touch.begin:.1f} s" for touch in touches[:_MAX_NAMED]]
    more = f" and {len(touches) - _MAX_NAMED} more" if len(touches) > _MAX_NAMED else ""
    text = f"{len(touches)} collision{'s' if len(touches) > 1 else ''}, at most {limit}: {', '.join(named)}{more}"
    return Verdict("collisions", len(touches) <= limit, text, float(len(touches)), float(limit))


def _clearance(limit: float, evidence: Evidence, measured: Measured) -> Verdict:
    if evidence.truth is None:
        return _missing("clearance", _TRUTH)
    if measured.clearance is None:
        return _missing("clearance", "a map with obstacles")
    value, passed = measured.clearance, measured.clearance >= limit
    x, y, _ = evidence.truth.at(measured.clearance_time)
    text = (
        f"the robot came within {value:.2f} m of an obstacle of the map, at ({x:.2f}, {y:.2f}) after {measured.clearance_time:.1f} s, "
        f"at least {limit:g} m"
    )
    return Verdict("clearance", passed, text, value, limit)


def _stay_within(regions: tuple[Region, ...], truth: Poses | None) -> Verdict:
    names = " or ".join(region.name for region in regions)
    if truth is None:
        return _missing("stay_within", _TRUTH)
    return _region("stay_within", ~inside_any(regions, truth), truth, f"the robot left {names}", f"the robot stayed in {names}")


def _stay_out_of(region: Region, truth: Poses | None) -> Verdict:
    name = f"stay_out_of.{region.name}"
    if truth is None:
        return _missing(name, _TRUTH)
    return _region(
        name, inside(region, truth), truth, f"the robot entered {region.name}", f"the robot stayed out of {region.name}"
    )


def _region(name: str, violations: NDArray[np.bool_], truth: Poses, bad: str, good: str) -> Verdict:
    """Returns the verdict for a mask (N,) of the true positions that violate a region."""
    if not violations.any():
        return Verdict(name, True, good)
    first = int(violations.argmax())
    where = f"at ({truth.x[first]:.2f}, {truth.y[first]:.2f}) after {truth.t[first]:.1f} s"
    return Verdict(name, False, f"{bad} {where}", float(truth.t[first]))


def _path_ratio(limit: float, run: RunSpec, measured: Measured) -> Verdict:
    if measured.length is None:
        return _missing("path_ratio", _TRUTH)
    if run.shortest <= 0.0:
        return Verdict("path_ratio", False, "cannot be judged: the length of the shortest path is not known")
    ratio = measured.length / run.shortest
    return _at_most("path_ratio", ratio, limit, "", f"{measured.length:.2f} m driven, shortest path {run.shortest:.2f} m: ratio")


def _acceleration(limit: float, evidence: Evidence, measured: Measured) -> Verdict:
    if evidence.commands is None:
        return _missing("max_acceleration", "cmd_vel")
    if measured.rms_acceleration is None:
        return Verdict("max_acceleration", False, "cannot be judged: fewer than two commands")
    return _at_most("max_acceleration", measured.rms_acceleration, limit, "m/s^2", "the RMS commanded acceleration was")


def _rate(topic: str, least: float, evidence: Evidence) -> Verdict:
    name, full = f"rates.{topic.lstrip('/')}", f"/{topic.lstrip('/')}"
    if full not in evidence.topics:
        return _missing(name, f"every message of {full}")
    if evidence.decided <= 0.0:
        return Verdict(name, False, "cannot be judged: no time passed after the goal")
    rate = evidence.counts[full] / evidence.decided
    return Verdict(name, rate >= least, f"{full} had {rate:.2f} messages per second, at least {least:g}", rate, least)


def _alive(outcome: Outcome) -> Verdict:
    if is_alive(outcome):
        return Verdict("alive", True, "the stack ran until the end")
    code = outcome.exit_code
    how = "" if code is None else f" by signal {-code}" if code < 0 else f" with exit code {code}"
    return Verdict("alive", False, f"the stack ended{how} before the run did")
