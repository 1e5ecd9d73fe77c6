"""Semantic classes, instances and normals: exact numbers and hand-computed directions, from the same pass as colour and depth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.errors import ConfigError
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource
from gibson_sim.geometry.transforms import quat_from_rpy
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.scene_geometry import MAX_LABEL
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import OUTPUTS, Frame
from render.drawing import AHEAD, BLUE, EYE, RED, box, draw, draw_mesh, facing_quad, loader_of, mesh_visual, scene, state

pytestmark = pytest.mark.egl
ALL = replace(EYE, outputs=OUTPUTS)


def _labelled(name: str, semantic_class: str, visual: VisualSpec) -> VisualSpec:
    return replace(visual, name=name, semantic_class=semantic_class)


def test_labels_are_exact_numbers_without_anything_between() -> None:
    left = _labelled("left", "wall", box((3.0, 0.8, 0.0), RED))
    right = _labelled("right", "chair", box((3.0, -0.8, 0.0), BLUE))
    frame = draw(left, right, camera=ALL)
    # Classes in alphabetical order after "unlabelled": chair 1, wall 2. Instances in the order of the scene: left 1, right 2.
    assert frame.semantic is not None
    assert frame.instance is not None
    assert (frame.semantic.dtype, frame.instance.dtype) == (np.uint16, np.uint16)
    assert set(np.unique(frame.semantic)) == {0, 1, 2}
    assert set(np.unique(frame.instance)) == {0, 1, 2}
    assert (frame.semantic[31, 21], frame.instance[31, 21]) == (2, 1), "+y is left"
    assert (frame.semantic[31, 42], frame.instance[31, 42]) == (1, 2)


def test_labels_cover_exactly_what_has_a_depth() -> None:
    frame = draw(_labelled("a", "thing", box((3.0, 0.3, 0.2), RED)), _labelled("b", "", box((4.0, -0.5, 0.0), BLUE)), camera=ALL)
    assert frame.depth is not None
    np.testing.assert_array_equal(frame.instance != 0, np.isfinite(frame.depth))
    assert frame.normal is not None
    np.testing.assert_array_equal(np.linalg.norm(frame.normal, axis=2) > 0.5, np.isfinite(frame.depth))


def test_visual_without_a_class_is_unlabelled_and_still_an_instance() -> None:
    frame = draw(_labelled("thing", "", box((3.0, 0.0, 0.0))), camera=ALL)
    assert frame.semantic is not None
    assert frame.instance is not None
    assert (frame.semantic[31, 31], frame.instance[31, 31]) == (0, 1)


def test_all_links_of_a_robot_are_one_instance() -> None:
    base = _labelled("a", "robot", box((0.0, 0.0, 0.0), link="robot/base"))
    arm = _labelled("b", "robot", box((0.0, 0.0, 0.0), link="robot/arm"))
    drawn = scene(base, arm, links=("robot/base", "robot/arm"))
    assert drawn.instances == ("", "robot")
    with Renderer(drawn) as renderer:
        frame = renderer.render(state(("robot/base", "robot/arm"), [(4.0, 1.0, 0.0), (4.0, -1.0, 0.0)]), [ALL])[0]
    assert frame.instance is not None
    assert set(np.unique(frame.instance)) == {0, 1}


def test_front_of_a_box_looks_at_the_camera() -> None:
    frame = draw(box((3.0, 0.0, 0.0)), camera=ALL)
    assert frame.normal is not None
    # The optical z axis points away from the camera.
    np.testing.assert_allclose(frame.normal[31, 31], (0.0, 0.0, -1.0), atol=1e-3)
    np.testing.assert_array_equal(frame.normal[0, 0], (0.0, 0.0, 0.0))


def test_turned_box_shows_its_two_sides_in_the_optical_frame() -> None:
    frame = draw(box((3.0, 0.0, 0.0), quat=quat_from_rpy(0.0, 0.0, math.pi / 4)), camera=ALL)
    assert frame.normal is not None
    half = math.sqrt(0.5)
    # The left side looks back and to the left (optical -x), the right one back and to the right.
    np.testing.assert_allclose(frame.normal[31, 28], (-half, 0.0, -half), atol=1e-3)
    np.testing.assert_allclose(frame.normal[31, 35], (half, 0.0, -half), atol=1e-3)


def test_floor_points_up_for_a_camera_on_a_turned_link() -> None:
    """Optical y points down, so up is -y, however the link is turned about the vertical."""
    camera = replace(ALL, link="robot/eye")
    floor = box((0.0, 0.0, -1.0), size=(20.0, 20.0, 0.01))
    with Renderer(scene(floor, links=("robot/eye",))) as renderer:
        frame = renderer.render(state(("robot/eye",), [(0.0, 0.0, 0.0)], [quat_from_rpy(0.0, 0.0, 1.0)]), [camera])[0]
    assert frame.normal is not None
    np.testing.assert_allclose(frame.normal[60, 31], (0.0, -1.0, 0.0), atol=1e-3)


def test_sphere_has_the_normals_of_the_formula_within_a_degree_on_average() -> None:
    camera = replace(ALL, width=256, height=256, fov_y=math.radians(40.0))
    frame = draw_mesh(_fine_sphere((4.0, 0.0, 0.0)), camera=camera)
    assert frame.depth is not None
    assert frame.normal is not None
    rows, columns = np.nonzero(np.isfinite(frame.depth))
    z = frame.depth[rows, columns].astype(np.float64)
    k = camera.intrinsics()
    points = np.column_stack([(columns - k[0, 2]) / k[0, 0] * z, (rows - k[1, 2]) / k[1, 1] * z, z])
    expected = points - (0.0, 0.0, 4.0)  # the centre, optical frame
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    cosine = np.clip((expected * frame.normal[rows, columns]).sum(axis=1), -1.0, 1.0)
    assert np.degrees(np.arccos(cosine)).mean() < 1.0


def _fine_sphere(centre: tuple[float, float, float], rings: int = 90) -> Mesh:
    """Returns a sphere of radius 1 m in facets of 2 degrees, with smooth normals."""
    polar, around = np.meshgrid(np.linspace(0, math.pi, rings + 1), np.linspace(0, 2 * math.pi, 2 * rings + 1), indexing="ij")
    normals = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1).reshape(-1, 3)
    width = 2 * rings + 1
    corner = (np.arange(rings)[:, None] * width + np.arange(width - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + width, corner + 1], 1), np.stack([corner + 1, corner + width, corner + width + 1], 1)]
    )
    f32 = normals.astype(np.float32)
    return Mesh((MeshPart(f32 + np.float32(centre), f32, None, triangles.astype(np.uint32), Material()),))


def test_further_outputs_change_neither_colour_nor_depth_by_a_bit() -> None:
    things = [box((3.0, 0.4, 0.0), RED), box((4.0, -0.6, 0.3), (0.2, 0.9, 0.4, 0.5)), box((6.0, 0.0, 0.0), BLUE, (1.0, 4.0, 4.0))]
    plain, rich = draw(*things), draw(*things, camera=ALL)
    np.testing.assert_array_equal(plain.rgb, rich.rgb)
    np.testing.assert_array_equal(plain.depth, rich.depth)


def test_only_requested_outputs_are_returned() -> None:
    def present(frame: Frame) -> set[str]:
        return {name for name in OUTPUTS if getattr(frame, name) is not None}

    for outputs in (("semantic",), ("normal", "rgb"), ("instance", "depth"), OUTPUTS):
        assert present(draw(box((3.0, 0.0, 0.0)), camera=replace(EYE, outputs=outputs))) == set(outputs)


def test_pane_that_shines_through_has_the_labels_and_normals_of_what_is_behind() -> None:
    wall = _labelled("wall", "wall", box((6.0, 0.0, 0.0), BLUE, (1.0, 8.0, 8.0)))
    pane = _labelled("pane", "window", box((3.0, 0.0, 0.0), (1.0, 1.0, 1.0, 0.3)))
    frame = draw(wall, pane, camera=ALL)
    assert frame.instance is not None
    assert frame.instance[31, 31] == 1


def test_hole_of_a_masked_texture_is_a_hole_in_the_labels() -> None:
    pixels = np.full((2, 2, 4), 255, dtype=np.uint8)
    pixels[0, 0, 3] = 0  # top left
    material = Material(texture=TextureSource("t", pixels), alpha_mode="mask", alpha_cutoff=0.5)
    with Renderer(scene(mesh_visual()), meshes=loader_of(facing_quad(2.0, 1.0, material))) as renderer:
        frame = renderer.render(state(), [ALL])[0]
    assert frame.instance is not None
    assert frame.instance[20, 20] == 0
    assert frame.instance[44, 44] == 1


def test_two_cameras_with_different_outputs_do_not_mix() -> None:
    with Renderer(scene(box((3.0, 0.0, 0.0), RED))) as renderer:
        first = renderer.render(state(), [EYE, ALL, replace(EYE, outputs=("normal",)), EYE])
    np.testing.assert_array_equal(first[0].rgb, first[1].rgb)
    np.testing.assert_array_equal(first[0].rgb, first[3].rgb)
    np.testing.assert_array_equal(first[1].normal, first[2].normal)
    assert first[0].camera.pose == AHEAD


def test_more_labels_than_an_image_can_hold_are_refused() -> None:
    with pytest.raises(ConfigError, match="at most 65535"):
        build_geometry([box((0.0, 0.0, 0.0))], (), primitive_mesh, [(0, MAX_LABEL + 1)])
