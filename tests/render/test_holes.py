"""The hole image: pixels with nothing drawn, back faces of the world, the sky, and pixels outside the lens."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.filling.holes import BACK_FACE, NOTHING, SURFACE, UNSEEN
from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import LightSpec
from gibson_sim.types import CameraSpec, Frame, Output
from render.drawing import EYE, box, draw_mesh, loader_of, mesh_visual, quad, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

HOLES = replace(EYE, outputs=("rgb", "depth", "normal", "hole"))
FRONT = quad([(2.0, 1.0, 1.0), (2.0, -1.0, 1.0), (2.0, -1.0, -1.0), (2.0, 1.0, -1.0)], Material())
"""2 m ahead, its front to the eye: 32 x 32 pixels."""
BACK_CORNERS = [(2.0, -1.0, 1.0), (2.0, 1.0, 1.0), (2.0, 1.0, -1.0), (2.0, -1.0, -1.0)]
BACK = quad(BACK_CORNERS, Material())


def test_front_is_surface_back_is_back_face_and_the_rest_is_nothing() -> None:
    for mesh, code in ((FRONT, SURFACE), (BACK, BACK_FACE)):
        frame = draw_mesh(mesh, camera=HOLES)
        assert (frame.hole[16:48, 16:48] == code).all()
        assert (frame.hole == NOTHING).sum() == 64 * 64 - 32 * 32
        assert np.allclose(frame.normal[32, 32], (0.0, 0.0, -1.0), atol=1e-3)


def test_hole_output_changes_no_other_output() -> None:
    outputs: tuple[Output, ...] = ("rgb", "depth", "normal", "instance")
    with_holes, without = (
        draw_mesh(BACK, box((4.0, 0.5, 0.0)), camera=replace(EYE, outputs=chosen)) for chosen in ((*outputs, "hole"), outputs)
    )
    assert all(np.array_equal(getattr(with_holes, name), getattr(without, name)) for name in outputs)


def test_back_faces_of_moving_bodies_and_of_leaves_are_no_hole() -> None:
    with Renderer(scene(mesh_visual("a"), links=("a",)), meshes=loader_of(BACK)) as renderer:
        frame = renderer.render(state(("a",), [(0.0, 0.0, 0.0)]), [HOLES])[0]
    assert (frame.hole[16:48, 16:48] == SURFACE).all()
    pixels = np.full((2, 2, 4), 255, dtype=np.uint8)
    pixels[:, 1, 3] = 0
    leaf = quad(BACK_CORNERS, Material(texture=TextureSource("leaf", pixels), alpha_mode="mask"))
    assert set(np.unique(draw_mesh(leaf, camera=HOLES).hole)) == {SURFACE, NOTHING}


def test_sky_is_no_hole(tmp_path: Path) -> None:
    sky = tmp_path / "sky.png"
    cv2.imwrite(str(sky), np.full((16, 32, 3), 200, dtype=np.uint8))
    with Renderer(scene(mesh_visual(), light=LightSpec(backdrop=str(sky))), meshes=loader_of(FRONT)) as renderer:
        frame = renderer.render(state(), [HOLES])[0]
    assert set(np.unique(frame.hole)) == {SURFACE, UNSEEN}
    assert not frame.normal[frame.hole == UNSEEN].any()


def _fisheye() -> CameraSpec:
    return replace(HOLES, projection="fisheye", fov=math.pi)


def test_pixels_outside_a_fisheye_are_no_hole() -> None:
    frame: Frame = draw_mesh(FRONT, camera=_fisheye())
    assert frame.hole[0, 0] == UNSEEN and frame.hole[32, 2] == NOTHING and frame.hole[32, 32] == SURFACE
    assert draw_mesh(BACK, camera=_fisheye()).hole[32, 32] == BACK_FACE
    assert not frame.normal[frame.hole != SURFACE].any()
