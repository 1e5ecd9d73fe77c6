"""Exposure compensation, outlier views, vertex colours and pose refinement, against known answers."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from gibson_sim_tools.texturing import linear_solvers
from gibson_sim_tools.texturing.exposure import estimate_exposures, identity_exposures
from gibson_sim_tools.texturing.linear_solvers import conjugate_gradients, relax_membrane
from gibson_sim_tools.texturing.outliers import inlier_mask, propagate_to_neighbours
from gibson_sim_tools.texturing.pose_refinement import refine_poses
from gibson_sim_tools.texturing.quality import LINEAR_FROM_SRGB8, Views, concatenate_views, face_views, sample_bilinear
from gibson_sim_tools.texturing.surface import Adjacency, project
from gibson_sim_tools.texturing.texture import interpolate_vertex_colors
from gibson_sim_tools.texturing.visibility import VisibleFaces, visible_faces
from support.painted_wall import CAMERA, moved, painted_wall, photographed, row_of_cameras


def views(face, photograph, light, radius=None) -> Views:
    count = len(face)
    radius = np.zeros(count) if radius is None else radius
    return Views(
        np.asarray(face, np.int32), np.asarray(photograph, np.int32), np.ones(count, np.float32),
        np.asarray(light, np.float32), np.asarray(radius, np.float32),
    )  # fmt: skip


def test_bilinear_sampling_replicates_the_border():
    image = np.array([[0.0, 1.0], [2.0, 3.0]], np.float32)
    np.testing.assert_allclose(
        sample_bilinear(image, np.array([[0.5, 0.5], [1.0, 0.0], [9.0, 9.0]], np.float32)), [1.5, 1.0, 3.0]
    )
    assert sample_bilinear(image, np.zeros((0, 2), np.float32)).shape == (0,)


def test_quality_is_area_times_gradient_and_color_is_mean_linear_light():
    ramp = np.tile(np.arange(0, 200, 4, dtype=np.uint8), (50, 1))
    rgb = np.repeat(ramp[:, :, None], 3, axis=2)
    seen = VisibleFaces(np.array([3]), np.array([[[10.0, 10.0], [30.0, 10.0], [10.0, 30.0]]]))
    found = face_views(7, seen, rgb)
    # 200 square pixels, 4 steps per pixel, and the offset of 2.
    assert abs(found.quality[0] - 200 * (4 + 2)) < 1.0
    assert (found.face[0], found.photograph[0]) == (3, 7)
    assert abs(found.linear_rgb[0, 0] - LINEAR_FROM_SRGB8[int(4 * 50 / 3)]) < 0.01


def test_gains_and_vignetting_are_estimated_despite_outlier_views():
    rng = np.random.default_rng(3)
    gains = rng.normal(0.0, 0.3, (12, 3))
    gains -= gains.mean(axis=0)
    face, photograph = (a.ravel() for a in np.meshgrid(np.arange(400), np.arange(12), indexing="ij"))
    radius = rng.random(len(face))
    surface = np.exp(rng.normal(-1.8, 0.3, (400, 3)))
    light = surface[face] * np.exp(gains[photograph] - 0.4 * radius[:, None] ** 2)
    elsewhere = rng.random(len(face)) < 0.1
    light[elsewhere] = 0.05
    found = estimate_exposures(views(face, photograph, light, radius), 12, rng)
    assert np.abs(found.gains - gains).max() < 0.02
    assert np.abs(found.vignette.sum(axis=0) + 0.4).max() < 0.03
    rows = np.flatnonzero(~elsewhere)
    np.testing.assert_allclose(
        light[rows] * found.factors(photograph[rows], radius[rows].astype(np.float32)), surface[face[rows]], rtol=0.05
    )


def test_a_photograph_that_shares_nothing_keeps_its_exposure():
    found = estimate_exposures(views([0, 0, 1], [0, 1, 2], [[0.2] * 3, [0.4] * 3, [0.3] * 3]), 3, np.random.default_rng(0))
    assert found.gains[2].tolist() == [0.0] * 3 and found.gains[0, 0] < found.gains[1, 0]


def test_a_person_in_one_of_ten_photographs_is_an_outlier_and_nothing_else_is():
    rng = np.random.default_rng(0)
    face, photograph = (a.ravel() for a in np.meshgrid(np.arange(300), np.arange(10), indexing="ij"))
    colors = rng.random((300, 1, 3)) * 0.5 + 0.2 + rng.normal(0.0, 0.015, (300, 10, 3))
    colors = colors.reshape(-1, 3)
    ghost = photograph == 4
    colors[ghost] += 0.25
    kept = inlier_mask(views(face, photograph, colors), colors.astype(np.float32))
    assert not kept[ghost].any() and kept[~ghost].mean() > 0.99


def test_neighbours_in_the_same_photograph_decide_triangles_with_few_views():
    # A strip of ten triangles, each beside the next. Three photographs show the first six, two the others; a person is in the second one.
    adjacency = Adjacency(np.stack([np.arange(9), np.arange(1, 10)], axis=1), np.zeros((9, 2), np.int64))
    face = np.concatenate([np.repeat(np.arange(6), 3), np.repeat(np.arange(6, 10), 2)])
    photograph = np.concatenate([np.tile([0, 1, 2], 6), np.tile([0, 1], 4)])
    colors = np.where((photograph == 1)[:, None], 0.8, 0.2).astype(np.float32) * np.ones((1, 3), np.float32)
    # In the third photograph, one triangle alone has another colour.
    colors[5] = 0.25
    table = views(face, photograph, colors)
    first = inlier_mask(table, colors)
    assert first[photograph == 1].tolist() == [False] * 6 + [True] * 4
    kept = propagate_to_neighbours(table, first, adjacency)
    assert not kept[photograph == 1].any() and kept[photograph != 1].all()
    # The only view of a triangle is kept.
    alone = table.subset(photograph == 1)
    assert propagate_to_neighbours(alone, np.zeros(10, bool), adjacency).all()


def test_two_views_that_differ_are_both_kept():
    colors = np.array([[0.1] * 3, [0.9] * 3], np.float32)
    assert inlier_mask(views([0, 0], [0, 1], colors), colors).all()


def test_conjugate_gradients_solve_all_columns():
    matrix = sparse.csr_matrix(np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 5.0]]))
    wanted = np.array([[1.0, -2.0], [0.5, 4.0], [3.0, 0.0]])
    np.testing.assert_allclose(conjugate_gradients(matrix, matrix @ wanted, tolerance=1e-10), wanted, atol=1e-8)


def test_a_membrane_between_two_boundaries_is_linear_compiled_or_not(monkeypatch):
    # Nine pixels in a row between 0 and 1; the last neighbour of each is none.
    row = np.arange(9)
    neighbours = np.stack(
        [np.where(row > 0, row - 1, 9), np.where(row < 8, row + 1, 10), row * 0 - 1, row * 0 - 1], axis=1
    ).astype(np.int32)
    given = np.zeros((11, 2), np.float32)
    given[10] = 1.0, -0.5
    found = given.copy()
    relax_membrane(found, neighbours, row % 2 == 0, 9)
    np.testing.assert_allclose(found[:9, 0], np.arange(1, 10) / 10, atol=0.01)
    assert found[9:].tolist() == given[9:].tolist()
    monkeypatch.setattr(linear_solvers, "CAN_COMPILE", not linear_solvers.CAN_COMPILE)
    other = given.copy()
    relax_membrane(other, neighbours, row % 2 == 0, 9)
    np.testing.assert_array_equal(other, found)


def test_unknown_vertex_colors_are_harmonic_between_known_ones():
    # Three triangles side by side: the vertices 2 and 3 lie between 0, 1 and 4.
    triangles = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4]])
    known = np.array([True, True, False, False, True])
    colors = np.array([[0.2] * 3, [0.2] * 3, [0] * 3, [0] * 3, [0.8] * 3], np.float32)
    # x2 = (0.2 + 0.2 + x3 + 0.8) / 4 and x3 = (0.2 + x2 + 0.8) / 3.
    found = interpolate_vertex_colors(triangles, known, colors, None)
    np.testing.assert_allclose(found[[2, 3], 0], [4.6 / 11, 5.2 / 11], atol=1e-3)
    # With colours of the mesh their shape is kept: all known ones are 0.1 brighter than the mesh.
    own = np.array([[0.1] * 3, [0.1] * 3, [0.3] * 3, [0.5] * 3, [0.7] * 3], np.float32)
    np.testing.assert_allclose(interpolate_vertex_colors(triangles, known, colors, own)[[2, 3], 0], [0.4, 0.6], atol=1e-3)


def test_pose_errors_of_one_or_two_pixels_are_corrected(tmp_path):
    rng = np.random.default_rng(1)
    wall, true = painted_wall(), row_of_cameras(6, rng)
    offsets = np.tile(np.eye(4), (6, 1, 1))
    offsets[:, :3, :3] = Rotation.from_rotvec(np.radians(rng.normal(0.0, 0.4, (6, 3)))).as_matrix()
    given = moved(photographed(tmp_path, wall, true), offsets)
    table = concatenate_views(
        [face_views(k, visible_faces(wall.surface, CAMERA, T), given.image(k)) for k, T in enumerate(given.poses)]
    )
    found = refine_poses(wall.surface, given, table, identity_exposures(6), max_translation_m=0.1, max_rotation_deg=2.0)

    def error_px(poses) -> float:
        # All poses together may drift along the wall: their common motion is no error.
        middle = np.zeros((1, 3))
        off = np.array(
            [project(middle, CAMERA, a)[0][0] - project(middle, CAMERA, b)[0][0] for a, b in zip(poses, true, strict=True)]
        )
        return float(np.linalg.norm(off - off.mean(axis=0), axis=1).mean())

    assert error_px(given.poses) > 0.8 and error_px(found.poses) < 0.15
    assert found.rejected_count == 0


def test_depth_aligns_a_wall_without_texture(tmp_path):
    wall, true = painted_wall(20, 15), row_of_cameras(3, np.random.default_rng(1))
    wall = replace(wall, paint=np.full_like(wall.paint, 0.5))
    taken = photographed(tmp_path, wall, true)
    for item in taken.items:
        cv2.imwrite(str(item.file.with_suffix(".depth.png")), wall.depth(item.T_world_camera, 1000.0))
    taken = replace(taken, items=tuple(replace(item, depth=item.file.with_suffix(".depth.png")) for item in taken.items))
    offsets = np.tile(np.eye(4), (3, 1, 1))
    # 12 mm nearer to the wall, and half a degree about the vertical.
    offsets[0, 2, 3] = 0.012
    offsets[1, :3, :3] = Rotation.from_rotvec((0.0, np.radians(0.5), 0.0)).as_matrix()
    given = moved(taken, offsets)
    table = concatenate_views(
        [face_views(k, visible_faces(wall.surface, CAMERA, T), given.image(k)) for k, T in enumerate(given.poses)]
    )
    found = refine_poses(wall.surface, given, table, identity_exposures(3), max_translation_m=0.1, max_rotation_deg=2.0)
    assert np.abs(found.poses[:, 2, 3] - true[:, 2, 3]).max() < 0.002
    assert np.degrees(np.arccos((found.poses[:, :3, 2] * true[:, :3, 2]).sum(axis=1))).max() < 0.2


def test_corrections_beyond_the_limits_are_rejected(tmp_path):
    wall, poses = painted_wall(), row_of_cameras(2, np.random.default_rng(1))
    offsets = np.tile(np.eye(4), (2, 1, 1))
    offsets[1, 0, 3] = 0.02
    given = moved(photographed(tmp_path, wall, poses), offsets)
    table = concatenate_views(
        [face_views(k, visible_faces(wall.surface, CAMERA, T), given.image(k)) for k, T in enumerate(given.poses)]
    )
    held = refine_poses(wall.surface, given, table, identity_exposures(2), max_translation_m=0.0, max_rotation_deg=0.0)
    assert held.rejected_count == 2
    np.testing.assert_array_equal(held.poses, given.poses)
