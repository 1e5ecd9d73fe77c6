"""Ground truth of a scan: the static scene and its opaque triangles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.urdf import parse_urdf
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.scanning.clean_scene import opaque_triangles, static_scene
from gibson_sim_tools.scanning.posed_images import ScanError
from support.scenes import write_room

CABINET = """
<robot name="cabinet">
  <link name="case"><visual><geometry><box size="1 1 1"/></geometry></visual>
    <collision><geometry><box size="1 1 1"/></geometry></collision></link>
  <link name="door"><visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual></link>
  <joint name="hinge" type="revolute"><parent link="case"/><child link="door"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


def test_bodies_are_scanned_at_their_initial_poses(tmp_path):
    scene = load_scene(write_room(tmp_path))
    body = BodySpec(
        "cabinet", parse_urdf(CABINET, Path("cabinet.urdf")), pose_from_xyz_rpy((0.5, 0.0, 0.5), (0.0, 0.0, np.pi / 2))
    )
    full = replace(scene, bodies=(body,))
    drawn = static_scene(full)
    assert all(v.link == "" for v in drawn.visuals)
    door = next(v for v in drawn.visuals if "door" in v.name)
    assert door.pose.position == pytest.approx((0.5, 0.5, 0.5), abs=1e-6)
    assert len(opaque_triangles(full)[1]) == len(opaque_triangles(scene)[1]) + 24


def test_glass_is_not_opaque(tmp_path):
    pane = "  - {name: pane, box: [0.01, 1.0, 1.0], color: [0.9, 0.9, 1.0, 0.2]}\n"
    assert len(opaque_triangles(load_scene(write_room(tmp_path / "a", pane)))[1]) == 4 * 12
    only = tmp_path / "b"
    only.mkdir()
    (only / "scene.yaml").write_text("name: glass\nground_z: 0.0\nfloor_z: 0.0\nobjects:\n" + pane)
    with pytest.raises(ScanError, match="no solid surface"):
        opaque_triangles(load_scene(only))
