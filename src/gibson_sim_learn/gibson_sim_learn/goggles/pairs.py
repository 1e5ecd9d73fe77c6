"""Pairs of images to learn Goggles from: what another camera sees in another light, and the simulator's own image of the same view.

A *shard* is one folder of memory-mapped arrays of one scene. Everything is drawn from the seed, the scene and the number of the shard: an
interrupted run goes on with the shards that are missing, and equal seeds give equal pairs. Both images of a pair have the same pose and
the same lens: what Goggles change is light, exposure, colours, noise and sharpness, not where things are in the image.
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
from gibson_sim.render.renderer import Renderer
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

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
DRAWN_FROM = ("light", "lens_exposure", "reality")
"""Domains whose light and camera the pairs of training are drawn from, each equally likely."""
LENS = domain_of("reality")
"""Domain that the lens of a view is drawn from: field of view, height, tilt."""
VIEWS = 250
"""Views of a shard."""
_THINGS = 6
"""Random things that are put into a scene, at most."""
_TOGETHER = 16
"""Images that are drawn side by side."""
_RECOLOURED = Rules(
    {"*": ClassRules(hue=(-0.15, 0.15), saturation=(0.5, 1.5), value=(0.6, 1.3), texture=TextureRules(chance=0.15))}
)


@dataclass(frozen=True, slots=True)
class Pairs:
    """The pairs of one shard; arrays may be memory-mapped."""

    clean: U8
    """(N, H, W, 3), RGB: the simulator's own images."""
    seen: U8
    """(N, K, H, W, 3): the same views in other light, by other cameras."""


def shard_name(scene: str, number: int) -> str:
    """Returns the name of a shard's folder."""
    return f"{scene}-{number:03d}"


def is_original(number: int) -> bool:
    """Returns whether a shard of training has the colours of its scene."""
    return number % 2 == 0


def make_pairs(
    folder: Path,
    scenes: Sequence[str],
    count: int,
    seed: int,
    *,
    views: int = VIEWS,
    shots: int = 4,
    domains: Sequence[str] = DRAWN_FROM,
    recoloured: bool = True,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Draws the shards that are missing.

    Args:
        folder: where they are put.
        scenes: names of the scenes.
        count: shards of each scene.
        seed: of all that is drawn.
        views: views of a shard.
        shots: lights and cameras in which each view is seen.
        domains: that these are drawn from.
        recoloured: whether shards that are not ``is_original`` have other colours and textures than their scene.
        size: width and height of an image, pixels.
        progress: called with one line before each shard.
    """
    worlds: dict[str, World] = {}
    todo = [(scene, number) for number in range(count) for scene in scenes if not (folder / shard_name(scene, number)).is_dir()]
    for done, (scene, number) in enumerate(todo, count * len(scenes) - len(todo)):
        progress(f"pairs: {shard_name(scene, number)}, {done} of {count * len(scenes)} shards")
        if scene not in worlds:
            worlds[scene] = World.load(scene)
        save_pairs(
            folder / shard_name(scene, number),
            draw_pairs(
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
        ConfigError: one cannot be read, or there is none.
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
    return Pairs(*load_arrays(folder, ("clean", "seen")))


def save_pairs(folder: Path, pairs: Pairs) -> None:
    """Writes a shard; the folder is there whole or not at all."""
    save_arrays(folder, {name: getattr(pairs, name) for name in ("clean", "seen")})


def draw_pairs(
    world: World,
    seed: int,
    number: int,
    *,
    views: int = VIEWS,
    shots: int = 4,
    domains: Sequence[str] = DRAWN_FROM,
    recolour: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> Pairs:
    """Returns a shard; equal arguments give equal pairs. Arguments as of ``make_pairs``.

    Args:
        world: the scene.
        seed: of all that is drawn.
        number: of the shard.
        views: images of the simulator.
        shots: lights and cameras in which each of them is seen.
        domains: that these are drawn from.
        recolour: whether the scene gets other colours and textures.
        size: width and height of an image, pixels.
    """
    rng = shard_rng(f"goggles {seed} {world.scene.name} {number}")
    poses = _poses(world, rng, views)
    width, height = size
    clean = np.empty((views, height, width, 3), np.uint8)
    seen = np.empty((views, shots, height, width, 3), np.uint8)
    for k, frame in enumerate(_drawn(world, rng, poses, recolour, size)):
        assert frame.rgb is not None
        clean[k] = frame.rgb
        for shot in range(shots):
            conditions = draw(domain_of(domains[int(rng.integers(len(domains)))]), rng)
            seen[k, shot] = as_seen(frame, conditions, rng)
    return Pairs(clean, seen)


def as_seen(frame: Frame, conditions: Conditions, rng: np.random.Generator) -> U8:
    """Returns a frame, with normals and positions, as a camera sees it in a light; ``rng`` is of the noise."""
    assert frame.rgb is not None and frame.normal_world is not None and frame.position is not None
    x, y, z = frame.T_world_camera[:3, 3].tolist()
    linear = relit_linear(frame.rgb, frame.normal_world, frame.position, (x, y, z), conditions.light)
    return photographed(linear, conditions.photometry, rng)


def _poses(world: World, rng: np.random.Generator, count: int) -> F64:
    """Returns (count, 3), poses of cameras: two of three on drives through the scene, the others anywhere; metres and radians."""
    planner = PathPlanner(world.coarse, ROBOT_RADIUS + 0.08)
    drives = np.concatenate([draw_path(world.coarse, planner, rng, DataSettings()) for _ in range(6)])
    on_drives = drives[rng.integers(0, len(drives), 2 * count // 3)]
    on_drives = on_drives + rng.normal(0.0, (0.05, 0.05, 0.3), on_drives.shape)
    free = random_free_poses(world.coarse, count - len(on_drives), rng, clearance=ROBOT_RADIUS)
    anywhere = np.array([(*pose.position[:2], rng.uniform(-math.pi, math.pi)) for pose in free])
    return rng.permutation(camera_poses(np.concatenate([on_drives, anywhere]), CAMERA_AHEAD))


def _drawn(world: World, rng: np.random.Generator, poses: F64, recolour: bool, size: tuple[int, int]) -> Iterator[Frame]:
    """Yields a frame for each pose, in the scene with random things in it."""
    floor_z = world.scene.floor_z
    places = random_free_poses(world.coarse, int(rng.integers(_THINGS + 1)), rng, clearance=0.25)
    things = tuple(item_body(random_object(rng, f"thing_{k}", *pose.position)) for k, pose in enumerate(places))
    bodies = (*world.scene.bodies, *things)
    links = tuple(f"{body.name}/{link}" for body in bodies for link in body.links)
    scene = drawn_scene(replace(world.scene, bodies=bodies), links)
    if recolour:
        scene = randomise(scene, int(rng.integers(2**31)), _RECOLOURED)
    lenses = [draw(LENS, rng) for _ in poses]
    specs = [
        replace(camera_at(x, y, yaw, floor_z, each), width=size[0], height=size[1], outputs=("rgb", "normal_world", "position"))
        for (x, y, yaw), each in zip(poses.tolist(), lenses, strict=True)
    ]
    with Renderer(scene, cache=None if recolour else default_folder()) as renderer:
        state = _standing(scene, bodies)
        for first in range(0, len(specs), _TOGETHER):
            yield from renderer.render(state, specs[first : first + _TOGETHER])


def _standing(scene: DrawnScene, bodies: Sequence[BodySpec]) -> SceneState:
    """Returns the state in which all bodies stand where they are at load."""
    transforms = [(body, link_transforms(body)) for body in bodies]
    poses = [pose_from_matrix(matrices[link]) for body, matrices in transforms for link in body.links]
    return replace(
        SceneState.still(scene.revision, scene.links),
        positions=np.array([pose.position for pose in poses]).reshape(-1, 3),
        quats_xyzw=np.array([pose.quat_xyzw for pose in poses]).reshape(-1, 4),
    )
