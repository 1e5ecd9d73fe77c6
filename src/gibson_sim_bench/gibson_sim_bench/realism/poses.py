"""Samples poses of a camera with a robot and loose things in sight, some of them moved since the bake. Pure.

A pose is free: no obstacle is within ``_CLEARANCE_M`` of the camera, up to 1.5 m above the floor. Equal seeds give equal poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, matrix_from_pose, pose_from_xyz_rpy, quat_from_matrix
from gibson_sim.maps.bodies import body_triangles, link_transforms
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map, with_floor_at
from gibson_sim.quoting import quoted
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import CameraSpec, Pose, Vec3

HEIGHTS_M = (0.3, 0.8, 1.4)
"""Heights of the camera above the floor, m, in turn."""
_TILTS_DEG = (0.0, 5.0, 10.0)
"""Downward pitch at each height, degrees."""
FOV_Y_DEG = 60.0
"""Vertical field of view, degrees."""
_CLEARANCE_M, _COLUMN_M = 0.3, 1.5
"""Distance of the camera to obstacles; height below which they count, m."""
_ROBOT_M, _THING_M = (1.1, 3.0), (0.9, 2.6)
"""Nearest and farthest distance of the robot and of a moved thing from the camera, m."""
_HALF_VIEW = math.radians(24.0)
"""Largest angle of robot and things from the axis of the camera, radians."""
_THINGS = 2
"""Loose things that are moved into sight of each pose."""
_BETWEEN_M = 0.35
"""Least distance between robot and things, m."""
_DOOR_M = 1.2
"""Least distance of a door whose leaf is moved from camera, robot and things, m."""
_TRIES = 40
"""Poses that are tried until one has room for the robot in sight."""


@dataclass(frozen=True, slots=True)
class Arrangement:
    """One pose of the camera, and where everything that moves is."""

    camera: CameraSpec
    """The camera, fixed to the world."""
    robot: Pose | None
    """T_world_base of the robot; None = no room for it in sight."""
    bodies: tuple[BodySpec, ...]
    """All bodies of the scene, with their poses and joints."""
    moved: tuple[str, ...]
    """Names of the bodies that were moved."""
    text: str
    """Room, position, heading and height, for reports."""


def sample_arrangements(
    scene: SceneSpec, count: int, seed: int, *, robot_radius: float, width: int, samples: int
) -> list[Arrangement]:
    """Samples poses on the floors of a scene.

    Args:
        scene: the scene.
        count: number of poses.
        seed: seed of all random choices.
        robot_radius: radius of the robot, m.
        width: width of the pictures, pixels; their height is three quarters of it.
        samples: colour samples per pixel of the camera, 1 or 4.

    Raises:
        SceneError: no floor has room for the camera.
    """
    floors = [floor for floor in (_floor_of(scene, z) for z in scene.floors) if _free_cells(floor).any()]
    if not floors:
        raise SceneError(
            f"scene {quoted(scene.name)}: no floor has a place for the camera, {_CLEARANCE_M} m from all that is below {_COLUMN_M} m"
        )
    return [
        _sample(scene, floors, number, np.random.default_rng((seed, number)), robot_radius, width, samples)
        for number in range(count)
    ]


def _floor_of(scene: SceneSpec, z: float) -> FloorMap:
    there = with_floor_at(scene, z)
    return scene_floor_map(there, robot_height=_COLUMN_M).furnished(*body_triangles(there), _COLUMN_M)


def _free_cells(floor: FloorMap) -> NDArray[np.bool_]:
    """Returns the mask, (H, W), of the cells in which the camera may be."""
    return np.asarray(floor.inflate(_CLEARANCE_M) & floor.largest_free_region(_CLEARANCE_M))


def _sample(
    scene: SceneSpec,
    floors: Sequence[FloorMap],
    number: int,
    rng: np.random.Generator,
    robot_radius: float,
    width: int,
    samples: int,
) -> Arrangement:
    floor = floors[int(rng.integers(len(floors)))]
    cells = np.argwhere(_free_cells(floor))
    for _ in range(_TRIES):
        xy = floor.centers(cells[int(rng.integers(len(cells)))][None])[0]
        yaw = float(rng.uniform(-math.pi, math.pi))
        robot_xy = _in_sight(floor, xy, yaw, _ROBOT_M, robot_radius + 0.05, (), rng)
        if robot_xy is not None:
            break
    taken = [] if robot_xy is None else [robot_xy]
    bodies = {body.name: body for body in scene.bodies}
    moved: list[str] = []
    for name in _nearest_loose(scene.bodies, floor.floor_z, xy, rng):
        place = _in_sight(floor, xy, yaw, _THING_M, 0.2, taken, rng)
        if len(moved) == _THINGS or place is None:
            break
        pose = pose_from_xyz_rpy(
            (float(place[0]), float(place[1]), floor.floor_z), (0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))
        )
        bodies[name] = replace(bodies[name], start=pose)
        taken.append(place)
        moved.append(name)
    for name in _doors(scene.bodies, [xy, *taken]):
        if rng.random() < 0.5:
            bodies[name] = _opened(bodies[name], float(rng.random()))
            moved.append(name)
    height, tilt = HEIGHTS_M[number % len(HEIGHTS_M)], math.radians(_TILTS_DEG[number % len(HEIGHTS_M)])
    position = (float(xy[0]), float(xy[1]), floor.floor_z + height)
    robot = None
    if robot_xy is not None:
        robot = pose_from_xyz_rpy(
            (float(robot_xy[0]), float(robot_xy[1]), floor.floor_z), (0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))
        )
    room = scene.room_at(position[0], position[1], scene.floors.index(floor.floor_z))
    where = f"{room.name} " if room is not None else ""
    text = f"{where}{position[0]:.2f}, {position[1]:.2f}, {math.degrees(yaw):.0f} deg, {height:g} m"
    return Arrangement(camera_at(position, yaw, tilt, width, samples), robot, tuple(bodies.values()), tuple(moved), text)


def camera_at(position: Vec3, yaw: float, tilt: float, width: int, samples: int) -> CameraSpec:
    """Returns a camera fixed to the world, 4:3, at a position, m. ``yaw``: heading, ``tilt``: downwards, radians."""
    T = matrix_from_pose(pose_from_xyz_rpy(position, (0.0, tilt, yaw)))
    pose = Pose(position, quat_from_matrix(T[:3, :3] @ R_LINK_OPTICAL))
    return CameraSpec(
        "realism", "", pose, width, width * 3 // 4, math.radians(FOV_Y_DEG), outputs=("rgb", "depth"), samples=samples
    )


def _in_sight(
    floor: FloorMap,
    xy: NDArray[np.float64],
    yaw: float,
    distances: tuple[float, float],
    clearance: float,
    taken: Sequence[NDArray[np.float64]],
    rng: np.random.Generator,
) -> NDArray[np.float64] | None:
    """Returns a free point in sight, away from those that are taken; None = there is none."""
    points = floor.centers(np.argwhere(floor.inflate(clearance)))
    offsets = points - xy
    distance = np.hypot(*offsets.T)
    angle = np.abs((np.arctan2(offsets[:, 1], offsets[:, 0]) - yaw + math.pi) % (2 * math.pi) - math.pi)
    allowed = (distance >= distances[0]) & (distance <= distances[1]) & (angle <= _HALF_VIEW)
    for other in taken:
        allowed &= np.hypot(*(points - other).T) >= _BETWEEN_M
    for index in rng.permutation(np.flatnonzero(allowed)):
        if is_visible(floor, xy, points[index]):
            return np.asarray(points[index])
    return None


def is_visible(floor: FloorMap, a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Returns whether only free cells are between two points, (2,), m."""
    steps = max(2, math.ceil(float(np.linalg.norm(b - a)) / floor.resolution * 2))
    line = a + (b - a) * np.linspace(0.0, 1.0, steps)[:, None]
    return bool(floor.look_up(floor.free, line, outside=False).all())


def _nearest_loose(bodies: Sequence[BodySpec], floor_z: float, xy: NDArray[np.float64], rng: np.random.Generator) -> list[str]:
    """Returns the names of loose bodies on this floor, most likely near ones first."""
    loose = [
        body
        for body in bodies
        if not body.static and body.model.joints == () and floor_z - 0.1 <= body.start.position[2] <= floor_z + 2.0
    ]
    keys = [math.hypot(body.start.position[0] - xy[0], body.start.position[1] - xy[1]) * rng.uniform(0.5, 2.0) for body in loose]
    return [loose[index].name for index in np.argsort(keys)]


def _doors(bodies: Sequence[BodySpec], places: Sequence[NDArray[np.float64]]) -> list[str]:
    """Returns the names of the doors that can be moved without reaching a place."""
    return [
        body.name
        for body in bodies
        if body.semantic_class == "door"
        and all(math.hypot(body.start.position[0] - x, body.start.position[1] - y) >= _DOOR_M for x, y in places)
    ]


def _opened(body: BodySpec, fraction: float) -> BodySpec:
    """Returns a door with its leaf moved by a fraction of the range of its first joint with limits."""
    joint = next((joint for joint in body.model.joints if joint.is_bounded and joint.upper > joint.lower), None)
    if joint is None:
        return body
    position = joint.lower + fraction * (joint.upper - joint.lower)
    return replace(body, joints=(*((name, value) for name, value in body.joints if name != joint.name), (joint.name, position)))


def body_poses(bodies: Sequence[BodySpec]) -> dict[str, NDArray[np.float64]]:
    """Returns T_world_link, (4, 4), of all links of bodies, by ``<body>/<link>``."""
    return {f"{body.name}/{link}": T for body in bodies for link, T in link_transforms(body).items()}
