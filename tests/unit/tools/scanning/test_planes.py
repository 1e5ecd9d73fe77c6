"""Plane snapping: walls, floors and ceilings become planar, other surfaces stay, and no vertex moves beyond the limit."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim_tools.scanning.planes import SnapReport, snap_to_planes
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from support.scans import ROOM, THRESHOLD, noisy_room

EDGE = 0.05
"""Edge of the triangles, metres."""


def _mesh(vertices: np.ndarray, triangles: np.ndarray) -> TriangleMesh:
    colors = np.zeros((len(vertices), 3), dtype=np.uint8)
    return TriangleMesh(vertices.astype(np.float64), triangles.astype(np.int64), colors).single()


def _sheet(shape: tuple[int, int], height: np.ndarray, edge: float = EDGE) -> TriangleMesh:
    """Returns a height field over a grid (rows, columns), facing up."""
    rows, columns = shape
    v, u = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    points = np.stack([u * edge, v * edge, height], axis=-1).reshape(-1, 3)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    low, high = np.stack([first, first + 1, first + columns + 1], 1), np.stack([first, first + columns + 1, first + columns], 1)
    return _mesh(points, np.concatenate([low, high]))


@pytest.fixture(scope="module")
def room() -> tuple[TriangleMesh, np.ndarray, TriangleMesh, SnapReport]:
    """A noisy room, the same without noise, and the noisy one snapped."""
    noisy = _mesh(*noisy_room(edge=EDGE, noise=0.004))
    clean = noisy_room(edge=EDGE, noise=0.0)[0]
    return noisy, clean, *snap_to_planes(noisy, EDGE, 0.02)


def test_noise_of_walls_floor_and_ceiling_is_removed(room: tuple[TriangleMesh, np.ndarray, TriangleMesh, SnapReport]) -> None:
    noisy, clean, mesh, report = room
    for axis, at in ((0, 0.0), (0, ROOM[0]), (1, ROOM[1]), (2, ROOM[2])):
        others = [k for k in range(3) if k != axis]
        inner = np.all((clean[:, others] > 0.3) & (clean[:, others] < np.array(ROOM)[others] - 0.3), axis=1)
        on = (np.abs(clean[:, axis] - at) < 1e-6) & inner
        assert np.std(noisy.vertices[on, axis]) > 0.003
        assert np.abs(mesh.vertices[on, axis] - at).mean() < 0.0008
    assert report.planes >= 6 and 0.5 < report.share <= 1.0
    assert report.noise_mm == pytest.approx(4.0, rel=0.2)


def test_no_vertex_moves_beyond_the_limit_and_no_triangle_flips(
    room: tuple[TriangleMesh, np.ndarray, TriangleMesh, SnapReport],
) -> None:
    noisy, _, mesh, report = room
    away = np.linalg.norm(mesh.vertices.astype(float) - noisy.vertices, axis=1)
    assert 0.002 < away.max() <= 0.02 + 1e-6 and report.max_mm == pytest.approx(1000 * away.max(), abs=0.01)
    assert ((mesh.doubled_area_vectors() * noisy.doubled_area_vectors()).sum(axis=1) > 0).all()
    np.testing.assert_array_equal(mesh.triangles, noisy.triangles)


def test_the_edge_between_two_walls_is_where_their_planes_meet(
    room: tuple[TriangleMesh, np.ndarray, TriangleMesh, SnapReport],
) -> None:
    noisy, clean, mesh, _ = room
    edge = (np.abs(clean[:, 0] - ROOM[0]) < 1e-6) & (np.abs(clean[:, 1] - ROOM[1]) < 1e-6)
    inner = edge & (clean[:, 2] > 0.2) & (clean[:, 2] < 2.2)
    off = np.linalg.norm((mesh.vertices - clean)[inner, :2], axis=1)
    before = np.linalg.norm((noisy.vertices - clean)[inner, :2], axis=1)
    assert inner.sum() > 15 and np.median(off) < 0.0015 < np.median(before)


def test_a_door_sill_above_the_noise_stays(
    room: tuple[TriangleMesh, np.ndarray, TriangleMesh, SnapReport],
) -> None:
    _, clean, mesh, _ = room
    top = (np.abs(clean[:, 2] - THRESHOLD) < 1e-6) & (np.abs(clean[:, 0] - 4.0) < 0.1) & (clean[:, 1] > 0.2) & (clean[:, 1] < 4.8)
    assert mesh.vertices[top, 2].mean() == pytest.approx(THRESHOLD, abs=0.002)


def test_a_curved_wall_stays_curved() -> None:
    u = np.arange(60) * 0.05
    arc = np.broadcast_to(np.sqrt(2.0**2 - (u - 1.475) ** 2), (40, 60))
    mesh = _sheet((40, 60), arc)
    out, _ = snap_to_planes(mesh, EDGE, 0.02)
    away = np.abs(out.vertices - mesh.vertices)
    # The top of the arc is flat to 2 cm over 0.56 m; most of the wall belongs to no plane.
    assert away.max() < 0.02 and away.mean() < 0.002


def test_small_flat_surfaces_are_not_snapped() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.003, (13, 13))
    mesh = _sheet((13, 13), noise)  # 0.36 m^2
    out, report = snap_to_planes(mesh, EDGE, 0.02)
    assert report.planes == 0
    np.testing.assert_array_equal(out.vertices, mesh.vertices)


def test_bumps_of_a_floor_are_removed_only_within_its_noise() -> None:
    height = np.random.default_rng(0).normal(0.0, 0.002, (60, 60))
    height[20:30, 20:30] += 0.015  # a tile that lies on it
    out, _ = snap_to_planes(_sheet((60, 60), height), EDGE, 0.02)
    z = out.vertices[:, 2].reshape(60, 60)
    assert np.abs(z[40:55, 5:55]).mean() < 0.0004
    assert z[22:28, 22:28].mean() == pytest.approx(0.015, abs=0.001)
