"""Draws the paths of the benchmark: on the floor of a scene, of a given length, with at least one real turn; by a seed. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.paths import PathPlanner
from gibson_sim.maps.placement import furnished_floor_map
from gibson_sim.quoting import quoted
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene
from gibson_sim.tasks.ground import Ground
from gibson_sim_learn.path_following.oracle import resampled

F64 = NDArray[np.float64]
LENGTHS = (6.6, 8.4, 12.7)
"""Lengths of the paths of the paper's Table 2, metres."""
ROBOT = "gibson_bot"
CLEARANCE = 0.13
"""Least clearance of a path beyond the robot's radius, metres: the robot cuts corners."""
START_CLEARANCE = 0.25
"""Least clearance of its beginning beyond the robot's radius, metres: drives begin beside it."""
_MIN_TURN = math.radians(60.0)
"""Least turn within ``_TURN_LENGTH`` that a path must have, radians."""
_TURN_LENGTH = 1.2
"""Length over which turns are measured, metres."""
_ATTEMPTS = 1000
"""Starts that are tried for the paths of a length."""
_DIRECT_ATTEMPTS = 300
"""Attempts with the shortest path to a goal; later ones go through a waypoint, since a small scene has few long paths."""
_WAYPOINT_SHARE = (0.3, 0.7)
"""Share of the length at which the waypoint lies."""
_MAX_TURN = math.radians(120.0)
"""Greatest turn of a path through a waypoint, radians: it must not turn back."""
_SELF_DISTANCE = 0.7
"""Least distance of such a path from itself, metres, between points more than ``_SELF_LENGTH`` apart along it."""
_SELF_LENGTH = 2.0
"""Length along the path, metres."""
_APART = 0.6
"""Least distance between the starts, or between the ends, of two paths, metres."""


@dataclass(frozen=True, slots=True)
class PathCase:
    """A path of the benchmark, to be recorded and followed."""

    scene: str
    """Name or path of the scene."""
    length: float
    """Length, metres."""
    number: int
    """Number among the paths of this length in this scene."""
    line: tuple[tuple[float, float], ...]
    """Corners, world frame, metres; free of obstacles."""

    @property
    def start(self) -> tuple[float, float, float]:
        """Pose at its beginning, with the heading of the path: x, y, yaw, world frame, metres and radians."""
        points, stations = resampled(self.line)
        x, y = (float(np.interp(0.35, stations, points[:, k])) for k in range(2))
        return *self.line[0], math.atan2(y - self.line[0][1], x - self.line[0][0])


@lru_cache(maxsize=8)
def path_ground(scene: str, robot: str = ROBOT) -> Ground:
    """Returns scene, robot and the map of the floor with furniture and objects as at load.

    Raises:
        GibsonSimError: one of them cannot be loaded.
    """
    loaded, spec = load_scene(scene), load_robot(robot)
    if spec.drive is None:
        raise ConfigError(f"robot {quoted(robot)} has no drive; followers of paths need one that moves")
    return Ground(loaded, spec, furnished_floor_map(loaded, spec))


def draw_cases(ground: Ground, scene: str, length: float, count: int, seed: int) -> tuple[PathCase, ...]:
    """Returns paths of a length; equal arguments give equal paths.

    Args:
        ground: the floor, see ``path_ground``.
        scene: name or path of the scene, as in the cases.
        length: length of the paths, metres.
        count: number of paths.
        seed: of the draws.

    Raises:
        SceneError: the scene has no room for that many.
    """
    rng = np.random.default_rng([seed, round(1000 * length), *scene.encode()])
    clearance = ground.robot.radius + CLEARANCE
    planner = ground.space.planner_of(clearance)
    region = ground.space.largest_region(clearance)
    found: list[PathCase] = []
    for attempt in range(_ATTEMPTS):
        if len(found) == count:
            return tuple(found)
        start_clearance = ground.robot.radius + START_CLEARANCE
        start = random_free_poses(ground.floor, 1, rng, clearance=start_clearance, region=region)[0].position[:2]
        line = (_direct_line if attempt < _DIRECT_ATTEMPTS else _line_through_waypoint)(ground, planner, start, length, rng)
        if line is not None and all(_differ(line, other.line) for other in found):
            corners = tuple((round(float(x), 4), round(float(y), 4)) for x, y in line)
            found.append(PathCase(scene, length, len(found), corners))
    if len(found) == count:
        return tuple(found)
    raise SceneError(
        f"scene {quoted(scene)} has room for {len(found)} of {count} paths of {length:g} m with a turn; ask for fewer or shorter ones"
    )


def _direct_line(
    ground: Ground, planner: PathPlanner, start: Sequence[float], length: float, rng: np.random.Generator
) -> F64 | None:
    """Returns the corners (K, 2), world frame, metres, of a shortest path from a start; None = it has no turn."""
    floor = ground.floor
    distance = planner.distances(start)
    cells = np.argwhere((distance >= length + 0.05) & (distance <= length + 0.5))
    if not len(cells):
        return None
    goal = floor.centers(cells[int(rng.integers(len(cells)))])
    line = _cut(planner.path(start, goal), length)
    return line if line is not None and greatest_turn(line) >= _MIN_TURN else None


def _line_through_waypoint(
    ground: Ground, planner: PathPlanner, start: Sequence[float], length: float, rng: np.random.Generator
) -> F64 | None:
    """Returns the corners (K, 2), world frame, metres, of a path from a start through a waypoint; None = it turns back or comes near itself."""
    floor = ground.floor
    distance = planner.distances(start)
    first = length * float(rng.uniform(*_WAYPOINT_SHARE))
    cells = np.argwhere(np.abs(distance - first) < 0.2)
    if not len(cells):
        return None
    waypoint = floor.centers(cells[int(rng.integers(len(cells)))])
    onward = planner.distances(waypoint)
    cells = np.argwhere((onward >= length - first + 0.3) & (onward <= length - first + 0.8) & (distance > first))
    if not len(cells):
        return None
    goal = floor.centers(cells[int(rng.integers(len(cells)))])
    line = _cut(np.concatenate([planner.path(start, waypoint), planner.path(waypoint, goal)[1:]]), length)
    if line is None or not _MIN_TURN <= greatest_turn(line) <= _MAX_TURN:
        return None
    points, stations = resampled(line)
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    return line if float(apart[np.abs(stations[:, None] - stations[None]) > _SELF_LENGTH].min()) >= _SELF_DISTANCE else None


def greatest_turn(line: ArrayLike) -> float:
    """Returns the greatest change of heading within ``_TURN_LENGTH`` of a line (K, 2), metres, in radians."""
    points, stations = resampled(line)
    steps = np.diff(points, axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    span = max(1, round(_TURN_LENGTH / float(stations[1])))
    if len(headings) <= span:
        return float(np.ptp(headings))
    return float(np.abs(headings[span:] - headings[:-span]).max())


def _differ(one: F64, other: Sequence[tuple[float, float]]) -> bool:
    """Returns whether the starts or the ends of two paths are ``_APART``."""
    return max(math.dist(one[0], other[0]), math.dist(one[-1], other[-1])) >= _APART


def _cut(line: F64, length: float) -> F64 | None:
    """Returns the first ``length`` metres of a line (K, 2), (M, 2); None = the line is shorter."""
    stations = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if stations[-1] < length:
        return None
    end = np.array([[np.interp(length, stations, line[:, k]) for k in range(2)]])
    return np.concatenate([line[stations < length - 1e-6], end])
