"""Draws the paths that followers are tried on: by a seed, on the floor of a scene, of a length, with at least one real turn. Pure."""

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
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.robot_files import load_robot
from gibson_sim.tasks.ground import Ground
from gibson_sim_learn.path_following.oracle import dense

F64 = NDArray[np.float64]
LENGTHS = (6.6, 8.4, 12.7)
"""Lengths of the paths of the paper's Table 2, metres."""
ROBOT = "gibson_bot"
CLEARANCE = 0.13
"""Clearance of a path beyond the robot's radius, metres: the robot cuts corners."""
START_ROOM = 0.25
"""Clearance at its beginning beyond the robot's radius, metres: drives begin beside it."""
_TURN = math.radians(60.0)
"""Least turn within ``_WITHIN`` metres that a path must have."""
_WITHIN = 1.2
_TRIES = 1000
"""Pairs of start and goal that are tried for the paths of a length."""
_DIRECT = 300
"""Of these, those that are connected by the shortest way; later ones lead by a third place, since a small scene has few long ways."""
_SHARE = (0.3, 0.7)
"""Part of a path on which its third place lies."""
_SHARPEST = math.radians(120.0)
"""Greatest turn of a path with a third place: it must not turn back."""
_OWN_WAY = 0.7
"""Least distance of such a path from itself, metres, between places that are more than ``_LATER`` apart along it."""
_LATER = 2.0
_APART = 0.6
"""Least distance of the starts, or else of the ends, of two paths, metres."""


@dataclass(frozen=True, slots=True)
class PathCase:
    """A path to be recorded and followed."""

    scene: str
    """Name or path of the scene."""
    length: float
    """Metres."""
    number: int
    """Among the paths of this length in this scene."""
    line: tuple[tuple[float, float], ...]
    """Its corners, world frame, metres; free of obstacles."""

    @property
    def start(self) -> tuple[float, float, float]:
        """Pose at its beginning, looking along it: x, y, yaw, metres and radians."""
        points, arc = dense(self.line)
        x, y = (float(np.interp(0.35, arc, points[:, k])) for k in range(2))
        return *self.line[0], math.atan2(y - self.line[0][1], x - self.line[0][0])


@lru_cache(maxsize=8)
def path_ground(scene: str, robot: str = ROBOT) -> Ground:
    """Returns scene, robot and the map of the floor with furniture and things as they stand at load.

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
        scene: its name or path, as it is to stand in the cases.
        length: metres.
        count: number of paths.
        seed: of the draws.

    Raises:
        SceneError: the scene has no room for that many.
    """
    rng = np.random.default_rng([seed, round(1000 * length), *scene.encode()])
    clearance = ground.robot.radius + CLEARANCE
    planner = PathPlanner(ground.floor, clearance)
    region = ground.floor.largest_free_region(clearance)
    found: list[PathCase] = []
    for attempt in range(_TRIES):
        if len(found) == count:
            return tuple(found)
        room = ground.robot.radius + START_ROOM
        start = random_free_poses(ground.floor, 1, rng, clearance=room, region=region)[0].position[:2]
        line = (_line_from if attempt < _DIRECT else _line_by)(ground, planner, start, length, rng)
        if line is not None and all(_differ(line, other.line) for other in found):
            corners = tuple((round(float(x), 4), round(float(y), 4)) for x, y in line)
            found.append(PathCase(scene, length, len(found), corners))
    if len(found) == count:
        return tuple(found)
    raise SceneError(
        f"scene {quoted(scene)} has room for {len(found)} of {count} paths of {length:g} m with a turn; ask for fewer or shorter ones"
    )


def _line_from(
    ground: Ground, planner: PathPlanner, start: Sequence[float], length: float, rng: np.random.Generator
) -> F64 | None:
    """Returns the corners (K, 2) of a path from a place; None = there is none with a turn."""
    floor = ground.floor
    away = planner.distances(start)
    cells = np.argwhere((away >= length + 0.05) & (away <= length + 0.5))
    if not len(cells):
        return None
    goal = floor.centers(cells[int(rng.integers(len(cells)))])
    line = _cut(planner.path(start, goal), length)
    return line if line is not None and greatest_turn(line) >= _TURN else None


def _line_by(ground: Ground, planner: PathPlanner, start: Sequence[float], length: float, rng: np.random.Generator) -> F64 | None:
    """Returns the corners (K, 2) of a path from a place by another one; None = there is none that is a way of its own."""
    floor = ground.floor
    away = planner.distances(start)
    first = length * float(rng.uniform(*_SHARE))
    cells = np.argwhere(np.abs(away - first) < 0.2)
    if not len(cells):
        return None
    middle = floor.centers(cells[int(rng.integers(len(cells)))])
    onward = planner.distances(middle)
    cells = np.argwhere((onward >= length - first + 0.3) & (onward <= length - first + 0.8) & (away > first))
    if not len(cells):
        return None
    goal = floor.centers(cells[int(rng.integers(len(cells)))])
    line = _cut(np.concatenate([planner.path(start, middle), planner.path(middle, goal)[1:]]), length)
    if line is None or not _TURN <= greatest_turn(line) <= _SHARPEST:
        return None
    points, arc = dense(line)
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    return line if float(apart[np.abs(arc[:, None] - arc[None]) > _LATER].min()) >= _OWN_WAY else None


def greatest_turn(line: ArrayLike) -> float:
    """Returns the greatest change of heading within ``_WITHIN`` metres of a line (K, 2), radians."""
    points, arc = dense(line)
    steps = np.diff(points, axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    span = max(1, round(_WITHIN / float(arc[1])))
    if len(headings) <= span:
        return float(np.ptp(headings))
    return float(np.abs(headings[span:] - headings[:-span]).max())


def _differ(one: F64, other: Sequence[tuple[float, float]]) -> bool:
    return max(math.dist(one[0], other[0]), math.dist(one[-1], other[-1])) >= _APART


def _cut(line: F64, length: float) -> F64 | None:
    """Returns the first ``length`` metres of a line (K, 2); None = it is shorter."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if arc[-1] < length:
        return None
    end = np.array([[np.interp(length, arc, line[:, k]) for k in range(2)]])
    return np.concatenate([line[arc < length - 1e-6], end])
