"""Frustum culling changes no pixel."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.formats.mesh import Material, Mesh, MeshPart
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.render.renderer import Renderer, RenderOptions
from render.drawing import eye_at, loader_of, mesh_visual, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

EYES = [
    eye_at((0.0, 0.0, 1.0), look_at=(3.0, 0.5, 0.0), width=80, height=60),
    eye_at((-4.5, -4.5, 2.0), look_at=(0.0, 0.0, 0.0), width=80, height=60),
    eye_at((1.0, 2.0, 0.3), look_at=(-5.0, 1.0, 0.2), width=80, height=60),
    eye_at((2.0, -1.0, 4.0), look_at=(2.1, -1.0, 0.0), width=80, height=60),
    eye_at((0.3, 0.1, -1.0), look_at=(1.0, 1.0, 0.5), width=80, height=60),
    eye_at((8.0, 0.5, 3.0), look_at=(0.0, 0.0, 0.0), width=80, height=60),
]


def floor(half: float = 5.0, cells: int = 100) -> Mesh:
    """Returns a level grid of squares about the origin."""
    axis = np.linspace(-half, half, cells + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.float32)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    beyond = corner + cells + 1
    triangles = np.concatenate([np.stack([corner, beyond, beyond + 1], 1), np.stack([corner, beyond + 1, corner + 1], 1)])
    normals = np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (len(vertices), 1))
    return Mesh((MeshPart(vertices, normals, None, triangles.astype(np.uint32), Material()),))


@pytest.mark.parametrize("number", range(len(EYES)))
def test_leaving_out_what_is_outside_the_image_changes_no_byte(number):
    frames = []
    for cull in (True, False):
        with Renderer(scene(mesh_visual()), meshes=loader_of(floor()), options=RenderOptions(cull=cull)) as renderer:
            assert renderer.info["clusters"] > 30
            frames.append(renderer.render(state(), [EYES[number]])[0])
    culled, whole = frames
    assert np.isfinite(whole.depth).any()
    np.testing.assert_array_equal(culled.rgb, whole.rgb)
    np.testing.assert_array_equal(culled.depth, whole.depth)


@pytest.mark.parametrize("number", range(len(EYES)))
def test_a_floor_of_many_triangles_has_no_hole_and_no_fringe(number):
    camera = EYES[number]
    with Renderer(scene(mesh_visual()), meshes=loader_of(floor())) as renderer:
        depth = renderer.render(state(), [camera])[0].depth
    # The ray of each pixel meets the plane z = 0 at this depth, and at (x, y).
    T_world_camera = matrix_from_pose(camera.pose)
    k = camera.intrinsics()
    v, u = np.mgrid[:60, :80]
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(u.shape)], axis=-1) @ T_world_camera[:3, :3].T
    expected = -T_world_camera[2, 3] / rays[..., 2]
    reach = np.abs(T_world_camera[:2, 3] + expected[..., None] * rays[..., :2]).max(axis=-1)
    inside = (expected > camera.near) & (reach < 4.9)
    outside = (expected < 0.0) | (reach > 5.2)
    assert inside.sum() > 500
    np.testing.assert_allclose(depth[inside], expected[inside], atol=3e-3)
    assert np.isposinf(depth[outside]).all()


def test_a_moving_mesh_is_not_left_out_where_it_went():
    # The grid's own frame is far behind the camera; the state brings it below.
    with Renderer(scene(mesh_visual("robot/base"), links=("robot/base",)), meshes=loader_of(floor(1.0, 30))) as renderer:
        gone, here = (
            renderer.render(state(["robot/base"], [p]), [eye_at((0.0, 0.0, 1.0), look_at=(1.0, 0.0, 0.0))])[0]
            for p in ((-50.0, 0.0, 0.0), (1.0, 0.0, 0.0))
        )
    assert np.isposinf(gone.depth).all()
    # The eye is sqrt(2) m from the point it looks at.
    assert here.depth[31:33, 31:33].mean() == pytest.approx(2**0.5, abs=1e-3)
