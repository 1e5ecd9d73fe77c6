"""What is measured of a run: numbers in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_sim.trials.judging.evidence import Commands, Evidence, Poses, errors
from gibson_sim.trials.judging.obstacles import Obstacles, of_floor, scene_floor
from gibson_sim.trials.records import Outcome, RunSpec

_STEP_M = 0.01
"""Least distance between two points of a track whose length is measured, m: a robot that stands trembles by less."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What verdicts and causes are made from beside the evidence; None = it is unknown."""

    walls: Obstacles | None
    """Occupied cells of the map."""
    length: float | None
    """Driven, metres."""
    clearance: float | None
    """Least distance between the robot's circle and the map, metres; negative = they overlap."""
    clearance_time: float
    """When that was, s since the goal."""
    goal_distance: float | None
    """Of the true position at the end, metres."""
    yaw_error: float | None
    """Of the true yaw at the end, radians, 0 to pi."""
    rms_acceleration: float | None
    """Of the commanded linear velocity, m/s^2."""
    values: dict[str, float]
    """All measures by their names."""


def measure(run: RunSpec, outcome: Outcome, evidence: Evidence) -> Measured:
    """Returns what is measured of a run with a goal."""
    truth, values = evidence.truth, dict[str, float]()
    floor = evidence.floor or scene_floor(run.scene)
    walls = None if floor is None else of_floor(floor)
    length = clearance = distance = yaw_error = None
    clearance_time = 0.0
    values["time"] = evidence.decided
    if truth is not None:
        x, y, yaw = truth.last
        distance = math.hypot(x - run.goal[0], y - run.goal[1])
        yaw_error = abs(math.remainder(yaw - run.goal[2], 2.0 * math.pi))
        values.update(goal_distance=distance, yaw_error=yaw_error)
        length = track_length(truth)
        values["length"] = length
        if run.shortest > 0.0:
            values["path_ratio"] = length / run.shortest
        if evidence.decided > 0.0:
            values["mean_speed"] = length / evidence.decided
        if walls is not None:
            least, index = walls.least_distance(np.column_stack([truth.x, truth.y]))
            clearance, clearance_time = least - run.radius, float(truth.t[index])
            values["clearance"] = clearance
    begun = None if evidence.touches is None else [touch for touch in evidence.touches if touch.begin >= 0.0]
    if begun is not None:
        values["collisions"] = float(len(begun))
        forces = [touch.force for touch in begun if touch.force > 0.0]
        if forces:
            values["greatest_force"] = max(forces)
    acceleration = None if evidence.commands is None else rms_acceleration(evidence.commands)
    if acceleration is not None:
        values["rms_acceleration"] = acceleration
    if truth is not None and evidence.estimate is not None:
        off, turned = errors(evidence.estimate.poses, truth)
        values.update(
            localisation_error=float(off.mean()),
            localisation_error_max=float(off.max()),
            localisation_yaw_error=float(turned.mean()),
        )
    if outcome.refused_commands:
        values["refused_commands"] = float(outcome.refused_commands)
    return Measured(walls, length, clearance, clearance_time, distance, yaw_error, acceleration, values)


def track_length(track: Poses) -> float:
    """Returns the length of a track, metres, over points at least a centimetre apart."""
    length, last = 0.0, (float(track.x[0]), float(track.y[0]))
    for x, y in zip(track.x.tolist(), track.y.tolist(), strict=True):
        step = math.hypot(x - last[0], y - last[1])
        if step >= _STEP_M:
            length, last = length + step, (x, y)
    return length


def rms_acceleration(commands: Commands) -> float | None:
    """Returns the root mean square over time of the change of the commanded linear velocity, m/s^2; None = fewer than two commands.

    Each change counts as spread over the time between its two commands. Commands that are not finite do not count, and of several at one
    time the last one does.
    """
    good = commands.is_finite
    t, v = commands.t[good], np.column_stack([commands.forward[good], commands.sideways[good]])
    last = np.append(np.diff(t) > 0.0, True)[: len(t)]
    t, v = t[last], v[last]
    if len(t) < 2:
        return None
    dt = np.diff(t)
    return math.sqrt(float(((np.diff(v, axis=0) ** 2).sum(axis=1) / dt).sum() / dt.sum()))
