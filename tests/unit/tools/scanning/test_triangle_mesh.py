"""Meshes with vertex colours, as scanners produce them."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim_tools.importing.checks.gravity import guess_up
from gibson_sim_tools.scanning.fusion import open3d
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.triangle_mesh import (
    TriangleMesh,
    decimated,
    level_transform,
    transformed,
    weld_vertices,
    without_small_components,
    write_ply,
)
from support.scans import noisy_room


def boards(*heights_and_sizes: tuple[float, float]) -> TriangleMesh:
    """Level squares that look up, each with its height and edge."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    vertices = np.concatenate([square * (size, size, 1) + (0, 0, height) for height, size in heights_and_sizes]).astype(
        np.float32
    )
    triangles = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(len(heights_and_sizes))]).astype(np.int32)
    colors = np.arange(3 * len(vertices), dtype=np.uint8).reshape(-1, 3)
    return TriangleMesh(vertices, triangles, colors)


def test_small_components_are_removed_with_their_vertices():
    mesh = without_small_components(boards((0, 0.1), (1, 2.0)), 0.5)
    assert mesh.area == pytest.approx(4.0)
    assert mesh.vertices.shape == (4, 3) and (mesh.vertices[:, 2] == 1).all()
    assert mesh.colors[0].tolist() == [12, 13, 14]


def test_close_vertices_are_welded_and_slivers_removed():
    flat = boards((0, 1.0))
    vertices = np.concatenate([flat.vertices, flat.vertices[:1] + np.float32(1e-5)])
    triangles = np.concatenate([flat.triangles, [[0, 4, 1]]]).astype(np.int32)
    mesh = weld_vertices(TriangleMesh(vertices, triangles, np.zeros((5, 3), np.uint8)), 1e-3)
    assert (len(mesh.vertices), len(mesh.triangles)) == (4, 2)
    assert mesh.area == pytest.approx(1.0)


def test_a_decimated_mesh_keeps_its_shape_and_vertex_colors():
    y, x = np.mgrid[0:41, 0:41].astype(np.float32) / 10
    vertices = np.column_stack([x.ravel(), y.ravel(), np.where(x > 2, x - 2, 0).ravel()]).astype(np.float32)
    first = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    triangles = np.concatenate([first[:, None] + corners for corners in ((0, 1, 42), (0, 42, 41))]).astype(np.int32)
    colors = np.column_stack([10 * x.ravel(), 10 * y.ravel(), np.zeros(x.size)]).astype(np.uint8)
    full = TriangleMesh(vertices, triangles, colors)
    less = decimated(full, 400)
    assert 300 < len(less.triangles) <= 400
    assert less.area == pytest.approx(full.area, rel=1e-4)
    assert np.abs(less.colors[:, :2] - 10 * less.vertices[:, :2]).max() < 1.01
    assert len(np.unique(less.triangles)) == len(less.vertices)


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (-1.8, 0.1, 0.3), (3.0, 0.0, 0.0)])
def test_a_scan_in_the_frame_of_a_camera_is_levelled(rpy):
    """A floor and a table at 0.7 m, in the frame of a camera that was held nearly upright."""
    level = boards((0.0, 4.0), (0.7, 1.0))
    T_scan_level = matrix_from_pose(pose_from_xyz_rpy((0.3, -1.0, 2.0), rpy))
    upright = np.eye(4)
    upright[:3, :3] = np.array([[0.0, 0.2, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.2]])
    T = level_transform(transformed(level, T_scan_level), (T_scan_level @ upright)[None])
    found = transformed(transformed(level, T_scan_level), T)
    assert sorted(set(np.round(found.vertices[:, 2], 4))) == pytest.approx([0.0, 0.7], abs=1e-4)
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) and np.linalg.det(T) == pytest.approx(1.0)
    assert np.allclose(invert(T) @ T, np.eye(4))


def test_without_a_level_surface_up_is_not_guessed():
    wall = transformed(boards((0.0, 1.0)), matrix_from_pose(pose_from_xyz_rpy(rpy=(np.pi / 2, 0, 0))))
    with pytest.raises(ScanError, match="leave out --level"):
        level_transform(wall, np.eye(4)[None] @ np.diag([1.0, -1.0, 1.0, 1.0])[[0, 2, 1, 3]])


def test_a_levelled_scan_is_level_by_the_measure_of_check():
    """A bumpy floor with a slanted ramp, which must not pull."""
    vertices, triangles = noisy_room(edge=0.1)
    ramp = boards((0.0, 1.5)).vertices.astype(np.float64) @ matrix_from_pose(pose_from_xyz_rpy(rpy=(0.2, 0.0, 0.0)))[:3, :3].T
    corners = np.concatenate([vertices, ramp + np.array([2.0, 2.0, 0.1])])
    faces = np.concatenate([triangles, len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])])
    mesh = TriangleMesh(corners.astype(np.float64), faces.astype(np.int64), np.zeros((len(corners), 3), np.uint8))
    T_scan_level = matrix_from_pose(pose_from_xyz_rpy((0.0, 0.0, 0.0), (-1.9, 0.3, 0.0)))
    upright = np.eye(4)
    upright[:3, :3] = np.array([[0.0, 0.4, 0.9], [-1.0, 0.0, 0.0], [0.0, -0.9, 0.4]])
    turned = transformed(mesh, T_scan_level)
    level = transformed(turned, level_transform(turned, (T_scan_level @ upright)[None]))
    guess = guess_up(level.vertices.astype(np.float64), level.triangles)
    assert guess.sure and guess.tilt_deg < 0.1


def test_a_ply_is_read_again_with_its_colours(tmp_path):
    write_ply(tmp_path / "new" / "a.ply", boards((0.5, 2.0)))
    (part,) = load_mesh(tmp_path / "new" / "a.ply", [tmp_path]).parts
    assert part.vertices.max(axis=0).tolist() == [2.0, 2.0, 0.5]
    assert part.colors is not None and part.colors[1, :3].tolist() == [3, 4, 5]


def test_without_open3d_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(EnvironmentProblemError, match=r"pip install 'gibson_sim_tools\[scanning\]'"):
        open3d()
