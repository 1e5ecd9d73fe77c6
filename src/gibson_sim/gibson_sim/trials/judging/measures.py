"""Measures of a run: numbers in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_sim.trials.judging.evidence import Commands, Evidence, Poses, errors
from gibson_sim.trials.judging.obstacles import Obstacles, floor_obstacles, scene_floor
from gibson_sim.trials.records import Outcome, RunSpec

_STEP_M = 0.01
"""Least distance between two counted points of a track, m: more than the jitter of a standing robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measures that verdicts and causes are derived from, in addition to the evidence; None = unknown."""

    walls: Obstacles | None
    """Occupied cells of the map."""
    length: float | None
    """Driven length, metres."""
    clearance: float | None
    """Least distance between the robot's circle and the map, metres; negative = they overlap."""
    clearance_time: float
    """Time of the least clearance, s since the goal."""
    goal_distance: float | None
    """Distance of the final true position from the goal, metres."""
    yaw_error: float | None
    """Error of the final true yaw, radians, 0 to pi."""
    rms_acceleration: float | None
    """Root mean square of the acceleration of the commanded linear velocity, m/s^2."""
    values: dict[str, float]
    """All measures by name."""


def measure(run: RunSpec, outcome: Outcome, evidence: Evidence) -> Measured:
    """Returns the measures of a run with a goal."""
    truth, values = evidence.truth, dict[str, float]()
    floor = evidence.floor or scene_floor(run.scene)
    walls = None if floor is None else floor_obstacles(floor)
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
    touches = None if evidence.touches is None else [touch for touch in evidence.touches if touch.begin >= 0.0]
    if touches is not None:
        values["collisions"] = float(len(touches))
        forces = [touch.force for touch in touches if touch.force > 0.0]
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
    """Returns the length of a track over points at least a centimetre apart, metres."""
    length, last = 0.0, (float(track.x[0]), float(track.y[0]))
    for x, y in zip(track.x.tolist(), track.y.tolist(), strict=True):
        step = math.hypot(x - last[0], y - last[1])
        if step >= _STEP_M:
            length, last = length + step, (x, y)
    return length


def rms_acceleration(commands: Commands) -> float | None:
    """Returns the root mean square over time of the commanded linear acceleration, m/s^2; None = fewer than two commands.

    Each change of velocity is spread over the time between its two commands. Commands that are not finite are ignored, and of several at
    one time the last one counts.
    """
    finite = commands.is_finite
    t, v = commands.t[finite], np.column_stack([commands.forward[finite], commands.sideways[finite]])
    last = np.append(np.diff(t) > 0.0, True)[: len(t)]
    t, v = t[last], v[last]
    if len(t) < 2:
        return None
    dt = np.diff(t)
    return math.sqrt(float(((np.diff(v, axis=0) ** 2).sum(axis=1) / dt).sum() / dt.sum()))
