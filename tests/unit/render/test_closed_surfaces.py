"""Which triangles belong to closed surfaces, and which near planes touch one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import MeshPart
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.render.culling.closed_surfaces import NearPlaneTest, find_closed_surfaces, transformed_boxes

BOX, BALL, ROLLER = Shape("box", (0.4, 0.6, 1.0)), Shape("sphere", (0.3, 0.0, 0.0)), Shape("cylinder", (0.2, 0.5, 0.0))
NEAR = 0.05
CORNERS = NEAR * np.array([[u, v, 1.0] for u in (-1, 1) for v in (-1, 1)])
"""Corners of the near plane of a picture of 90 degrees that looks along +z."""


def _part(shape: Shape) -> MeshPart:
    (part,) = primitive_mesh(shape).parts
    return part


def _closed_share(*parts: MeshPart, opaque: tuple[bool, ...] = ()) -> list[float]:
    """Returns the share of each part's triangles that belong to closed surfaces."""
    return [float(mask.mean()) for mask in find_closed_surfaces(parts, opaque or (True,) * len(parts)).triangles]


@pytest.mark.parametrize(
    "shape",
    [BOX, BALL, ROLLER, Shape("capsule", (0.1, 0.3, 0.0)), Shape("ellipsoid", (0.1, 0.2, 0.3)), Shape("cone", (0.2, 0.4, 0.0))],
    ids=lambda shape: str(shape.kind),
)
def test_primitives_are_closed_to_the_bit(shape: Shape) -> None:
    part = _part(shape)
    assert _closed_share(part) == [1.0]
    (found,) = find_closed_surfaces([part], [True]).boxes
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    np.testing.assert_allclose(found, np.concatenate([(low + high) / 2, (high - low) / 2]), atol=1e-7)


def test_a_surface_without_one_triangle_is_open_and_its_neighbour_is_closed() -> None:
    box = _part(BOX)
    opened = replace(box, triangles=box.triangles[1:])
    assert _closed_share(opened) == [0.0]
    assert not len(find_closed_surfaces([opened], [True]).boxes)
    moved = replace(box, vertices=box.vertices + np.float32(5.0))
    assert _closed_share(opened, moved) == [0.0, 1.0]


def test_a_closed_surface_may_extend_over_several_parts_unless_one_is_transparent() -> None:
    box = _part(BOX)
    halves = replace(box, triangles=box.triangles[:5]), replace(box, triangles=box.triangles[5:])
    assert _closed_share(*halves) == [1.0, 1.0]
    assert _closed_share(*halves, opaque=(True, False)) == [0.0, 0.0]


def test_an_inside_out_surface_is_not_closed() -> None:
    box = _part(BOX)
    assert _closed_share(replace(box, triangles=box.triangles[:, ::-1], normals=-box.normals)) == [
        0.0
    ]  # a room, seen from within


def test_a_surface_whose_normals_point_inward_is_not_closed() -> None:
    box = _part(BOX)
    assert _closed_share(replace(box, normals=-box.normals)) == [0.0]


def test_one_triangle_that_is_turned_the_other_way_opens_it() -> None:
    box = _part(BOX)
    turned = box.triangles.copy()
    turned[3] = turned[3, ::-1]
    assert _closed_share(replace(box, triangles=turned)) == [0.0]


def test_a_sheet_with_two_sides_encloses_nothing() -> None:
    box = _part(BOX)
    side = box.triangles[:2]
    normals = box.normals.copy()
    both = replace(box, triangles=np.concatenate([side, side[:, ::-1]]), normals=normals)
    assert _closed_share(both) == [0.0]


def test_boxes_move_with_what_is_in_them() -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix_from_quat((0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))[:3, :3], (1.0, 2.0, 3.0)
    np.testing.assert_allclose(
        transformed_boxes(np.array([[1.0, 0.0, 0.0, 0.2, 0.3, 0.5]]), T), [[1.0, 3.0, 3.0, 0.3, 0.2, 0.5]], atol=1e-12
    )


@pytest.fixture(params=[False, True], ids=["NumPy", "loops"])
def inside(request: pytest.FixtureRequest) -> Callable[..., bool]:
    """Returns whether the near plane of a picture touches a box."""
    return partial(_inside, request.param)


def _inside(loops: bool, box: list[float], T_camera_box: NDArray[np.float64] | None = None) -> bool:
    T = np.eye(4) if T_camera_box is None else T_camera_box
    eye = -T[:3, :3].T @ T[:3, 3]
    links, eyes = np.array([1]), np.stack([np.full(3, 99.0), eye])
    return NearPlaneTest(np.array([box]), links, loops=loops).touches(eyes, np.stack([np.eye(4), T]), CORNERS)


def test_the_near_plane_touches_boxes_around_and_across_it(inside: Callable[..., bool]) -> None:
    assert inside([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])  # around the eye
    assert inside([0.0, 0.0, 0.06, 0.2, 0.2, 0.02])  # cut by it
    assert inside([0.045, 0.0, 0.05, 0.001, 0.001, 0.001])  # at its edge
    assert not inside([0.0, 0.0, 0.2, 0.1, 0.1, 0.1])  # ahead
    assert not inside([0.0, 0.0, 0.0, 0.02, 0.02, 0.04])  # nearer than it, around the eye: the housing of a camera
    assert not inside([0.0, 0.0, -0.2, 0.5, 0.5, 0.2])  # behind
    assert not inside([0.2, 0.0, 0.05, 0.1, 0.1, 0.1])  # beside


def test_a_box_is_tested_in_its_own_frame(inside: Callable[..., bool]) -> None:
    T = np.eye(4)
    T[:3, :3] = matrix_from_quat((0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)))[:3, :3]
    T[:3, 3] = (0.0, 0.0, 0.5)
    assert not inside([0.0, 0.0, 0.0, 0.4, 0.4, 0.4], T)
    assert inside([0.0, 0.0, 0.0, 0.46, 0.1, 0.1], T)  # its x axis points at the eye
    assert not inside([0.0, 0.0, 0.0, 0.1, 0.1, 0.46], T)


@pytest.mark.parametrize("loops", [False, True], ids=["NumPy", "loops"])
def test_without_closed_surfaces_the_near_plane_touches_none(loops: bool) -> None:
    nothing = NearPlaneTest(np.zeros((0, 6)), np.zeros(0, dtype=np.int64), loops=loops)
    assert not nothing.touches(np.zeros((1, 3)), np.eye(4)[None], CORNERS)


def test_loops_and_numpy_agree() -> None:
    rng, found = np.random.default_rng(2), []
    for _ in range(300):
        boxes = np.hstack([rng.uniform(-0.3, 0.3, (12, 3)), rng.uniform(0.0, 0.06, (12, 3))])
        links, T = rng.integers(0, 3, 12), np.tile(np.eye(4), (3, 1, 1))
        for k in range(3):
            q = rng.normal(size=4)
            T[k, :3, :3], T[k, :3, 3] = matrix_from_quat(q / np.linalg.norm(q))[:3, :3], rng.uniform(-0.1, 0.1, 3)
        eyes = -np.einsum("lji,lj->li", T[:, :3, :3], T[:, :3, 3])
        ways = [NearPlaneTest(boxes, links, loops=loops).touches(eyes, T, CORNERS) for loops in (False, True)]
        assert ways[0] == ways[1]
        found.append(ways[0])
    assert 0.1 < np.mean(found) < 0.9
