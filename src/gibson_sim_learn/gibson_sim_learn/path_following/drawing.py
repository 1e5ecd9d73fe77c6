"""Renders training images of the default camera: in a scene, or a recoloured one, with added bodies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy, quat_from_rpy
from gibson_sim.maps.bodies import link_transforms
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.randomise import ClassRules, Rules, TextureRules, randomise
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, drawn_scene
from gibson_sim.types import CameraSpec, Output, Pose, SceneState
from gibson_sim_learn.path_following.domains import TRAINED, Conditions, draw
from gibson_sim_learn.path_following.photometry import Photometry, photographed, relit_linear

F64 = NDArray[np.float64]
WIDTH, HEIGHT = 96, 64
"""Size of an image, pixels."""
HFOV = math.radians(100.0)
"""Horizontal field of view of the default camera, radians."""
CAMERA_AHEAD, CAMERA_HEIGHT = 0.15, 0.46
"""Position of the default camera: ahead of the robot's centre, and above the floor, metres."""
_TEXTURES = TextureRules(chance=0.3)


def camera_at(x: float, y: float, yaw: float, floor_z: float, conditions: Conditions) -> CameraSpec:
    """Returns the camera at its planar pose x, y, yaw, world frame, metres and radians."""
    height = floor_z + CAMERA_HEIGHT + conditions.height_change
    T_world_camera = matrix_from_pose(pose_from_xyz_rpy((x, y, height), (0.0, conditions.pitch_change, yaw)))
    pose = pose_from_matrix(T_world_camera @ _T_CAMERA_OPTICAL)
    fov_y = 2.0 * math.atan(math.tan((HFOV + conditions.hfov_change) / 2.0) * HEIGHT / WIDTH)
    outputs: tuple[Output, ...] = ("rgb",) if conditions.light.is_unchanged else ("rgb", "normal_world", "position")
    return CameraSpec("camera", "", pose, width=WIDTH, height=HEIGHT, fov_y=fov_y, near=0.02, outputs=outputs)


_T_CAMERA_OPTICAL = matrix_from_pose(Pose(quat_xyzw=quat_from_rpy(-math.pi / 2.0, 0.0, -math.pi / 2.0)))


class Drawing:
    """Renders images in one scene, unchanged or recoloured, with added bodies."""

    def __init__(self, scene: SceneSpec, rng: np.random.Generator, recolour_chance: float) -> None:
        """Prepares a scene.

        Args:
            scene: the scene, without robots.
            rng: of colours, textures and noise.
            recolour_chance: probability that colours and textures of the scene change.
        """
        self._scene, self._rng = scene, rng
        self._base = drawn_scene(scene, _links(scene.bodies))
        self._cache: Path | None = default_folder()
        if rng.random() < recolour_chance:
            self._base = randomise(self._base, int(rng.integers(2**31)), _RECOLOURED)
            self._cache = None
        self._renderer: Renderer | None = None
        self._revision = self._base.revision

    def images(
        self,
        added: Sequence[BodySpec],
        cameras: F64,
        conditions: Sequence[Conditions],
        photometry_chance: float,
        *,
        alike: int = 1,
    ) -> NDArray[np.uint8]:
        """Returns (N, 64, 96, 3), uint8, RGB: images at planar poses (N, 3), each in its conditions, with added bodies.

        Args:
            added: bodies that are added to the scene.
            cameras: (N, 3), x, y, yaw of the cameras, world frame, metres and radians.
            conditions: conditions of each image.
            photometry_chance: probability that exposure and colours of an image differ.
            alike: number of successive images with the same exposure and colours, but for noise.
        """
        if self._renderer is None:
            self._load(self._base)
        bodies = (*self._scene.bodies, *added)
        drawn_bodies = drawn_scene(replace(self._scene, visuals=(), bodies=tuple(added)), ())
        drawn_bodies = randomise(drawn_bodies, int(self._rng.integers(2**31)), _TEXTURED)
        self._load(replace(self._base, visuals=(*self._base.visuals, *drawn_bodies.visuals), links=_links(bodies)))
        state = _standing(bodies, self._revision)
        specs = [
            camera_at(float(x), float(y), float(yaw), self._scene.floor_z, each)
            for (x, y, yaw), each in zip(cameras, conditions, strict=True)
        ]
        out = np.empty((len(specs), HEIGHT, WIDTH, 3), np.uint8)
        assert self._renderer is not None
        for first in range(0, len(specs), _BATCH):
            for k, frame in enumerate(self._renderer.render(state, specs[first : first + _BATCH]), first):
                light = conditions[k].light
                assert frame.rgb is not None
                image: NDArray[np.uint8] | NDArray[np.float32] = frame.rgb
                if not light.is_unchanged:
                    assert frame.normal_world is not None and frame.position is not None
                    x, y, z = frame.T_world_camera[:3, 3].tolist()
                    image = relit_linear(frame.rgb, frame.normal_world, frame.position, (x, y, z), light)
                if k % alike == 0:
                    drawn, changed = draw(TRAINED, self._rng).photometry, self._rng.random() < photometry_chance
                out[k] = photographed(image, drawn if changed else Photometry(), self._rng)
        return out

    def _load(self, scene: DrawnScene) -> None:
        self._revision += 1
        scene = replace(scene, revision=self._revision)
        if self._renderer is None:
            self._renderer = Renderer(scene, meshes=MeshFiles(cache=self._cache))
        else:
            self._renderer.update(scene)

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        renderer, self._renderer = self._renderer, None
        if renderer is not None:
            renderer.close()

    def __enter__(self) -> Drawing:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _links(bodies: Sequence[BodySpec]) -> tuple[str, ...]:
    return tuple(f"{body.name}/{link}" for body in bodies for link in body.links)


def _standing(bodies: Sequence[BodySpec], revision: int) -> SceneState:
    """Returns the state of a scene with all bodies at their poses at load."""
    transforms = [(body, link_transforms(body)) for body in bodies]
    poses = [pose_from_matrix(matrices[link]) for body, matrices in transforms for link in body.links]
    return replace(
        SceneState.still(revision, _links(bodies)),
        positions=np.array([pose.position for pose in poses]).reshape(-1, 3),
        quats_xyzw=np.array([pose.quat_xyzw for pose in poses]).reshape(-1, 4),
    )


_BATCH = 16
"""Images that are rendered together."""
_TEXTURED = Rules({"*": ClassRules(texture=TextureRules(chance=0.4))})
_RECOLOURED = Rules({"*": ClassRules(hue=(-0.5, 0.5), saturation=(0.3, 1.6), value=(0.5, 1.4), texture=_TEXTURES)})
