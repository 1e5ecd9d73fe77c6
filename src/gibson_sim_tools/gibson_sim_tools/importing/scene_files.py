"""Checks the files of a finished scene other than meshes (rooms, maps, free poses, licence, thumbnail): missing and outdated ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.rasterise import clip_to_slab
from gibson_sim.maps.export import FLOORS
from gibson_sim.maps.floor_map import FLOOR_CLEARANCE
from gibson_sim.maps.free_poses import FREE_POSES, FreePose, scene_free_poses
from gibson_sim.maps.traversability import scene_triangles
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.spec import SceneSpec

F64 = NDArray[np.float64]


def clearances(corners: ArrayLike, places: ArrayLike, low: float, high: float, *, max_distance: float = 1.0) -> F64:
    """Returns the horizontal distances, (N,), m, from points to the nearest triangle between two heights; at most ``max_distance``.

    Args:
        corners: (F, 3, 3), world frame, metres.
        places: points, (N, 2), world x, y, metres.
        low: height above which triangles are obstacles, metres.
        high: height below which triangles are obstacles, metres.
        max_distance: maximum distance measured, metres.
    """
    triangles = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    between = (triangles[:, :, 2].max(axis=1) > low) & (triangles[:, :, 2].min(axis=1) < high)
    polygons = clip_to_slab(triangles[between], low, high)
    points = np.asarray(places, dtype=np.float64).reshape(-1, 2)
    out = np.full(len(points), max_distance)
    first, last = polygons.min(axis=1), polygons.max(axis=1)
    for number, point in enumerate(points):
        is_near = ((first < point + max_distance) & (last > point - max_distance)).all(axis=1)
        if is_near.any():
            out[number] = min(max_distance, float(_distances(polygons[is_near], point).min()))
    return out


def _distances(polygons: F64, point: F64) -> F64:
    """Returns the distances (P,) from a point (2,) to convex polygons (P, K, 2) with repeated corners; 0 inside a polygon."""
    edges = np.roll(polygons, -1, axis=1) - polygons
    offsets = point - polygons
    length = np.einsum("pki,pki->pk", edges, edges)
    t = np.clip(np.einsum("pki,pki->pk", offsets, edges) / np.maximum(length, 1e-30), 0.0, 1.0)
    distance = np.linalg.norm(offsets - t[:, :, None] * edges, axis=2).min(axis=1)
    side = edges[:, :, 0] * offsets[:, :, 1] - edges[:, :, 1] * offsets[:, :, 0]
    inside = ((side >= 0).all(axis=1) | (side <= 0).all(axis=1)) & (np.abs(side).max(axis=1) > 0)
    return np.asarray(np.where(inside, 0.0, distance))


THUMBNAIL = "thumbnail.jpg"
_TOLERANCE = 0.001
"""Tolerance for the rounded heights and positions in the files, metres."""


def missing_items(scene: SceneSpec) -> list[str]:
    """Returns what a scene lacks, one text for each item; empty for a scene without a scene.yaml."""
    if not (scene.root / DESCRIPTION).is_file():
        return []
    files = [*(f"floor_trav_{number}.png" for number in range(len(scene.floors))), FLOORS, FREE_POSES, "LICENSE", THUMBNAIL]
    return [*([] if scene.rooms else [f"rooms in {DESCRIPTION}"]), *(name for name in files if not (scene.root / name).is_file())]


def is_partly_finished(scene: SceneSpec) -> bool:
    """Returns whether a scene has rooms, free poses or a thumbnail; a scene without them does not need the other files."""
    return bool(scene.rooms) or any((scene.root / name).is_file() for name in (FREE_POSES, THUMBNAIL))


def outdated_items(scene: SceneSpec, radius: float, height: float) -> Iterator[str]:
    """Yields one text for each contradiction between a scene and its maps and free poses.

    Args:
        scene: the scene, as loaded.
        radius: radius of the robot that must fit at every free pose, metres.
        height: height of that robot, metres.
    """
    yield from _check_floor_heights(scene)
    try:
        poses = scene_free_poses(scene)
    except SceneError as error:
        yield str(error)
        return
    without_floor = sum(pose.floor >= len(scene.floors) for pose in poses)
    if without_floor:
        yield f"{FREE_POSES}: {without_floor} poses are on floors that do not exist; the scene has {len(scene.floors)}"
    in_wrong_room = sum(_room_name(scene, pose) != pose.room for pose in poses)
    if in_wrong_room:
        yield f"{FREE_POSES}: {in_wrong_room} of {len(poses)} poses lie in another room than the file says"
    blocked = int(np.sum(free_distances(scene, poses, height) < radius - _TOLERANCE))
    if blocked:
        yield f"{FREE_POSES}: {blocked} of {len(poses)} poses are not free for a robot of radius {radius:g} m"


def free_distances(
    scene: SceneSpec, poses: Sequence[FreePose], height: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Returns the distances, (N,), m, at most 1, from poses to the nearest obstacle below ``height``; 1 on floors that do not exist."""
    out = np.ones(len(poses))
    if not poses:
        return out
    corners = scene_triangles(scene)
    numbers = np.array([pose.floor for pose in poses])
    places = np.array([(pose.x, pose.y) for pose in poses])
    for number, floor_z in enumerate(scene.floors):
        on_floor = numbers == number
        out[on_floor] = clearances(corners, places[on_floor], floor_z + FLOOR_CLEARANCE, floor_z + height)
    return out


def _check_floor_heights(scene: SceneSpec) -> Iterator[str]:
    path = scene.root / FLOORS
    if not path.is_file():
        return
    try:
        heights = sorted(float(number) for number in path.read_text(encoding="utf-8").split())
    except (OSError, UnicodeDecodeError, ValueError) as error:
        yield f"{FLOORS}: cannot be read: {error}"
        return
    if len(heights) != len(scene.floors) or any(abs(a - b) > _TOLERANCE for a, b in zip(heights, scene.floors, strict=True)):
        yield f"{FLOORS}: has floors at {_heights_text(heights)} m, the scene at {_heights_text(scene.floors)} m"


def _room_name(scene: SceneSpec, pose: FreePose) -> str:
    room = scene.room_at(pose.x, pose.y, pose.floor)
    return "" if room is None else room.name


def _heights_text(heights: Sequence[float]) -> str:
    return ", ".join(f"{z:g}" for z in heights) or "no heights"
