"""Training pairs of Goggles: a view with random lighting and camera, and the simulator's own image of the same view.

A *shard* is one folder of memory-mapped arrays from one scene. All random numbers come from the seed, the scene and the number of the shard:
an interrupted run resumes with the missing shards, and equal seeds give equal pairs. Both images of a pair have the same pose and
intrinsics: Goggles change lighting, exposure, colours, noise and sharpness, not geometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import pose_from_matrix
from gibson_sim.maps.bodies import link_transforms
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.paths import PathPlanner
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.randomise import ClassRules, Rules, TextureRules, randomise
from gibson_sim.scenes.spec import DrawnScene, drawn_scene
from gibson_sim.tasks.episode import item_body
from gibson_sim.types import Frame, SceneState
from gibson_sim_learn.arrays import load_arrays, save_arrays
from gibson_sim_learn.path_following.clutter import random_object
from gibson_sim_learn.path_following.data import (
    ROBOT_RADIUS,
    DataSettings,
    World,
    camera_poses,
    draw_path,
    shard_rng,
)
from gibson_sim_learn.path_following.domains import Conditions, domain_of, draw
from gibson_sim_learn.path_following.drawing import CAMERA_AHEAD, HEIGHT, WIDTH, camera_at
from gibson_sim_learn.path_following.photometry import photographed, relit_linear
from gibson_sim_learn.remaining import Remaining

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
TRAINING_DOMAINS = ("light", "lens_exposure", "reality")
"""Domains from which lighting and camera of the training pairs are sampled, with equal probability."""
LENS = domain_of("reality")
"""Domain from which the intrinsics and mounting of a view are sampled: field of view, height, tilt."""
VIEWS = 250
"""Views per shard."""
_MAX_OBJECTS = 6
"""Maximum number of random objects that are placed in a scene."""
_BATCH = 16
"""Images per call of the renderer."""
_RECOLOURED = Rules(
    {"*": ClassRules(hue=(-0.15, 0.15), saturation=(0.5, 1.5), value=(0.6, 1.3), texture=TextureRules(chance=0.15))}
)


@dataclass(frozen=True, slots=True)
class Pairs:
    """The pairs of one shard; arrays may be memory-mapped."""

    clean: U8
    """(N, H, W, 3), sRGB: the simulator's own images."""
    seen: U8
    """(N, K, H, W, 3), sRGB: the same views with K random lightings and cameras."""


def shard_name(scene: str, number: int) -> str:
    """Returns the name of a shard's folder."""
    return f"{scene}-{number:03d}"


def is_original(number: int) -> bool:
    """Returns whether a training shard has the original colours of its scene."""
    return number % 2 == 0


def make_pairs(
    folder: Path,
    scenes: Sequence[str],
    count: int,
    seed: int,
    *,
    views: int = VIEWS,
    shots: int = 4,
    domains: Sequence[str] = TRAINING_DOMAINS,
    recoloured: bool = True,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Renders the missing shards.

    Args:
        folder: folder of the shards.
        scenes: names of the scenes.
        count: number of shards per scene.
        seed: random seed.
        views: number of views per shard.
        shots: number of augmentations per view: lighting and camera.
        domains: domains from which lighting and camera are sampled.
        recoloured: whether shards that are not ``is_original`` have randomised colours and textures.
        size: width and height of an image, pixels.
        progress: called with one line before each shard.
    """
    worlds: dict[str, World] = {}
    todo = [(scene, number) for number in range(count) for scene in scenes if not (folder / shard_name(scene, number)).is_dir()]
    total = count * len(scenes)
    remaining = Remaining(total - len(todo))
    for done, (scene, number) in enumerate(todo, total - len(todo)):
        progress(f"pairs: {shard_name(scene, number)}, {done} of {total} shards{remaining.text(done, total)}")
        if scene not in worlds:
            worlds[scene] = World.load(scene)
        save_pairs(
            folder / shard_name(scene, number),
            render_pairs(
                worlds[scene],
                seed,
                number,
                views=views,
                shots=shots,
                domains=domains,
                recolour=recoloured and not is_original(number),
                size=size,
            ),
        )


def load_pairs(folder: Path) -> list[Pairs]:
    """Returns the shards of a folder, in the order of their names, memory-mapped.

    Raises:
        ConfigError: a shard cannot be read, or there is none.
    """
    shards = sorted(path for path in folder.iterdir() if not path.name.startswith(".")) if folder.is_dir() else []
    if not shards:
        raise ConfigError(f"{folder}: holds no pairs; run gibson-sim learn goggles")
    return [load_shard(shard) for shard in shards]


def load_shard(folder: Path) -> Pairs:
    """Returns a shard, memory-mapped.

    Raises:
        ConfigError: it cannot be read.
    """
    return Pairs(*load_arrays(folder, ("clean", "seen"), "delete it, and run `gibson-sim learn goggles` again"))


def save_pairs(folder: Path, pairs: Pairs) -> None:
    """Writes a shard atomically."""
    save_arrays(folder, {name: getattr(pairs, name) for name in ("clean", "seen")})


def render_pairs(
    world: World,
    seed: int,
    number: int,
    *,
    views: int = VIEWS,
    shots: int = 4,
    domains: Sequence[str] = TRAINING_DOMAINS,
    recolour: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> Pairs:
    """Returns a shard; equal arguments give equal pairs.

    Args:
        world: scene and its floor map.
        seed: random seed.
        number: number of the shard.
        views: number of views.
        shots: number of augmentations per view: lighting and camera.
        domains: domains from which lighting and camera are sampled.
        recolour: whether colours and textures of the scene are randomised.
        size: width and height of an image, pixels.
    """
    rng = shard_rng(f"goggles {seed} {world.scene.name} {number}")
    poses = _poses(world, rng, views)
    width, height = size
    clean = np.empty((views, height, width, 3), np.uint8)
    seen = np.empty((views, shots, height, width, 3), np.uint8)
    for k, frame in enumerate(_rendered(world, rng, poses, recolour, size)):
        assert frame.rgb is not None
        clean[k] = frame.rgb
        for shot in range(shots):
            conditions = draw(domain_of(domains[int(rng.integers(len(domains)))]), rng)
            seen[k, shot] = simulate_camera(frame, conditions, rng)
    return Pairs(clean, seen)


def simulate_camera(frame: Frame, conditions: Conditions, rng: np.random.Generator) -> U8:
    """Returns a frame, which has ``normal_world`` and ``position``, under other lighting and by another camera: (H, W, 3), sRGB.

    Args:
        frame: the simulator's image.
        conditions: lighting and photometry of the camera.
        rng: for the image noise.
    """
    assert frame.rgb is not None and frame.normal_world is not None and frame.position is not None
    x, y, z = frame.T_world_camera[:3, 3].tolist()
    linear = relit_linear(frame.rgb, frame.normal_world, frame.position, (x, y, z), conditions.light)
    return photographed(linear, conditions.photometry, rng)


def _poses(world: World, rng: np.random.Generator, count: int) -> F64:
    """Returns camera poses (count, 3), x, y, yaw in metres and radians: two thirds on paths through the scene, the rest at random free poses."""
    planner = PathPlanner(world.coarse, ROBOT_RADIUS + 0.08)
    paths = np.concatenate([draw_path(world.coarse, planner, rng, DataSettings()) for _ in range(6)])
    on_paths = paths[rng.integers(0, len(paths), 2 * count // 3)]
    on_paths = on_paths + rng.normal(0.0, (0.05, 0.05, 0.3), on_paths.shape)
    free = random_free_poses(world.coarse, count - len(on_paths), rng, clearance=ROBOT_RADIUS)
    anywhere = np.array([(*pose.position[:2], rng.uniform(-math.pi, math.pi)) for pose in free])
    return rng.permutation(camera_poses(np.concatenate([on_paths, anywhere]), CAMERA_AHEAD))


def _rendered(world: World, rng: np.random.Generator, poses: F64, recolour: bool, size: tuple[int, int]) -> Iterator[Frame]:
    """Yields a frame for each pose, in the scene with random objects."""
    floor_z = world.scene.floor_z
    object_poses = random_free_poses(world.coarse, int(rng.integers(_MAX_OBJECTS + 1)), rng, clearance=0.25)
    objects = tuple(item_body(random_object(rng, f"thing_{k}", *pose.position)) for k, pose in enumerate(object_poses))
    bodies = (*world.scene.bodies, *objects)
    links = tuple(f"{body.name}/{link}" for body in bodies for link in body.links)
    scene = drawn_scene(replace(world.scene, bodies=bodies), links)
    if recolour:
        scene = randomise(scene, int(rng.integers(2**31)), _RECOLOURED)
    lenses = [draw(LENS, rng) for _ in poses]
    specs = [
        replace(camera_at(x, y, yaw, floor_z, each), width=size[0], height=size[1], outputs=("rgb", "normal_world", "position"))
        for (x, y, yaw), each in zip(poses.tolist(), lenses, strict=True)
    ]
    with Renderer(scene, meshes=MeshFiles(cache=None if recolour else default_folder())) as renderer:
        state = _standing(scene, bodies)
        for first in range(0, len(specs), _BATCH):
            yield from renderer.render(state, specs[first : first + _BATCH])


def _standing(scene: DrawnScene, bodies: Sequence[BodySpec]) -> SceneState:
    """Returns the scene state at load."""
    transforms = [(body, link_transforms(body)) for body in bodies]
    poses = [pose_from_matrix(matrices[link]) for body, matrices in transforms for link in body.links]
    return replace(
        SceneState.still(scene.revision, scene.links),
        positions=np.array([pose.position for pose in poses]).reshape(-1, 3),
        quats_xyzw=np.array([pose.quat_xyzw for pose in poses]).reshape(-1, 4),
    )
