"""The site of runs: a scene with its doors as the scenario sets them, a robot, and the map of the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import ConfigError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_space import XY, FreeSpace
from gibson_sim.maps.named_poses import NamedPose, named_poses
from gibson_sim.maps.placement import furnished_floor_map
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.settings import nearest
from gibson_sim.trials.records import PlanarPose
from gibson_sim.trials.scenario.keys import ALL

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
WIDE_MARGIN = 0.15
"""Clearance of the path that objects leave free, if such a path exists without them, m: enough for a stack's noise and inflation."""
_HANDLES = ("handle", "lever", "knob")
"""Suffixes of the names of joints that do not open anything."""
_SAME_FLOOR = 0.5
"""Largest difference between the height of a pose and that of the floor, metres."""
_SWING_STEPS = 12
"""Number of sampled positions of a closing door: its edge moves by less than 0.15 m between two of them."""
_MAX_NAMED = 8
"""Number of poses that a message names."""


def with_closed_doors(scene: SceneSpec, names: Sequence[str]) -> tuple[SceneSpec, tuple[str, ...]]:
    """Returns the scene with doors closed, and the names of their bodies.

    Args:
        scene: the scene.
        names: names of bodies with a door; ``all`` = all bodies with a fixed root, such as a door in a doorway.

    Raises:
        ConfigError: a body does not exist or has no door; the message lacks the key.
    """
    doors = [body.name for body in scene.bodies if _openings(body)]
    for name in names:
        if name != ALL and name not in doors:
            is_body = any(body.name == name for body in scene.bodies)
            hint = nearest(name, doors)
            raise ConfigError(
                f"is {quoted(name)}, which {'has no door' if is_body else 'is not'} in scene {quoted(scene.name)}; "
                f"{f'{hint} ' if hint else ''}known: {', '.join(doors[:20]) or 'none'}"
            )
    fixed = [body.name for body in scene.bodies if body.static and body.name in doors]
    chosen = tuple(fixed if ALL in names else [name for name in doors if name in names])
    return _with_doors_moved(scene, chosen, 1.0), chosen


def _openings(body: BodySpec) -> dict[str, float]:
    """Returns the joints of a body's doors and drawers with their closed positions, rad or m."""
    return {
        joint.name: min(max(0.0, joint.lower), joint.upper)
        for joint in body.model.joints
        if joint.is_bounded
        and joint.kind in ("revolute", "prismatic")
        and joint.lower < joint.upper
        and not joint.name.endswith(_HANDLES)
    }


def _closed(body: BodySpec, fraction: float = 1.0) -> BodySpec:
    """Returns a body with its doors closed by a fraction of their travel, 0 to 1."""
    positions = dict(body.joints)
    moved = {name: (1.0 - fraction) * positions.get(name, closed) + fraction * closed for name, closed in _openings(body).items()}
    return replace(body, joints=tuple({**positions, **moved}.items()))


def swept_door_cells(scene: SceneSpec, doors: Sequence[str], robot: RobotSpec) -> Bools:
    """Returns a mask (H, W) of the map cells that closing doors sweep: a run starts with the doors at their positions after loading.

    Args:
        scene: scene with the doors at their positions after loading.
        doors: names of the bodies whose doors are closed.
        robot: robot whose height limits the obstacles.
    """
    closed = furnished_floor_map(_with_doors_moved(scene, doors, 1.0), robot).occupied
    swept = np.zeros_like(closed)
    for fraction in np.arange(_SWING_STEPS) / _SWING_STEPS:
        swept |= furnished_floor_map(_with_doors_moved(scene, doors, float(fraction)), robot).occupied
    return np.asarray(swept & ~closed)


def _with_doors_moved(scene: SceneSpec, doors: Sequence[str], fraction: float) -> SceneSpec:
    return replace(scene, bodies=tuple(_closed(body, fraction) if body.name in doors else body for body in scene.bodies))


@dataclass(frozen=True)
class Site:
    """A scene and a robot of a trial."""

    scene_name: str
    """Name as in the scenario."""
    robot_name: str
    scene: SceneSpec
    """Scene without robots, with the doors closed that the scenario closes."""
    robot: RobotSpec
    floor: FloorMap
    """Map with the bodies at their poses after loading."""
    open_scene: SceneSpec
    """Scene with the doors at their positions after loading."""
    closed_doors: tuple[str, ...] = ()
    swept: Bools | None = None
    """(H, W): mask of the cells that closing doors sweep; None = no door closes."""
    _wide: dict[tuple[XY, XY], bool] = field(default_factory=dict)
    """(start, goal) -> whether a path with a clearance of ``WIDE_MARGIN`` connects them."""

    @cached_property
    def space(self) -> FreeSpace:
        """Free space of the robot on ``floor``."""
        return FreeSpace(self.floor, self.robot.radius)

    @cached_property
    def swept_distance(self) -> F64:
        """(H, W): distance from the centre of a cell to the nearest cell that closing doors sweep, metres."""
        if self.swept is None or not self.swept.any():
            return np.full(self.floor.shape, np.inf)
        return np.asarray(ndimage.distance_transform_edt(~self.swept) * self.floor.resolution)

    @cached_property
    def named_poses(self) -> tuple[NamedPose, ...]:
        """Named poses of the scene after loading with the robot, as the simulation lists them."""
        return named_poses(replace(self.open_scene, robots=(self.robot,)))

    def leaves_path(self, space: FreeSpace, start: XY, goal: XY) -> bool:
        """Returns whether a free space has a path between two points, with ``WIDE_MARGIN`` if that of the site has such a path."""
        wide = self.robot.radius + WIDE_MARGIN
        if (start, goal) not in self._wide:
            self._wide[start, goal] = self.space.connected(start, goal, wide, snap=True)
        return space.connected(start, goal, wide if self._wide[start, goal] else None, snap=True)

    def place_problem(self, xy: XY) -> str:
        """Returns why the robot cannot stand at a point, map frame, metres; empty = it can."""
        scene = quoted(self.scene_name)
        row, column = (int(i) for i in self.floor.cells(xy))
        rows, columns = self.floor.shape
        if not (0 <= row < rows and 0 <= column < columns):
            low = self.floor.origin
            high = (low[0] + columns * self.floor.resolution, low[1] + rows * self.floor.resolution)
            return f"outside the map of scene {scene}, must be from x {low[0]:.1f} to {high[0]:.1f} and y {low[1]:.1f} to {high[1]:.1f} m"
        if self.floor.occupied[row, column]:
            problem = "in a wall, furniture or another obstacle"
        elif not self.floor.floor[row, column]:
            problem = "at a place without floor"
        # A cell that an obstacle merely touches is occupied as a whole, so that the map is stricter than the simulation.
        elif self.floor.distance_to_obstacle[row, column] + self.floor.resolution * math.sqrt(0.5) < self.robot.radius:
            room = float(self.floor.distance_to_obstacle[row, column])
            problem = f"{room:.2f} m from an obstacle, closer than the radius of the robot, {self.robot.radius:.2f} m,"
        else:
            return ""
        free = self.floor.nearest_free(xy, self.robot.radius)
        return f"{problem} in scene {scene}{f'; the nearest free place is {free[0]:.2f},{free[1]:.2f}' if free else ''}"

    def start_problem(self, xy: XY) -> str:
        """Returns why a run cannot start at a point, map frame, metres, where the robot can stand; empty = it can."""
        if float(self.floor.look_up(self.swept_distance, xy, outside=0.0)) >= self.robot.radius:
            return ""
        return f"where a door of obstacles.closed_doors stands or swings until it is closed, in scene {quoted(self.scene_name)}"

    def given_pose(self, text: str) -> PlanarPose:
        """Returns the pose that a text gives: ``x,y,yaw_deg``, or a name.

        Raises:
            ConfigError: the text is not a pose, or the pose is on another floor; the message lacks the key.
        """
        parts = text.split(",")
        try:
            numbers = [float(part) for part in parts]
        except ValueError:
            numbers = []
        if len(numbers) == 3 and all(map(math.isfinite, numbers)):
            x, y, yaw_deg = numbers
            return x, y, math.radians(math.remainder(yaw_deg, 360.0))
        if len(parts) > 1:
            raise ConfigError(f"is {quoted(text)}, must be x,y,yaw_deg: three finite numbers, metres and degrees, in quotes")
        poses = {start.name: start.pose for start in self.open_scene.starts}
        if text not in poses:
            poses = {**{named.name: named.pose for named in self.named_poses}, **poses}
        if text not in poses:
            hint, known = nearest(text, tuple(poses)), ", ".join(list(poses)[:_MAX_NAMED])
            raise ConfigError(
                f"is {quoted(text)}, must be sampled, x,y,yaw_deg in quotes, or a named pose of scene {quoted(self.scene_name)}; "
                f"{f'{hint} ' if hint else ''}known: {known}{', ...' if len(poses) > _MAX_NAMED else ''}"
            )
        (x, y, z), (_, _, qz, qw) = poses[text].position, poses[text].quat_xyzw
        if abs(z - self.floor.floor_z) > _SAME_FLOOR:
            raise ConfigError(
                f"is {quoted(text)}, which is {z:.1f} m high in scene {quoted(self.scene_name)}; trials use the floor at {self.floor.floor_z:g} m"
            )
        return x, y, math.remainder(2.0 * math.atan2(qz, qw), 2.0 * math.pi)

    def closed_doors_block(self, start: XY, goal: XY) -> bool:
        """Returns whether doors are closed and a path exists if they are open."""
        if not self.closed_doors:
            return False
        opened = FreeSpace(furnished_floor_map(self.open_scene, self.robot), self.robot.radius)
        return self.leaves_path(opened, start, goal)
