"""Writes maps and free poses to the folder of a finished scene, computed from the loaded scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim.maps.export import write_gibson_maps
from gibson_sim.maps.floor_map import FLOOR_CLEARANCE, FLOOR_TOLERANCE, FloorMap, has_ground_at
from gibson_sim.maps.free_poses import FREE_POSES, FreePose, random_free_poses, write_free_poses
from gibson_sim.maps.traversability import RobotSize, floor_maps, scene_triangles
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.room_spec import RoomSpec, room_at
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.spec import SceneSpec

F64 = NDArray[np.float64]

USUAL_ROBOT = RobotSize(radius=0.22, height=1.5)
"""Robot size for which the files are computed, as high as a robot with an arm."""
POSES = 100
"""Number of free poses on each floor."""
SPARE = 0.03
"""Clearance between a robot at a free pose and the nearest obstacle, metres."""
_POSES_IN_A_ROOM = 5
"""Minimum number of free poses in each reachable room."""
_RESOLUTION = 0.02
"""Cell size of the maps, metres."""


def write_scene_files(folder: Path, robot: RobotSize = USUAL_ROBOT, *, seed: int = 0) -> tuple[Path, ...]:
    """Writes ``floor_trav_N.png``, ``floors.txt`` and ``free_poses.csv`` to a scene's folder; returns their paths.

    Bodies are included at their start poses. All poses of a floor are mutually reachable. The same scene and seed give the same files.

    Args:
        folder: folder of the scene, with its scene.yaml.
        robot: size of the robot, which fits at every pose.
        seed: seed of the poses.

    Raises:
        SceneError: the scene does not exist, a file cannot be written, or a floor has no room for the robot.
    """
    if not (folder / DESCRIPTION).is_file():
        raise SceneError(f"{folder}: holds no {DESCRIPTION}; only a scene with one can hold maps: import it first")
    scene = load_scene(folder)
    floors = floor_maps(scene, robot, resolution=_RESOLUTION, floors=scene.floors)
    rng = np.random.default_rng(seed)
    triangles = scene_triangles(scene)
    poses = [pose for number, floor in enumerate(floors) for pose in _poses(scene, number, floor, triangles, robot, rng)]
    paths = write_gibson_maps(floors, folder)
    write_free_poses(folder / FREE_POSES, poses)
    # Delete maps of floors that the scene no longer has.
    for old in sorted(set(folder.glob("floor_trav_*.png")) - set(paths)):
        old.unlink()
    return (*paths, folder / FREE_POSES)


def _poses(
    scene: SceneSpec, number: int, floor: FloorMap, triangles: F64, robot: RobotSize, rng: np.random.Generator
) -> list[FreePose]:
    """Returns the poses of one floor in random order: some in each room, the others anywhere.

    Args:
        scene: the scene.
        number: index of the floor.
        floor: map of the floor.
        triangles: (F, 3, 3), collision shapes, world metres.
        robot: size of the robot.
        rng: random generator.
    """
    clearance = robot.radius + SPARE
    # Exclude free cells on bumps and ramps, on which a robot would not stand level at the height of the floor.
    vertices = triangles.reshape(-1, 3)
    floor = floor.furnished(vertices, np.arange(len(vertices)).reshape(-1, 3), robot.height)
    region = floor.largest_free_region(clearance)
    poses = [
        pose
        for room in scene.rooms
        if room.floor == number and (part := region & _cells(floor, room)).any()
        for pose in random_free_poses(floor, _POSES_IN_A_ROOM, rng, clearance=clearance, region=part)
    ][:POSES]
    poses += random_free_poses(floor, POSES - len(poses), rng, clearance=clearance, region=region)
    heights = _surface(floor, triangles)
    if scene.ground_z is not None and has_ground_at(scene, floor.floor_z):
        heights = np.maximum(heights, scene.ground_z)
    out = []
    for index in rng.permutation(len(poses)):
        # Round as in the file, so that the room is that of the rounded position.
        x, y = (round(c, 3) for c in poses[index].position[:2])
        z = _height(floor, heights, (x, y), robot.radius)
        room = room_at(scene.rooms, x, y, number)
        yaw = 2.0 * math.atan2(poses[index].quat_xyzw[2], poses[index].quat_xyzw[3])
        out.append(FreePose(number, x, y, z, math.remainder(yaw, 2.0 * math.pi), "" if room is None else room.name))
    return out


def _cells(floor: FloorMap, room: RoomSpec) -> NDArray[np.bool_]:
    """Returns a mask (H, W) of the cells completely inside a room."""
    rows, columns = np.indices(floor.shape)
    middles = floor.centers(np.stack([rows, columns], axis=-1))
    half = floor.resolution / 2
    inside = [
        room.contains(middles + np.array(offset)) for offset in ((-half, -half), (-half, half), (half, -half), (half, half))
    ]
    return np.asarray(np.all(inside, axis=0))


def _surface(floor: FloorMap, triangles: F64) -> F64:
    """Returns (H, W): height of the surface that supports a robot, world metres, from triangles (F, 3, 3); -inf = no surface."""
    low, high = floor.floor_z - FLOOR_TOLERANCE, floor.floor_z + FLOOR_CLEARANCE
    near = triangles[(triangles[:, :, 2].min(axis=1) >= low) & (triangles[:, :, 2].max(axis=1) <= high)]
    level = near[np.abs(unit_normals(near)[:, 2]) > 0.9]
    return floor.grid.heights(level, np.maximum)


def _height(floor: FloorMap, heights: F64, xy: tuple[float, float], radius: float) -> float:
    """Returns the maximum of the heights (H, W) below a disc about a point, world metres; that of the floor without a surface."""
    row, column = (int(i) for i in floor.cells(xy))
    reach = math.ceil(radius / floor.resolution)
    rows = slice(max(0, row - reach), row + reach + 1)
    columns = slice(max(0, column - reach), column + reach + 1)
    highest = float(heights[rows, columns].max())
    return highest if math.isfinite(highest) else floor.floor_z
