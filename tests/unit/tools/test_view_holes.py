"""How much of what a robot sees is hole, in rooms whose holes are known, and in fused meshes, in whatever frame they are.

The level transform of a fused mesh goes with its file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.maps.floor_map import FloorMap, make_floor_map
from gibson_sim_tools.cli.scan import level_text
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh, transformed, write_ply
from gibson_sim_tools.view_holes import CAMERA_HEIGHT, HEIGHT, WIDTH, ViewHoles, first_faces, mesh_view_holes, view_holes
from support.interiors import box_faces, room, triangles
from support.scans import noisy_room

FLOOR, CEILING = 0, 1
"""Rows of the quads of a box."""
ROWS = (np.arange(HEIGHT) + 0.5) / HEIGHT * 1.5 - 0.75
"""Tangent of the angle below the horizon of the middle of each row of a view."""


def _hall(*left_out: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns an empty room of 6 x 6 x 3 m about the origin, without some of its sides."""
    corners, quads = box_faces((-3, -3, 0), (3, 3, 3), inward=True)
    return corners, triangles(np.delete(quads, left_out, axis=0))


def _one_place(floor_z: float = 0.0) -> FloorMap:
    """Returns a map on which a robot of 0.2 m fits at the origin alone."""
    free = np.zeros((21, 21), dtype=bool)
    free[5:16, 5:16] = True
    return FloorMap(0.05, (-0.525, -0.525), ~free, np.ones_like(free), None, floor_z)


def _holes(
    mesh: tuple[np.ndarray, np.ndarray], floor: FloorMap | None = None, one_sided: bool = True, **options: float
) -> ViewHoles:
    vertices, faces = mesh
    found = view_holes(
        vertices[faces], np.full(len(faces), one_sided), [_one_place() if floor is None else floor], 0.2, **options
    )
    assert found is not None
    return found


def test_a_closed_room_has_no_holes() -> None:
    found = _holes(_hall())
    assert (found.places, found.nothing, found.backs) == (1, 0.0, 0.0)


def test_a_room_without_a_ceiling_has_the_holes_that_geometry_says() -> None:
    # A ray of a view with coordinates (x, y), |x| <= 1, |y| <= 0.75, passes over the wall, 3 m ahead and 2.5 m above the camera, where -y > 2.5 / 3.
    assert _holes(_hall(CEILING)).share == 0.0
    low = _one_place(1.5)  # the camera is 2 m high: the walls end 1 m above it, at y = -1/3
    assert _holes(_hall(CEILING), low).nothing == pytest.approx(float((ROWS < -1 / 3).mean()), abs=1e-9)


def test_a_missing_wall_fills_a_view_between_floor_and_ceiling() -> None:
    found = _holes(_hall(3))  # the wall at x = 3
    assert found.nothing == pytest.approx(float((ROWS < CAMERA_HEIGHT / 3.0).mean()) / 4, abs=0.002)
    assert found.backs == 0.0


def test_walls_seen_from_behind_are_holes_only_in_one_sided_meshes() -> None:
    corners, faces = _hall()
    inside_out = corners, faces[:, ::-1]
    assert _holes(inside_out).backs == 1.0
    assert _holes(inside_out, one_sided=False).share == 0.0
    both = corners, np.concatenate([faces, faces[:, ::-1]])
    assert _holes(both).share == 0.0


def test_the_ground_plane_is_a_surface() -> None:
    assert _holes(_hall(FLOOR)).nothing == pytest.approx(float((ROWS > CAMERA_HEIGHT / 3.0).mean()), abs=0.01)
    assert _holes(_hall(FLOOR), ground_z=0.0).share == 0.0


def test_a_scan_without_holes_has_none_and_a_lost_part_of_a_wall_is_found() -> None:
    vertices, faces = noisy_room(edge=0.2)
    floor = make_floor_map(vertices, faces, floor_z=0.0, robot_height=0.5)
    assert _holes((vertices, faces), floor).share < 0.002  # the noise overhangs at edges of things
    middles = vertices[faces].mean(axis=1)
    lost = (np.abs(middles[:, 1] - 5.0) < 0.03) & (np.abs(middles[:, 0] - 2.0) < 0.5) & (np.abs(middles[:, 2] - 1.2) < 0.5)
    assert 0.003 < _holes((vertices, faces[~lost]), floor).share < 0.05


def test_a_triangle_that_reaches_behind_the_camera_is_drawn() -> None:
    floor = np.array([[[50.0, 0.5, -10.0], [0.0, 0.5, 100.0], [-50.0, 0.5, -10.0]]])  # camera frame: y is down
    seen, back = first_faces(floor, np.ones(1, dtype=bool))
    assert seen.shape == (HEIGHT, WIDTH)
    assert seen[HEIGHT - 1].all() and not seen[: HEIGHT // 2].any() and not back.any()
    np.testing.assert_array_equal(first_faces(floor[:, ::-1], np.ones(1, dtype=bool))[1], seen)


def test_where_no_robot_fits_nothing_is_measured() -> None:
    full = FloorMap(0.05, (0.0, 0.0), np.ones((4, 4), dtype=bool), np.ones((4, 4), dtype=bool))
    vertices, faces = _hall()
    assert view_holes(vertices[faces], np.ones(len(faces), dtype=bool), [full], 0.2) is None


def _room(*left_out: int) -> TriangleMesh:
    corners, quads = room(furniture=False)
    faces = triangles(np.delete(quads, left_out, axis=0)).astype(np.int32)
    return TriangleMesh(corners.astype(np.float64), faces, np.zeros((8, 3), np.uint8))


def _mesh_holes(mesh: TriangleMesh, T_level_mesh: np.ndarray) -> ViewHoles | None:
    return mesh_view_holes(mesh.vertices, mesh.triangles, T_level_mesh)


def test_holes_are_the_same_in_every_frame() -> None:
    T_scan_level = matrix_from_pose(pose_from_xyz_rpy(xyz=(1.0, -2.0, 3.0), rpy=(0.7, 0.2, -1.1)))
    closed = _mesh_holes(_room(), np.eye(4))
    level, turned = (
        _mesh_holes(transformed(_room(5), T), invert(T)) for T in (np.eye(4), T_scan_level)
    )  # fmt: skip
    assert closed is not None and closed.share == 0.0
    assert level is not None and turned is not None and level.nothing > 0.02
    assert turned.backs == 0.0
    # Rounding of coordinates moves the cells of the map, and so the places.
    assert turned.nothing == pytest.approx(level.nothing, rel=0.15)


def test_without_a_floor_at_its_height_nothing_is_measured() -> None:
    T = np.eye(4)
    T[2, 3] = 50.0
    assert _mesh_holes(_room(), T) is None


def test_the_message_about_the_floor_names_tilt_and_height() -> None:
    T = matrix_from_pose(pose_from_xyz_rpy(xyz=(0.0, 0.0, 0.25), rpy=(np.radians(0.2), 0.0, 0.0)))
    assert level_text(T, False) == "the floor is level to 0.20 degrees, at z = -0.250 m"
    T = matrix_from_pose(pose_from_xyz_rpy(rpy=(np.radians(1.65), 0.0, 0.0)))
    assert level_text(T, False) == "the floor is 1.65 degrees out of level: --level turns the mesh and puts the floor at z = 0"
    assert level_text(T, True) == "turned by 1.65 degrees: z is up and the floor is at z = 0"
    assert "no floor" in level_text(None, False)


def test_comments_of_a_mesh_are_in_its_header_and_it_is_read(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", _room(), ["T_level_scan 1 0 0 0"])
    assert b"\ncomment T_level_scan 1 0 0 0\n" in (tmp_path / "a.ply").read_bytes()
    assert load_mesh(tmp_path / "a.ply", [tmp_path]).triangle_count == 12
