"""Tiny scenes made in code, cameras that look at them, and measurements of the images.

The default camera stands at the origin of the world and looks along +x: +y is left, +z is up. Its image is 64 x 64 with a vertical
field of view of 90 degrees, so the focal length is 32 px and the centre is at (31.5, 31.5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Material, Mesh, MeshPart, area_normals
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, camera_pose, quat_from_matrix
from gibson_sim.render.batching.scene_geometry import Loader
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import CameraSpec, Frame, Pose, Quat, Rgba, SceneState, Vec3

RED: Rgba = (1.0, 0.0, 0.0, 1.0)
GREEN: Rgba = (0.0, 1.0, 0.0, 1.0)
BLUE: Rgba = (0.0, 0.0, 1.0, 1.0)
GREY: Rgba = (0.5, 0.5, 0.5, 1.0)
AHEAD = Pose(quat_xyzw=quat_from_matrix(R_LINK_OPTICAL))
"""T_link_optical of a camera at the link's origin that looks along its x axis."""
EYE = CameraSpec("eye", "", AHEAD, 64, 64, math.pi / 2)
DARK = LightSpec(background=(0.0, 0.0, 0.0))


def eye_at(position: Vec3, look_at: Vec3 | None = None, **changes: object) -> CameraSpec:
    """Returns the default camera at ``position``, looking along +x or at a point (not straight up or down)."""
    pose = Pose(position, quat_from_matrix(R_LINK_OPTICAL)) if look_at is None else camera_pose(position, look_at)
    return replace(EYE, pose=pose, **changes)


def box(
    position: Vec3, color: Rgba | None = GREY, size: Vec3 = (1.0, 1.0, 1.0), link: str = "", quat: Quat = (0, 0, 0, 1)
) -> VisualSpec:
    return VisualSpec(f"box at {position}", link, Shape("box", size), Pose(position, quat), color)


def plate(position: Vec3, color: Rgba | None = GREY, side: float = 0.3) -> VisualSpec:
    """Returns a square that faces the default camera, 2 mm thick: its front is 1 mm nearer than ``position``."""
    return box(position, color, (0.002, side, side))


def state(
    links: Sequence[str] = (), positions: Sequence[Vec3] = (), quats: Sequence[Quat] = (), revision: int = 1, stamp_ns: int = 0
) -> SceneState:
    n = len(links)
    turned = quats or [(0.0, 0.0, 0.0, 1.0)] * n
    return SceneState(
        stamp_ns, 0, revision, tuple(links), np.reshape(positions, (n, 3)).astype(float), np.reshape(turned, (n, 4)).astype(float), np.zeros((n, 6))
    )  # fmt: skip


def scene(*visuals: VisualSpec, links: tuple[str, ...] = (), light: LightSpec = DARK) -> DrawnScene:
    return DrawnScene("test", 1, "", links, visuals, (), light)


def draw(*visuals: VisualSpec, camera: CameraSpec = EYE, light: LightSpec = DARK) -> Frame:
    """Returns a camera's frame of static visuals."""
    with Renderer(scene(*visuals, light=light)) as renderer:
        return renderer.render(state(), [camera])[0]


def draw_mesh(mesh: Mesh, *others: VisualSpec, camera: CameraSpec = EYE) -> Frame:
    """Returns a camera's frame of a mesh in the world frame and of primitives."""
    with Renderer(scene(mesh_visual(), *others), meshes=loader_of(mesh)) as renderer:
        return renderer.render(state(), [camera])[0]


def mesh_visual(link: str = "") -> VisualSpec:
    return VisualSpec("mesh", link, Shape("mesh", mesh="/mesh"))


def loader_of(mesh: Mesh) -> Loader:
    """Returns a loader that returns ``mesh`` for every file."""
    return lambda shape: mesh if shape.kind == "mesh" else primitive_mesh(shape)


def quad(corners: Sequence[Vec3], material: Material) -> Mesh:
    """Returns a quad whose texture has its top left, top right, bottom right and bottom left at ``corners``, in this order."""
    vertices = np.array(corners, dtype=np.float32)
    triangles = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.uint32)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    normals = area_normals(vertices, triangles).astype(np.float32)
    return Mesh((MeshPart(vertices, normals, uvs, triangles, material),))


def facing_quad(distance: float, half: float, material: Material) -> Mesh:
    """Returns an upright quad that faces the default camera; +y is left."""
    d, h = distance, half
    return quad([(d, h, h), (d, -h, h), (d, -h, -h), (d, h, -h)], material)


def where(frame: Frame, channel: int) -> NDArray[np.bool_]:
    """Returns where the image is red (0), green (1) or blue (2) and nothing else, (H, W)."""
    assert frame.rgb is not None
    others = np.delete(frame.rgb, channel, axis=2).max(axis=2)
    return (frame.rgb[:, :, channel] > 60) & (others < 30)


def middle(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Returns the mean (column, row), pixels."""
    rows, columns = np.nonzero(mask)
    assert len(rows), "nothing was drawn"
    return float(columns.mean()), float(rows.mean())
