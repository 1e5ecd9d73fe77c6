"""Surfaces, their rasterisation, and the visibility of triangles."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim_tools.scanning.posed_images import Intrinsics, ScanError
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing import rasteriser
from gibson_sim_tools.texturing.rasteriser import barycentric, perspective_correct_weights, rasterise, rasterise_2d
from gibson_sim_tools.texturing.surface import face_adjacency, project, split_count, split_long_edges
from gibson_sim_tools.texturing.visibility import depth_consistent, visible_faces

CAMERA = Intrinsics(101, 81, 100.0, 100.0, 50.0, 40.0)
"""Looks along z; a metre at a distance of 2 m has 50 pixels."""
EYE = np.eye(4)


def square(z: float, half: float, x: float = 0.0) -> tuple[list[list[float]], list[list[int]]]:
    """A square across the axis of the camera that faces it."""
    return (
        [[x - half, -half, z], [x + half, -half, z], [x + half, half, z], [x - half, half, z]],
        [[0, 2, 1], [0, 3, 2]],
    )


def surface(*squares: tuple[list[list[float]], list[list[int]]]) -> TriangleMesh:
    vertices = np.concatenate([np.array(v) for v, _ in squares])
    triangles = np.concatenate([np.array(t) + 4 * k for k, (_, t) in enumerate(squares)])
    return TriangleMesh(vertices, triangles)


def test_splitting_is_limited_and_names_the_unit():
    corners = 4000.0 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.7]])
    large = TriangleMesh(corners, np.array([[0, 1, 2], [0, 1, 3]]))
    with pytest.raises(
        ScanError,
        match=r"the mesh is 4000 x 4000 x 2800 m; in mm it would be a room .* about \d+ million triangles, more than 10",
    ):
        split_long_edges(large, 0.25)
    small = TriangleMesh(corners / 1000.0, large.triangles)
    assert split_count(small, 0.25) == pytest.approx(len(split_long_edges(small, 0.25).triangles), rel=0.7)


def test_a_point_is_where_the_pinhole_projects_it():
    uv, z = project(np.array([[0.5, -0.25, 2.0], [0.0, 0.0, -1.0]]), CAMERA, EYE)
    np.testing.assert_allclose(uv[0], (75.0, 27.5))
    assert z.tolist() == [2.0, -1.0] and np.isnan(uv[1]).all()


def test_half_the_size_keeps_the_corners_of_the_image():
    half = Intrinsics(100, 80, 50.0, 50.0, 49.5, 39.5).resized(50, 40)
    assert (half.fx, half.cx, half.cy) == (25.0, 24.5, 19.5)


def test_the_nearer_of_two_squares_is_rasterised_with_its_depth():
    image = rasterise(surface(square(2.0, 0.5), square(1.0, 0.1)), CAMERA, EYE)
    assert image.face[40, 50] >= 2 and image.depth[40, 50] == 1.0
    assert image.face[40, 70] in (0, 1) and image.depth[40, 70] == 2.0
    assert image.face[0, 0] == -1 and np.isinf(image.depth[0, 0])
    # 0.5 m at 2 m: 25 pixels to either side; 0.1 m at 1 m: 10.
    assert (image.face >= 0).sum() == 51 * 51 and (image.face >= 2).sum() == 21 * 21


def test_depth_of_a_slanted_triangle_is_exact_between_its_corners():
    slanted = TriangleMesh(np.array([[-1.0, -1.0, 1.0], [3.0, -1.0, 3.0], [-1.0, 3.0, 1.0]]), np.array([[0, 2, 1]]))
    # On the axis z = 1.5 + x / 2 gives z = 1.5.
    assert abs(rasterise(slanted, CAMERA, EYE).depth[40, 50] - 1.5) < 1e-6


def test_barycentric_coordinates_are_perspective_correct():
    weights = perspective_correct_weights(np.array([[0.5, 0.5, 0.0]]), np.array([[1.0, 3.0, 2.0]]))
    np.testing.assert_allclose(weights, [[0.75, 0.25, 0.0]])


def test_a_degenerate_triangle_covers_nothing_and_does_not_divide_by_zero():
    line = np.array([[[1.0, 1.0], [3.0, 3.0], [5.0, 5.0]]])
    np.testing.assert_allclose(barycentric(line, np.array([[2.0, 2.0]])), [[1 / 3] * 3])
    assert rasterise_2d(np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]]), 4, 4).tolist() == [
        [0, 0, 0, -1], [0, 0, -1, -1], [0, -1, -1, -1], [-1, -1, -1, -1],
    ]  # fmt: skip


def test_visible_triangles_face_the_camera_are_not_occluded_and_lie_within_the_image():
    behind, before, outside = square(2.0, 0.1), square(1.0, 0.1), square(2.0, 0.2, 0.95)
    assert visible_faces(surface(behind, before), CAMERA, EYE).faces.tolist() == [2, 3]
    assert visible_faces(surface(behind, square(1.0, 0.1, 0.3)), CAMERA, EYE).faces.tolist() == [0, 1, 2, 3]
    assert visible_faces(surface(outside), CAMERA, EYE).faces.tolist() == []
    back = surface(behind)
    turned = TriangleMesh(back.vertices, back.triangles[:, ::-1])
    assert visible_faces(turned, CAMERA, EYE).faces.tolist() == []


def test_triangles_are_not_visible_where_measured_depth_differs():
    sheet = surface(square(2.0, 0.1), square(2.0, 0.1, 0.5))
    seen = visible_faces(sheet, CAMERA, EYE)
    assert seen.faces.tolist() == [0, 1, 2, 3]

    def kept(left: float, right: float) -> list[int]:
        depth = np.full((81, 101), np.nan, np.float32)
        depth[:, :60], depth[:, 65:] = left, right
        return depth_consistent(sheet, seen, depth, EYE).faces.tolist()

    # 3 cm, and 1 cm a metre: 5 cm at 2 m.
    assert kept(2.04, 1.96) == [0, 1, 2, 3]
    assert kept(1.5, 2.0) == [2, 3] and kept(2.0, 2.5) == [0, 1]
    assert kept(np.nan, 1.0) == [0, 1]


def test_numba_and_numpy_rasterise_the_same(monkeypatch):
    rng = np.random.default_rng(0)
    many = TriangleMesh(
        rng.uniform((-1.0, -1.0, 1.0), (1.0, 1.0, 3.0), (60, 3)), rng.permuted(np.tile(np.arange(60), (40, 1)), axis=1)[:, :3]
    )
    line = TriangleMesh(np.array([[-0.5, 0.0, 1.0], [0.0, 0.0, 1.0], [0.5, 0.0, 1.0]]), np.array([[0, 1, 2]]))
    corners = rng.uniform(-5.0, 40.0, (30, 3, 2))
    given = [rasterise(many, CAMERA, EYE), rasterise(line, CAMERA, EYE)], rasterise_2d(corners, 30, 20)
    monkeypatch.setattr(rasteriser, "CAN_COMPILE", not rasteriser.CAN_COMPILE)
    other = [rasterise(many, CAMERA, EYE), rasterise(line, CAMERA, EYE)], rasterise_2d(corners, 30, 20)
    for a, b in zip(given[0], other[0], strict=True):
        np.testing.assert_array_equal(a.face, b.face)
        np.testing.assert_array_equal(a.depth, b.depth)
    np.testing.assert_array_equal(given[1], other[1])
    assert (given[0][0].face >= 0).mean() > 0.5 and (given[0][1].face >= 0).sum() == 0


def test_corners_of_visible_triangles_are_pixels():
    seen = visible_faces(surface(square(2.0, 0.1)), CAMERA, EYE)
    np.testing.assert_allclose(seen.corners[0], [[45, 35], [55, 45], [55, 35]])


def test_triangles_with_a_common_edge_are_adjacent():
    adjacency = face_adjacency(np.array([[0, 1, 2], [2, 1, 3], [3, 4, 5]]))
    assert adjacency.faces.tolist() == [[0, 1]] and adjacency.edges.tolist() == [[1, 2]]


def test_long_edges_are_split_without_a_gap():
    whole = surface(square(2.0, 0.5))
    parts = split_long_edges(whole, 0.3)
    corners = parts.corners
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert sides.max() <= 0.3 and abs(area.sum() - 1.0) < 1e-9
    # A closed sheet: 3 F = 2 inner edges + edges of the rim, and the rim is whole.
    inner = len(face_adjacency(parts.triangles).faces)
    rim = 3 * len(parts.triangles) - 2 * inner
    assert rim == 16


def test_colours_of_split_edges_are_means():
    coloured = TriangleMesh(
        *(lambda s: (s.vertices, s.triangles))(surface(square(2.0, 0.5))),
        np.array([[0] * 3, [100] * 3, [200] * 3, [100] * 3], np.uint8),
    )
    parts = split_long_edges(coloured, 1.0)
    middle = np.flatnonzero((parts.vertices == (0.0, 0.0, 2.0)).all(axis=1))
    assert parts.colors is not None and parts.colors[middle].tolist() == [[100] * 3]
