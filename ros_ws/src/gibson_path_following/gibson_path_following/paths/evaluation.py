"""Evaluates a drive along a path by ground truth: success, coverage, collisions, deviation, SPL. Followers must not import this."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.types import RecordedPath

F64 = NDArray[np.float64]
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TracePoint:
    """Ground truth of the robot at one time."""

    stamp_ns: int
    """Time, ns."""
    x: float
    """Metres, in the frame of the path's poses."""
    y: float
    """Metres."""
    yaw: float
    """Radians."""
    in_collision: bool = False
    """Whether the robot collided with anything but the floor since the previous point."""


@dataclass(frozen=True, slots=True)
class EvaluationSettings:
    """Thresholds of arrival, and of separate collisions."""

    arrival_radius: float = 0.5
    """Distance within which a node is visited, and the end reached, metres."""
    collision_gap: float = 0.5
    """Time between two contacts up to which they are one collision, seconds; contacts of successive points are one, too."""

    def __post_init__(self) -> None:
        if not 0.0 < self.arrival_radius < math.inf:
            raise SettingError(f"arrival_radius is {self.arrival_radius:g} m, must be above 0; the usual one is 0.5")
        if not 0.0 <= self.collision_gap < math.inf:
            raise SettingError(f"collision_gap is {self.collision_gap:g} s, must be 0 or more; the usual one is 0.5")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Metrics of a drive."""

    success: bool
    """Whether the robot stood within the arrival radius of the last node at the end, without any collision."""
    arrived: bool
    """Whether the robot stood within the arrival radius of the last node at the end."""
    coverage: float
    """Share of the nodes within whose arrival radius the robot came, 0 to 1."""
    collisions: int
    """Number of collisions."""
    collisions_per_metre: float
    """Collisions per metre driven; 0 if the robot did not move."""
    deviation_mean: float
    """Mean distance of the robot from the polyline through the nodes, weighted by the distance driven, metres."""
    deviation_max: float
    """Largest distance of the robot from the polyline through the nodes, metres."""
    end_distance: float
    """Distance of the robot from the last node at the end, metres."""
    travelled: float
    """Distance driven, metres."""
    path_length: float
    """Length of the polyline through the nodes, metres."""
    spl: float
    """Success weighted by path length: success x path_length / max(path_length, travelled)."""
    duration: float
    """Time from the first point of the trace to the last, seconds."""


def evaluate(
    nodes: Sequence[tuple[float, float]], trace: Sequence[TracePoint], settings: EvaluationSettings | None = None
) -> Outcome:
    """Returns the metrics of a drive.

    Args:
        nodes: true x and y of the nodes, metres, in order.
        trace: ground truth of the robot, in the order of time, same frame.
        settings: thresholds; None = the defaults.

    Raises:
        SettingError: there is no node or no point of the trace, or a number is not finite.
    """
    settings = settings or EvaluationSettings()
    if not nodes or not trace:
        raise SettingError(f"{len(nodes)} nodes and {len(trace)} points of a trace: a drive is judged by at least one of each")
    way: F64 = np.array([node[:2] for node in nodes], dtype=np.float64)
    driven: F64 = np.array([(point.x, point.y) for point in trace], dtype=np.float64)
    if not (np.isfinite(way).all() and np.isfinite(driven).all()):
        raise SettingError("the path or the trace holds a NaN or an infinity; only finite positions can be judged")
    steps = np.hypot(*np.diff(driven, axis=0).T)
    travelled = float(steps.sum())
    length = float(np.hypot(*np.diff(way, axis=0).T).sum())
    deviation = distances_to_line(way, driven)
    weights = np.concatenate([steps[:1], (steps[:-1] + steps[1:]) / 2, steps[-1:]]) if len(steps) else np.ones(1)
    mean = float(np.average(deviation, weights=weights)) if weights.sum() > 0.0 else float(deviation.mean())
    collisions = _collisions(trace, round(settings.collision_gap * NS_PER_S))
    end = float(np.hypot(*(driven[-1] - way[-1])))
    arrived = end <= settings.arrival_radius
    success = arrived and collisions == 0
    longest = max(length, travelled)
    return Outcome(
        success=success,
        arrived=arrived,
        coverage=float((distances_to_line(driven, way) <= settings.arrival_radius).mean()),
        collisions=collisions,
        collisions_per_metre=collisions / travelled if travelled > 0.0 else 0.0,
        deviation_mean=mean,
        deviation_max=float(deviation.max()),
        end_distance=end,
        travelled=travelled,
        path_length=length,
        spl=(length / longest if longest > 0.0 else 1.0) if success else 0.0,
        duration=(trace[-1].stamp_ns - trace[0].stamp_ns) / NS_PER_S,
    )


def verdict(outcome: Outcome, arrival_radius: float) -> str:
    """Returns whether a drive succeeded, and why not: what was not allowed, with its limit.

    Args:
        outcome: of the drive.
        arrival_radius: that of its ``EvaluationSettings``, metres.
    """
    end = f"{outcome.end_distance:.2f} m from the end of the path" + (
        "" if outcome.arrived else f" (allowed: {arrival_radius:g} m)"
    )
    count = outcome.collisions
    collisions = f"{count} collision{'' if count == 1 else 's'} (allowed: none)" if count else "no collision"
    return f"{'success' if outcome.success else 'failure'}: {end}, {collisions}"


def node_positions(path: RecordedPath) -> tuple[tuple[float, float], ...]:
    """Returns the recorded x and y of the nodes, metres.

    Raises:
        SettingError: a node has no pose.
    """
    missing = [i for i, node in enumerate(path.nodes) if node.pose is None]
    if missing:
        raise SettingError(
            f"node {missing[0]} of the path has no pose, so that no drive can be judged by it; record the path with odometry"
        )
    return tuple((node.pose[0], node.pose[1]) for node in path.nodes if node.pose is not None)


def distances_to_line(line: F64, points: F64) -> F64:
    """Returns (M,), float64: distance of each point (M, 2) from a polyline (N, 2), metres."""
    if len(line) == 1:
        return np.asarray(np.hypot(*(points - line[0]).T), dtype=np.float64)
    start, along = line[:-1], np.diff(line, axis=0)  # (N - 1, 2)
    squared = np.maximum((along**2).sum(axis=1), 1e-12)
    offset = points[:, None, :] - start[None]  # (M, N - 1, 2)
    share = np.clip((offset * along[None]).sum(axis=2) / squared, 0.0, 1.0)
    away = offset - share[..., None] * along[None]
    return np.asarray(np.sqrt((away**2).sum(axis=2)).min(axis=1), dtype=np.float64)


def _collisions(trace: Sequence[TracePoint], gap_ns: int) -> int:
    """Returns the number of collisions; contacts with at most ``gap_ns`` between them are one."""
    count, last_ns, was_in_collision = 0, None, False
    for point in trace:
        if point.in_collision:
            if last_ns is None or (not was_in_collision and point.stamp_ns - last_ns > gap_ns):
                count += 1
            last_ns = point.stamp_ns
        was_in_collision = point.in_collision
    return count
