"""Holes in a robot's views of a fused mesh, in whatever frame it is; its level transform goes with the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim_tools.cli.scan import level_text
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh, transformed, write_ply
from gibson_sim_tools.scanning.robot_views import robot_view_holes
from support.interiors import room, triangles


def _room(*left_out: int) -> ColouredMesh:
    corners, quads = room(furniture=False)
    faces = triangles(np.delete(quads, left_out, axis=0)).astype(np.int32)
    return ColouredMesh(corners.astype(np.float32), faces, np.zeros((8, 3), np.uint8))


def test_holes_are_the_same_in_every_frame() -> None:
    T_scan_level = matrix_from_pose(pose_from_xyz_rpy(xyz=(1.0, -2.0, 3.0), rpy=(0.7, 0.2, -1.1)))
    closed = robot_view_holes(_room(), np.eye(4))
    level, turned = (
        robot_view_holes(transformed(_room(5), T), invert(T)) for T in (np.eye(4), T_scan_level)
    )  # fmt: skip
    assert closed is not None and closed.share == 0.0
    assert level is not None and turned is not None and level.nothing > 0.02
    assert turned.backs == 0.0
    # Rounding of coordinates moves the cells of the map, and so the places.
    assert turned.nothing == pytest.approx(level.nothing, rel=0.15)


def test_without_a_floor_at_its_height_nothing_is_measured() -> None:
    T = np.eye(4)
    T[2, 3] = 50.0
    assert robot_view_holes(_room(), T) is None


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
