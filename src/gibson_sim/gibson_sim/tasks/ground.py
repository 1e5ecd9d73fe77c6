"""The ground of a task: scene, robot, floor and free space, and the visibility of points. Pure and deterministic."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import matrix_from_quat, yaw_from_quat
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_space import FreeSpace
from gibson_sim.maps.placement import robot_floor_map
from gibson_sim.maps.rooms import Door, find_rooms
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import Item, item_body
from gibson_sim.types import Pose

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
SIGHT = 5.0
"""Distance up to which an object counts as seen, metres."""


@dataclass(frozen=True)
class Ground:
    """A scene without the items of a task, a robot, and the map of the lowest floor."""

    scene: SceneSpec
    """The scene, without robots."""
    robot: RobotSpec
    floor: FloorMap

    @cached_property
    def space(self) -> FreeSpace:
        """Free space of the robot between static obstacles."""
        return FreeSpace(self.floor, self.robot.radius)

    @cached_property
    def doors(self) -> tuple[Door, ...]:
        """Doorways: narrow passages between rooms."""
        return find_rooms(self.floor)[1]

    @property
    def half_view(self) -> float:
        """Half the horizontal field of view of the robot's first camera, radians."""
        if not self.robot.cameras:
            raise ConfigError(f"robot {self.robot.name!r} has no camera; this task needs a robot with a camera")
        camera = self.robot.cameras[0]
        return math.atan(math.tan(camera.fov_y / 2.0) * camera.width / camera.height)

    def sees(self, base: Pose, points: ArrayLike, sight: float = SIGHT) -> Bools:
        """Returns a mask, (N,), of the points (N, 2), world frame, metres, in the field of view, in range and not occluded by static obstacles."""
        x, y = base.position[:2]
        targets = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        offsets = targets - (x, y)
        distances = np.linalg.norm(offsets, axis=1)
        bearings = np.arctan2(offsets[:, 1], offsets[:, 0]) - yaw_from_quat(base.quat_xyzw)
        bearings = np.abs((bearings + math.pi) % (2.0 * math.pi) - math.pi)
        out = np.asarray((distances <= sight) & (bearings <= self.half_view))
        out[out] = self._clear(np.array([x, y]), targets[out])
        return out

    def _clear(self, eye: F64, targets: F64) -> Bools:
        """Returns a mask, (N,), of the targets (N, 2) with a line of sight from a point (2,) that is free of static obstacles."""
        if not len(targets):
            return np.zeros(0, dtype=bool)
        longest = float(np.linalg.norm(targets - eye, axis=1).max())
        along = np.linspace(0.0, 1.0, max(2, math.ceil(2.0 * longest / self.floor.resolution)))
        cells = self.floor.cells(eye + (targets - eye)[:, None, :] * along[:, None])
        cells = np.clip(cells, 0, np.array(self.floor.shape) - 1)
        return ~np.asarray(self.floor.occupied[cells[..., 0], cells[..., 1]].any(axis=1))


@lru_cache(maxsize=8)
def ground_of(scene: str, robot: str) -> Ground:
    """Returns the ground of a scene for a robot, both by name or path; cached.

    Raises:
        GibsonSimError: the scene or the robot cannot be loaded.
    """
    loaded = load_scene(scene)
    spec = load_robot(robot)
    if spec.drive is None:
        raise ConfigError(f"robot {robot!r} has no drive; tasks need a robot with a drive")
    floor = robot_floor_map(loaded, spec)
    if not floor.free.any():
        raise SceneError(f"scene {scene!r}: has no free floor for a task")
    return Ground(loaded, spec, floor)


@lru_cache(maxsize=256)
def _outline(model: str) -> F64:
    """Returns the corners (4, 2) of the bounding box of an object's collision shapes, root frame, metres, counter-clockwise."""
    body = item_body(Item("outline", model, Pose()))
    empty = SceneSpec("outline", body.model.path.parent, "", (), (), bodies=(body,))
    corners, _ = body_triangles(empty)
    (x0, y0), (x1, y1) = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def footprint(model: str, pose: Pose) -> F64:
    """Returns the corners (4, 2) of an object's footprint at T_world_root, world frame, metres, counter-clockwise.

    Tilt is ignored: an object that has fallen over keeps its upright footprint.
    """
    corners = _outline(model)
    rotation = matrix_from_quat(pose.quat_xyzw)[:2, :2]
    return np.asarray(corners @ rotation.T + np.asarray(pose.position[:2]))
