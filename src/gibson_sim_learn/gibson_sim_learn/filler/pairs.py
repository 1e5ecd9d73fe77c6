"""Training pairs of the filler: images of a scan of a scene and of the scene itself, from the same pose.

A *shard* is one folder of memory-mapped arrays from one scene. All random numbers come from the seed, the scene and the number of the shard: an
interrupted run resumes with the missing shards, and equal seeds, scans and software give equal pairs. Views that show little of the scan, or
very near surfaces, are discarded: the content of their holes cannot be predicted.
"""

from __future__ import annotations

import hashlib
import json
import math
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.digests import digest_of
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.filling.holes import BACK_FACE, is_hole
from gibson_sim.filling.inputs import filled_colour
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy, quat_from_rpy
from gibson_sim.maps.bodies import link_transforms
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.reading import read_file
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from gibson_sim.types import CameraSpec, Frame, Pose, SceneState
from gibson_sim.writing import write_file
from gibson_sim_learn.arrays import load_arrays, save_arrays
from gibson_sim_learn.filler.settings import PairsSettings, options_of
from gibson_sim_learn.path_following.data import BODY_HEIGHT, ROBOT_RADIUS, shard_rng, with_bodies
from gibson_sim_learn.training_folder import SETTINGS, check_settings

F32 = NDArray[np.float32]
I8 = NDArray[np.int8]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]

SIDE = 256
"""Edge of a view, pixels."""
VIEWS = 128
"""Views per shard."""
HEIGHTS = (0.2, 1.5)
"""Smallest and largest height of the camera above the floor, metres."""
FIELDS_OF_VIEW = (math.radians(35.0), math.radians(100.0))
"""Smallest and largest field of view, radians; narrow views resemble crops of larger images."""
_PITCHES = (math.radians(-25.0), math.radians(25.0))
_MAX_HOLE_SHARE = 0.7
"""Share of holes above which a view is discarded."""
_MIN_DEPTH = 0.25
"""Depth, metres; a view with more than a tenth of its pixels nearer than this is discarded."""
_BATCH = 16
"""Images per call of the renderer."""
_MAX_TRIES = 12
"""Maximum number of poses tried per view of a shard."""
_NORMAL_STEPS = 127.0
_DIGEST = "digest.txt"
_MAX_BYTES = 10_000
"""Maximum size of a file with settings or a digest, bytes."""
_NAMED = 5
"""Maximum number of missing shards that a message names."""
_T_CAMERA_OPTICAL = matrix_from_pose(Pose(quat_xyzw=quat_from_rpy(-math.pi / 2.0, 0.0, -math.pi / 2.0)))


@dataclass(frozen=True, slots=True)
class Pairs:
    """The pairs of one shard; arrays may be memory-mapped."""

    drawn: U8
    """(N, H, W, 3), RGB: the rendered scan."""
    filled: U8
    """(N, H, W, 3), RGB: the same with its holes filled by push-pull."""
    depth_mm: U16
    """(N, H, W), depth of the scan, millimetres; 0 = nothing, 65535 = that depth or more."""
    normals: I8
    """(N, H, W, 3), normals of the scan in the optical frame; 127 = 1."""
    hole: U8
    """(N, H, W), holes of the scan, as ``Frame.hole``."""
    truth: U8
    """(N, H, W, 3), RGB: the rendered scene."""


@dataclass(frozen=True, slots=True)
class ScannedScene:
    """A scene, its scan, and the floor map on which cameras are placed."""

    scene: SceneSpec
    """The scene without robots."""
    scan: SceneSpec
    floor: FloorMap
    """Map of the scene's main storey, with cells of 5 cm."""

    @classmethod
    def load(cls, name: str, scan: Path) -> ScannedScene:
        """Returns a scene, by name, with the scan in a folder.

        Raises:
            ConfigError: the scan cannot be loaded.
        """
        scene = replace(load_scene(name), robots=())
        floor = scene_floor_map(scene, robot_height=BODY_HEIGHT)
        try:
            scanned = load_scene(str(scan))
        except GibsonSimError as error:
            raise ConfigError(
                f"{error}; delete the folder {scan}, and run `gibson-sim learn filler pairs` with the same options as before"
            ) from error
        return cls(scene, scanned, with_bodies(scene, floor, scene.bodies))


def shard_name(scene: str, number: int) -> str:
    """Returns the name of a shard's folder."""
    return f"{scene}-{number:03d}"


def make_pairs(
    folder: Path, scene: str, scan: Path, count: int, seed: int, progress: Callable[[str], None] = lambda text: None
) -> None:
    """Renders the missing and damaged shards of a scene.

    Args:
        folder: folder of the shards.
        scene: name of the scene.
        scan: folder of the scan's scene.
        count: number of shards.
        seed: random seed of the views.
        progress: called with one line before each shard.
    """
    todo = []
    for number in range(count):
        progress(f"pairs: {shard_name(scene, number)}, checking")
        if not _is_whole(folder / shard_name(scene, number)):
            todo.append(number)
    if not todo:
        return
    scanned = ScannedScene.load(scene, scan)
    for number in todo:
        progress(f"pairs: {shard_name(scene, number)}, {count} shards of this scene")
        pairs, shard = draw_pairs(scanned, seed, number), folder / shard_name(scene, number)
        shutil.rmtree(shard, ignore_errors=True)
        save_pairs(shard, pairs)


def draw_pairs(scanned: ScannedScene, seed: int, number: int, *, views: int = VIEWS) -> Pairs:
    """Returns a shard; equal arguments give equal pairs.

    Raises:
        ConfigError: too few views see enough of the scan.
    """
    rng = shard_rng(f"filler {seed} {scanned.scene.name} {number}")
    kept: list[tuple[Frame, Frame]] = []
    tried = 0
    while len(kept) < views:
        if tried >= _MAX_TRIES * views:
            raise ConfigError(
                f"scene {scanned.scene.name}: {len(kept)} of {tried} views see enough of its scan, {views} are needed; repeat with a new "
                f"--folder and more --frames (default: {PairsSettings().frames})"
            )
        cameras = _cameras(scanned, rng, max(_BATCH, views - len(kept)))
        kept += [pair for pair in drawn_pairs(scanned, cameras) if _is_useful(*pair)]
        tried += len(cameras)
    return _packed(kept[:views])


def drawn_pairs(scanned: ScannedScene, cameras: Sequence[CameraSpec]) -> Iterator[tuple[Frame, Frame]]:
    """Yields, for each camera, its frames of the scan and of the scene, with colours, depth, normals and holes."""
    scene = drawn_scene(scanned.scene, tuple(f"{body.name}/{link}" for body in scanned.scene.bodies for link in body.links))
    state, still = _standing(scanned.scene, scene.links), SceneState.still()
    with (
        Renderer(scene, meshes=MeshFiles(cache=default_folder())) as clean,
        Renderer(drawn_scene(scanned.scan, ()), meshes=MeshFiles(cache=default_folder())) as scan,
    ):
        for first in range(0, len(cameras), _BATCH):
            some = cameras[first : first + _BATCH]
            yield from zip(scan.render(still, some), clean.render(state, some), strict=True)


def camera_at(pose: Pose, height: float, pitch: float, fov: float, side: int = SIDE) -> CameraSpec:
    """Returns a square camera above a pose on the floor.

    Args:
        pose: T_world_base.
        height: height above the floor, metres.
        pitch: pitch, radians, positive down.
        fov: field of view, radians.
        side: width and height of the image, pixels.
    """
    T_base_camera = matrix_from_pose(pose_from_xyz_rpy((0.0, 0.0, height), (0.0, pitch, 0.0)))
    T = matrix_from_pose(pose) @ T_base_camera @ _T_CAMERA_OPTICAL
    return CameraSpec("camera", "", pose_from_matrix(T), side, side, fov, near=0.02, outputs=("rgb", "depth", "normal", "hole"))


def save_pairs(folder: Path, pairs: Pairs) -> None:
    """Writes a shard and its digest atomically."""
    arrays = {item.name: getattr(pairs, item.name) for item in fields(Pairs)}
    save_arrays(folder, arrays, {_DIGEST: _digest_text(pairs).decode()})


def load_pairs(folder: Path, names: Sequence[str], progress: Callable[[str], None] = lambda text: None) -> list[Pairs]:
    """Returns shards, memory-mapped.

    Args:
        folder: folder of the shards.
        names: names of the shards.
        progress: called with one line before each shard.

    Raises:
        ConfigError: one is missing or damaged.
    """
    check_present(folder, names)
    shards = []
    for name in names:
        progress(f"checking {name}")
        shards.append(load_shard(folder / name))
    return shards


def load_shard(folder: Path) -> Pairs:
    """Returns a shard, memory-mapped, after comparing it with its digest.

    Raises:
        ConfigError: it cannot be read, or differs from its digest.
    """
    remedy = f"run `{command_of(folder.parent)}`, which draws it again"
    pairs = Pairs(*load_arrays(folder, [item.name for item in fields(Pairs)], remedy))
    if _written_digest(folder) != _digest_text(pairs):
        raise ConfigError(f"{folder}: its arrays differ from {_DIGEST}; {remedy}")
    return pairs


def check_present(folder: Path, names: Sequence[str]) -> None:
    """Checks that shards exist.

    Raises:
        ConfigError: some are missing; the message names them and the command that renders them.
    """
    missing = missing_shards(folder, names)
    if missing:
        more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
        raise ConfigError(
            f"{folder}: {len(missing)} of {len(names)} shards are missing: {', '.join(missing[:_NAMED])}{more}; "
            f"run `{command_of(folder)}`"
        )


def missing_shards(folder: Path, names: Sequence[str]) -> list[str]:
    """Returns the names of the shards that a folder lacks."""
    return [name for name in names if not (folder / name).is_dir()]


def data_hash(folder: Path, names: Sequence[str]) -> str:
    """Returns a hash of the digests of shards; ``load_pairs`` compares the digests with the arrays.

    Raises:
        ConfigError: as for ``load_pairs``.
    """
    check_present(folder, names)
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name} ".encode() + _written_digest(folder / name))
    return digest.hexdigest()[:16]


def stored_settings(folder: Path) -> PairsSettings:
    """Returns the settings of the pairs in a folder; the defaults if it has none.

    Raises:
        ConfigError: they cannot be read.
    """
    file = folder / SETTINGS
    if not file.exists():
        return PairsSettings()
    try:
        return PairsSettings(**json.loads(read_file(file, _MAX_BYTES)))
    except (ConfigError, OSError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{file}: cannot be read: {error}; delete it, and run `gibson-sim learn filler pairs` with the same options as before"
        ) from error


def store_settings(folder: Path, settings: PairsSettings) -> None:
    """Stores the settings of the pairs in a folder."""
    write_file(folder / SETTINGS, json.dumps(asdict(settings), indent=1) + "\n")


def check_stored_settings(folder: Path, settings: PairsSettings) -> None:
    """Checks that pairs can be added to those in a folder: only the number of shards may differ.

    Raises:
        ConfigError: another setting differs.
    """
    if (folder / SETTINGS).exists():
        check_settings(folder, asdict(stored_settings(folder)), asdict(settings), ("shards",), what="pairs")


def command_of(folder: Path) -> str:
    """Returns the command that renders the pairs of a folder."""
    return f"gibson-sim learn filler pairs --folder {shlex.quote(str(folder.parent))}{options_of(stored_settings(folder))}"


def depth_of(depth_mm: U16) -> F32:
    """Returns an image of ``Pairs.depth_mm`` in metres, +inf = nothing."""
    return np.where(depth_mm == 0, np.float32(np.inf), depth_mm.astype(np.float32) / np.float32(1000.0))


def normals_of(normals: I8) -> F32:
    """Returns an image of ``Pairs.normals`` as unit vectors, float32."""
    return np.asarray(normals.astype(np.float32) / np.float32(_NORMAL_STEPS))


def _digest_text(pairs: Pairs) -> bytes:
    return f"{digest_of(pairs):016x}\n".encode()


def _written_digest(folder: Path) -> bytes:
    """Returns the digest stored with a shard; empty if it cannot be read."""
    try:
        return read_file(folder / _DIGEST, _MAX_BYTES)
    except (ConfigError, OSError):
        return b""


def _is_whole(folder: Path) -> bool:
    try:
        load_shard(folder)
    except ConfigError:
        return False
    return True


def _cameras(scanned: ScannedScene, rng: np.random.Generator, count: int) -> list[CameraSpec]:
    poses = random_free_poses(scanned.floor, count, rng, clearance=ROBOT_RADIUS)
    return [camera_at(pose, rng.uniform(*HEIGHTS), rng.uniform(*_PITCHES), rng.uniform(*FIELDS_OF_VIEW)) for pose in poses]


def _is_useful(scan: Frame, clean: Frame) -> bool:
    assert scan.hole is not None and clean.depth is not None and clean.hole is not None
    inside = bool((clean.hole == BACK_FACE).mean() < 0.02)  # a camera inside furniture sees back faces
    return inside and float(is_hole(scan.hole).mean()) <= _MAX_HOLE_SHARE and float((clean.depth < _MIN_DEPTH).mean()) <= 0.1


def _packed(frames: Sequence[tuple[Frame, Frame]]) -> Pairs:
    def stacked(name: str, which: int) -> NDArray[Any]:
        return np.stack([getattr(pair[which], name) for pair in frames])

    drawn, hole, depth = stacked("rgb", 0), stacked("hole", 0), stacked("depth", 0)
    mm = np.where(np.isfinite(depth), np.clip(np.rint(1000.0 * depth), 1.0, 65535.0), 0.0)
    return Pairs(
        drawn=drawn.astype(np.uint8),
        filled=np.stack([filled_colour(colour, mask) for colour, mask in zip(drawn, hole, strict=True)]),
        depth_mm=mm.astype(np.uint16),
        normals=np.rint(_NORMAL_STEPS * stacked("normal", 0)).astype(np.int8),
        hole=hole.astype(np.uint8),
        truth=stacked("rgb", 1).astype(np.uint8),
    )


def _standing(scene: SceneSpec, links: tuple[str, ...]) -> SceneState:
    """Returns the scene state at load, which the scanner saw."""
    poses = [
        pose_from_matrix(matrices[link]) for body in scene.bodies for matrices in (link_transforms(body),) for link in body.links
    ]
    return replace(
        SceneState.still(links=links),
        positions=np.array([pose.position for pose in poses]).reshape(-1, 3),
        quats_xyzw=np.array([pose.quat_xyzw for pose in poses]).reshape(-1, 4),
    )
