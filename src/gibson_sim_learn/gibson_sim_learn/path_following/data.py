"""Training data of path following: images in scenes, with ground truth.

A *shard* is one folder of memory-mapped arrays: images along some paths in one scene, rendered twice: as recorded, and as a follower may see them
later, beside the path, in conditions of the domain ``trained`` (light, camera), with moved objects, and obstacles on the path. Pairs of a later
and a recorded image have their relative pose. Everything is drawn from the seed, the scene and the number of the shard, so that an interrupted
run goes on with the missing shards, and equal seeds give equal data.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import SceneError
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.paths import PathPlanner
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import item_body
from gibson_sim_learn.arrays import load_arrays, save_arrays
from gibson_sim_learn.path_following.clutter import random_furniture, random_object
from gibson_sim_learn.path_following.domains import TRAINED, Conditions, draw
from gibson_sim_learn.path_following.drawing import CAMERA_AHEAD, HFOV, Drawing
from gibson_sim_learn.remaining import Remaining

F64 = NDArray[np.float64]
DIRECTIONS = 24
"""Number of bearings of free distances: centres of equal strips of the image, from left to right."""
MAX_FREE = 3.0
"""Largest free distance, metres; larger ones are clamped to it."""
FREE_EDGES: tuple[float, ...] = (*(0.1 * k for k in range(13)), *(1.2 + 0.15 * k for k in range(1, 13)))
"""Edges of the range bins, metres, from 0 to ``MAX_FREE``."""
BODY_HEIGHT = 0.5
"""Height above the floor up to which objects are obstacles, metres."""
ROBOT_RADIUS = 0.2
"""Radius of the robot, metres."""
PAIR = np.dtype([("later", "<i4"), ("recorded", "<i4"), ("x", "<f4"), ("y", "<f4"), ("yaw", "<f4"), ("match", "?")])
"""A pair: rows of two images; pose of the recorded camera in the later camera's frame, x ahead, y to the left, metres and radians; whether both show
the same place, so that the pose can be estimated."""

_RESOLUTION = 0.025
"""Resolution of the maps for free distances, metres."""
_COARSE = 0.05
"""Resolution of the maps for planning, metres."""
_RAY_STEP = 0.0125
"""Step of ray casting, metres."""
_MATCH_X, _MATCH_Y, _MATCH_YAW = (-0.7, 2.2), 1.2, math.radians(65.0)
"""Limits of the relative pose of two images of one place: x, |y|, |yaw|; metres and radians."""
_LABEL_DEVIATION_RATIO, _MIN_LABEL_DEVIATION = 0.04, 0.02
"""Standard deviation of soft labels per true distance, and its least value, metres: neighbouring bins are nearly right."""
_MAX_OBSTACLES = 2
"""Largest number of obstacles on or near a path in later images."""
_MAX_OFFSET = 0.4
"""Largest lateral offset of their centres from the path, metres."""
_MAX_FURNITURE = 10
"""Largest number of pieces of furniture that a shard adds to its scene."""
_FURNITURE_DISTANCE = 0.35
"""Least distance of such a piece from all paths, metres."""
_ARRAYS, _OPTIONAL_ARRAYS = ("images", "free", "pairs"), ("earlier", "earlier_pose")
"""Arrays of a shard: required and optional ones."""
_CLOSE_SHARE = 0.4
"""Probability that a later view on a path with obstacles is close before one of them."""


@dataclass(frozen=True, slots=True)
class DataSettings:
    """Amount and variety of the data."""

    paths: int = 8
    """Paths of a shard."""
    views_per_path: int = 60
    """Later images of a path."""
    free_views: int = 60
    """Later images of a shard at random free poses, for free distances alone."""
    spacing: float = 0.2
    """Distance between recorded images, metres."""
    length: tuple[float, float] = (3.0, 14.0)
    """Shortest and longest path, metres; a longer one is truncated."""
    recolour_chance: float = 0.7
    """Probability that a shard has other colours and textures than its scene."""
    changed_recordings: float = 0.3
    """Probability that exposure and colours of a recorded image differ, too."""


@dataclass(frozen=True, slots=True)
class Shard:
    """The data of one shard; arrays may be memory-mapped."""

    images: NDArray[np.uint8]
    """(N, 64, 96, 3), uint8, RGB."""
    free: NDArray[np.float32]
    """(N, 24), float32: free distances from the camera, below ``BODY_HEIGHT``, metres, leftmost bearing first."""
    pairs: NDArray[Any]
    """(P,) of ``PAIR``."""
    earlier: NDArray[np.uint8] | None = None
    """(N, 64, 96, 3), uint8: earlier images of the same cameras; None = there are none."""
    earlier_pose: NDArray[np.float32] | None = None
    """(N, 3), float32: poses of the earlier cameras in the present cameras' frames: x ahead, y to the left, yaw; metres and radians."""


def column_bearings(hfov: float, columns: int = DIRECTIONS) -> F64:
    """Returns (columns,), float64: bearings of the centres of equal strips of a pinhole image, radians, positive to the left, leftmost first."""
    across = 1.0 - (np.arange(columns) + 0.5) * 2.0 / columns
    return np.asarray(np.arctan(across * math.tan(hfov / 2.0)))


def free_distances(floor: FloorMap, poses: F64, bearings: F64, *, longest: float = MAX_FREE) -> F64:
    """Returns (N, D), float64: free distances, from poses to the first cell along each ray that is not free, metres.

    Args:
        floor: the map.
        poses: (N, 3), x, y, yaw, world frame, metres and radians.
        bearings: (D,) or (N, D), bearings relative to yaw, radians, positive to the left.
        longest: largest distance, metres.
    """
    angles = poses[:, 2:3] + np.broadcast_to(bearings, (len(poses), np.shape(bearings)[-1]))
    steps = np.arange(1, math.ceil(longest / _RAY_STEP) + 1) * _RAY_STEP
    out = np.empty(angles.shape)
    blocked = ~floor.free
    for k, (x, y) in enumerate(poses[:, :2]):
        rays = np.stack([x + np.cos(angles[k])[:, None] * steps, y + np.sin(angles[k])[:, None] * steps], axis=-1)
        hits = floor.look_up(blocked, rays, outside=True)
        out[k] = np.where(hits.any(axis=1), steps[hits.argmax(axis=1)], longest)
    return np.minimum(out, longest)


def distance_labels(free: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns (..., B + 1), float32: soft labels of the bins of ``FREE_EDGES``, and of beyond them, for free distances (...,), metres."""
    edges = np.array(FREE_EDGES, np.float32)
    scale = np.maximum(_LABEL_DEVIATION_RATIO * free, _MIN_LABEL_DEVIATION)[..., None]
    below = 1.0 / (1.0 + np.exp(np.clip(1.702 * (free[..., None] - edges) / scale, -60.0, 60.0)))
    below[..., 0] = 0.0
    below[free >= 0.99 * MAX_FREE] = 0.0
    return np.concatenate([np.diff(below, axis=-1), 1.0 - below[..., -1:]], axis=-1).astype(np.float32)


def median_distances(edges: F64, hit: F64) -> F64:
    """Returns (...,), float64: median ranges of the first obstacle, metres; the last edge if they are beyond it.

    Args:
        edges: (B + 1,), edges of the range bins, metres, from 0.
        hit: (..., B + 1), probability that the first obstacle lies in each bin; the last: beyond the last edge.
    """
    within = np.cumsum(hit[..., :-1], axis=-1)
    row = np.minimum(np.sum(within < 0.5, axis=-1), within.shape[-1] - 1)[..., None]
    share = np.take_along_axis(hit, row, axis=-1)
    before = np.take_along_axis(within, row, axis=-1) - share
    part = np.clip((0.5 - before) / np.maximum(share, 1e-9), 0.0, 1.0)
    return np.asarray(edges[row] + part * (edges[row + 1] - edges[row]))[..., 0]


def relative_pose(frm: F64, to: F64) -> F64:
    """Returns (..., 3), float64: planar poses ``to`` (..., 3) in the frames ``frm`` (..., 3): x, y, yaw; metres and radians, yaw in [-pi, pi)."""
    dx, dy = to[..., 0] - frm[..., 0], to[..., 1] - frm[..., 1]
    c, s = np.cos(frm[..., 2]), np.sin(frm[..., 2])
    yaw = (to[..., 2] - frm[..., 2] + math.pi) % (2.0 * math.pi) - math.pi
    return np.stack([c * dx + s * dy, c * dy - s * dx, yaw], axis=-1)


def shard_name(scene: str, number: int) -> str:
    """Returns the name of a shard's folder."""
    return f"{scene}-{number:03d}"


def load_shard(folder: Path) -> Shard:
    """Returns a shard, its arrays memory-mapped.

    Raises:
        ConfigError: it cannot be read.
    """
    names = _ARRAYS + (_OPTIONAL_ARRAYS if (folder / f"{_OPTIONAL_ARRAYS[0]}.npy").is_file() else ())
    return Shard(*load_arrays(folder, names, "delete it, and run `gibson-sim learn path-following` again"))


def save_shard(folder: Path, shard: Shard) -> None:
    """Writes a shard; the folder appears complete or not at all."""
    names = _ARRAYS if shard.earlier is None else _ARRAYS + _OPTIONAL_ARRAYS
    save_arrays(folder, {name: getattr(shard, name) for name in names})


def missing_shards(folder: Path, scenes: Sequence[str], count: int) -> Iterator[tuple[str, int]]:
    """Yields scene and number of the missing shards, in turn for all scenes."""
    for number in range(count):
        for scene in scenes:
            if not (folder / shard_name(scene, number)).is_dir():
                yield scene, number


def make_data(
    folder: Path,
    scenes: Sequence[str],
    count: int,
    draw_one: Callable[[World, int], Shard],
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Draws the missing shards.

    Args:
        folder: folder of the shards.
        scenes: names of the scenes.
        count: number of shards of each scene.
        draw_one: draws the shard of a scene and a number.
        progress: called with one line before each shard.
    """
    worlds: dict[str, World] = {}
    total = len(scenes) * count
    todo = list(missing_shards(folder, scenes, count))
    remaining = Remaining(total - len(todo))
    for done, (scene, number) in enumerate(todo, total - len(todo)):
        progress(f"{shard_name(scene, number)}, {done} of {total} shards{remaining.text(done, total)}")
        if scene not in worlds:
            worlds[scene] = World.load(scene)
        save_shard(folder / shard_name(scene, number), draw_one(worlds[scene], number))


def shard_rng(text: str) -> np.random.Generator:
    """Returns a random generator seeded by a text, such as the name of a shard."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little"))


@dataclass(frozen=True, slots=True)
class World:
    """A scene and its maps."""

    scene: SceneSpec
    """Without robots."""
    bare: FloorMap
    """Fine map of the static geometry alone."""
    floor: FloorMap
    """Fine map with the bodies at their poses at load."""
    coarse: FloorMap
    """Coarse map with the same bodies, for planning."""

    @classmethod
    def load(cls, name: str) -> World:
        """Returns a scene by name."""
        scene = replace(load_scene(name), robots=())
        bare, coarse = (scene_floor_map(scene, robot_height=BODY_HEIGHT, resolution=cell) for cell in (_RESOLUTION, _COARSE))
        return cls(scene, bare, *(with_bodies(scene, floor, scene.bodies) for floor in (bare, coarse)))


def draw_shard(world: World, seed: int, number: int, settings: DataSettings = DataSettings()) -> Shard:
    """Returns a shard; equal arguments give equal data."""
    rng = shard_rng(f"{seed} {world.scene.name} {number}")
    planner = PathPlanner(world.coarse, ROBOT_RADIUS + 0.08)
    paths = [draw_path(world.coarse, planner, rng, settings) for _ in range(settings.paths)]
    drives = np.concatenate(paths)
    count = int(rng.integers(TRAINED.moved[0], TRAINED.moved[1] + 1)) + 1
    furniture = _furniture(world.coarse, rng, drives)
    objects = [[*furniture, *_random_objects(world.coarse, rng, count, name, keep_off=drives)] for name in ("recorded", "later")]
    obstacles = [_random_obstacles(path, world.floor.floor_z, rng, f"on_path_{k}") for k, path in enumerate(paths)]
    objects[1] += [body for bodies, _ in obstacles for body in bodies]
    floors = [with_bodies(world.scene, world.floor, some) for some in objects]

    recorded, later, of_recorded, of_later = [], [], [], []
    every = max(1, round(settings.spacing / _PATH_STEP))
    for k, path in enumerate(paths):
        nodes = path[::every] + rng.normal(0.0, (0.03, 0.03, 0.05), (len(path[::every]), 3))
        recorded.append(nodes)
        of_recorded += [(k, row * every) for row in range(len(nodes))]
        poses, rows = _off_path(path, obstacles[k][1], floors[1], rng, settings.views_per_path)
        later.append(poses)
        of_later += [(k, int(row)) for row in rows]
    free_views = random_view_poses(world, floors[1], rng, settings.free_views)
    later.append(free_views)
    of_later += [(-1, 0)] * len(free_views)

    before, after = (camera_poses(np.concatenate(poses), CAMERA_AHEAD) for poses in (recorded, later))
    drawn = [draw(TRAINED, rng) for _ in range(settings.paths + 1)]  # the last one for the free views
    conditions = ([Conditions()] * len(before), [drawn[path] for path, _ in of_later])
    images, free = [], []
    with Drawing(world.scene, rng, settings.recolour_chance) as drawing:
        for poses, some, floor, of_each, chance in (
            (before, objects[0], floors[0], conditions[0], settings.changed_recordings),
            (after, objects[1], floors[1], conditions[1], 1.0),
        ):
            images.append(drawing.images(some, poses, of_each, chance))
            bearings = np.array([column_bearings(HFOV + each.hfov_change) for each in of_each])
            free.append(free_distances(floor, poses, bearings))
    pairs = make_pairs(after, of_later, before, of_recorded, world.floor, rng)
    pairs["later"] += len(before)
    return Shard(np.concatenate(images), np.concatenate(free).astype(np.float32), pairs)


def random_view_poses(world: World, floor: FloorMap, rng: np.random.Generator, count: int) -> F64:
    """Returns random collision-free poses (N, 3) of a robot, float64, x, y, yaw, world frame, metres and radians.

    Args:
        world: the scene.
        floor: its map with all bodies.
        rng: random generator.
        count: largest number of poses.
    """
    places = random_free_poses(world.coarse, count, rng, clearance=ROBOT_RADIUS)
    yaws = rng.uniform(-math.pi, math.pi, len(places))
    poses = np.array([(*pose.position[:2], yaw) for pose, yaw in zip(places, yaws, strict=True)])
    return np.asarray(poses[floor.clearance(poses[:, :2]) >= ROBOT_RADIUS])


_PATH_STEP = 0.05
"""Distance between the points of a path, metres."""


def draw_path(floor: FloorMap, planner: PathPlanner, rng: np.random.Generator, settings: DataSettings) -> F64:
    """Returns (K, 3), float64: a smooth path between two random free places, x, y, yaw every 5 cm, world frame, metres and radians.

    Raises:
        SceneError: the scene has no path that is long enough.
    """
    for _ in range(60):
        start, goal = (pose.position[:2] for pose in random_free_poses(floor, 2, rng, clearance=ROBOT_RADIUS + 0.1))
        try:
            corners = planner.path(start, goal)
        except SceneError:
            continue
        drive = smooth_path(corners, planner.places, floor)
        if len(drive) * _PATH_STEP >= settings.length[0]:
            return drive[: int(settings.length[1] / _PATH_STEP)]
    raise SceneError(f"no free path of {settings.length[0]:g} m or more was found; choose another scene")


def smooth_path(corners: F64, places: NDArray[np.bool_], floor: FloorMap) -> F64:
    """Returns (K, 3), float64: a smoothed path every 5 cm along corners (C, 2), x, y, yaw, world frame, metres and radians."""
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.arange(0.0, arc[-1], _PATH_STEP)
    points = np.stack([np.interp(at, arc, corners[:, k]) for k in range(2)], axis=1)
    if len(points) < 3:
        return np.zeros((0, 3))
    rounded = points
    for _ in range(16):
        padded = np.concatenate([rounded[:1], rounded, rounded[-1:]])
        mean = (padded[:-2] + padded[1:-1] + padded[2:]) / 3.0
        keep = floor.look_up(places, mean, outside=False)
        rounded = np.where(keep[:, None], mean, rounded)
        rounded[[0, -1]] = points[[0, -1]]
    ahead = np.gradient(rounded, axis=0)
    return np.column_stack([rounded, np.arctan2(ahead[:, 1], ahead[:, 0])])


def _off_path(
    path: F64, obstacle_rows: NDArray[np.int64], floor: FloorMap, rng: np.random.Generator, count: int
) -> tuple[F64, NDArray[np.int64]]:
    """Returns collision-free poses (M, 3) of a follower near a path, world frame, and the nearest rows (M,) of the path.

    Args:
        path: (K, 3), x, y, yaw, world frame, metres and radians.
        obstacle_rows: rows of the path with obstacles.
        floor: map with all bodies.
        rng: random generator.
        count: largest number of poses.
    """
    rows = rng.integers(0, len(path), count * 3)
    if len(obstacle_rows):
        before = obstacle_rows[rng.integers(0, len(obstacle_rows), len(rows))] - rng.integers(
            4, round(2.0 / _PATH_STEP), len(rows)
        )
        rows = np.where((rng.random(len(rows)) < _CLOSE_SHARE) & (before >= 0), before, rows)
    far, turned = rng.random(len(rows)) < 0.25, rng.random(len(rows)) < 0.25
    offset = np.where(far, rng.uniform(-0.5, 0.5, len(rows)), rng.normal(0.0, 0.12, len(rows)))
    turn = np.where(turned, rng.uniform(-1.1, 1.1, len(rows)), rng.normal(0.0, 0.2, len(rows)))
    x, y, yaw = path[rows].T
    poses = np.column_stack([x - np.sin(yaw) * offset, y + np.cos(yaw) * offset, yaw + turn])
    fits = floor.clearance(poses[:, :2]) >= ROBOT_RADIUS
    return poses[fits][:count], rows[fits][:count]


def make_pairs(
    later: F64,
    of_later: Sequence[tuple[int, int]],
    recorded: F64,
    of_recorded: Sequence[tuple[int, int]],
    floor: FloorMap,
    rng: np.random.Generator,
    *,
    negatives: int = 3,
) -> NDArray[Any]:
    """Returns (P,) of ``PAIR``: each later image with the recorded ones near it, and with some of other places.

    Args:
        later: (M, 3), poses of the later cameras, world frame, metres and radians.
        of_later: path and row on it of each later camera; path -1 = none.
        recorded: (N, 3), poses of the recorded cameras, world frame.
        of_recorded: path and row on it of each recorded camera.
        floor: map for lines of sight.
        rng: random generator.
        negatives: number of images of other places for each later image.
    """
    paths, rows = np.array(of_recorded).T
    pairs: list[tuple[Any, ...]] = []
    for k, (path, row) in enumerate(of_later):
        if path < 0:
            continue
        offset = (rows - row) * _PATH_STEP
        near = np.flatnonzero((paths == path) & (offset > -0.5) & (offset < 1.7))
        others = rng.integers(0, len(recorded), negatives)
        chosen = np.concatenate([near, others])
        pose = relative_pose(later[k], recorded[chosen])
        match = is_match(pose) & has_line_of_sight(floor, later[k], recorded[chosen])
        pairs += [(k, j, *p, m) for j, p, m in zip(chosen.tolist(), pose.tolist(), match.tolist(), strict=True)]
    return np.array(pairs, dtype=PAIR)


def is_match(pose: F64) -> NDArray[np.bool_]:
    """Returns (...,), bool: whether cameras at relative poses (..., 3), metres and radians, are near enough to show the same place."""
    x, y, yaw = np.moveaxis(pose, -1, 0)
    low, high = _MATCH_X
    return np.asarray((x > low) & (x < high) & (np.abs(y) < _MATCH_Y) & (np.abs(yaw) < _MATCH_YAW))


def has_line_of_sight(floor: FloorMap, pose: F64, others: F64) -> NDArray[np.bool_]:
    """Returns (N,), bool: whether the lines from a pose (3,) to others (N, 3), world frame, are free."""
    along = np.linspace(0.0, 1.0, 60)[:, None]
    lines = pose[:2] + (others[:, None, :2] - pose[:2]) * along
    return np.asarray(floor.look_up(floor.free, lines, outside=False).all(axis=1))


def camera_poses(poses: F64, ahead: float) -> F64:
    """Returns (N, 3), float64: planar poses of the cameras of robots at poses (N, 3), same frame, metres and radians.

    Args:
        poses: of the robots.
        ahead: distance of the cameras ahead of the robots' centres, metres.
    """
    x, y, yaw = poses.T
    return np.column_stack([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw])


def path_row(distance: float) -> int:
    """Returns the row of a path, as ``make_pairs`` takes it, at a distance along it, metres."""
    return round(distance / _PATH_STEP)


def with_bodies(scene: SceneSpec, floor: FloorMap, bodies: Sequence[BodySpec]) -> FloorMap:
    """Returns a map with bodies added."""
    if not bodies:
        return floor
    vertices, triangles = body_triangles(replace(scene, bodies=tuple(bodies)))
    return floor.furnished(vertices, triangles, BODY_HEIGHT)


def _random_objects(floor: FloorMap, rng: np.random.Generator, count: int, name: str, keep_off: F64) -> list[BodySpec]:
    """Returns objects at random free places, more than 0.5 m from the points of paths (K, 3)."""
    places = random_free_poses(floor, 3 * count, rng, clearance=0.25) if count else ()
    points = [pose.position for pose in places if np.hypot(*(keep_off[:, :2] - pose.position[:2]).T).min() > 0.5]
    return [item_body(random_object(rng, f"{name}_{k}", *point)) for k, point in enumerate(points[:count])]


def _furniture(floor: FloorMap, rng: np.random.Generator, keep_off: F64) -> list[BodySpec]:
    """Returns furniture at random free places, ``_FURNITURE_DISTANCE`` from the points of paths (K, 3)."""
    bodies = []
    for k, pose in enumerate(random_free_poses(floor, int(rng.integers(_MAX_FURNITURE + 1)), rng, clearance=0.1)):
        body = item_body(random_furniture(rng, f"furniture_{k}", *pose.position))
        corners, _ = body_triangles(SceneSpec("object", Path(), "", (), (), bodies=(body,)))
        distance = np.linalg.norm(corners[:, None, :2] - keep_off[::4, :2], axis=2).min()
        size = np.linalg.norm(np.ptp(corners[:, :2], axis=0))
        # A side may be nearer than its two corners.
        middle = np.linalg.norm(keep_off[:, :2] - pose.position[:2], axis=1).min()
        if distance > _FURNITURE_DISTANCE and middle > _FURNITURE_DISTANCE + size / 3.0:
            bodies.append(body)
    return bodies


def _random_obstacles(path: F64, floor_z: float, rng: np.random.Generator, name: str) -> tuple[list[BodySpec], NDArray[np.int64]]:
    """Returns obstacles on or near a path (K, 3), and their rows on the path."""
    count = int(rng.integers(_MAX_OBSTACLES + 1))
    rows = rng.integers(min(10, len(path) - 1), len(path), count)
    bodies = []
    for k, row in enumerate(rows):
        x, y, yaw = path[row]
        offset = rng.uniform(-_MAX_OFFSET, _MAX_OFFSET)
        bodies.append(
            item_body(random_object(rng, f"{name}_{k}", x - math.sin(yaw) * offset, y + math.cos(yaw) * offset, floor_z))
        )
    return bodies, rows
