"""Scans of our scenes, with noise and holes and without textures, rotated randomly: they are levelled, or "not sure", never wrong.

``GIBSON_SIM_ROTATIONS=50`` sets the rotations of each; ``tests/benchmarks/upright.py`` tests other scenes, scans and models.
"""

from __future__ import annotations

import os
from collections import Counter

import pytest

from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.scanning.capture import ScanSettings, scan
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.settings import PRESETS, Defects, ScanCamera, TourSettings
from support.turning import depth_mesh, random_rotation, verdict

ROTATIONS = int(os.environ.get("GIBSON_SIM_ROTATIONS", "8"))
KINECT = {**PRESETS["kinect"], "frames": 24, "width": 160, "height": 120, "coverage": 0.6, "seed": 1}
PARTS = [
    {name: value for name, value in KINECT.items() if name in part.__dataclass_fields__}
    for part in (TourSettings, ScanCamera, Defects)
]


@pytest.mark.parametrize("name", ["flat"])
def test_a_scan_in_any_rotation_is_levelled_upright_or_reported_as_ambiguous(name: str, tmp_path) -> None:
    settings = ScanSettings(TourSettings(**PARTS[0]), ScanCamera(**PARTS[1]), Defects(**PARTS[2]))
    scan(load_scene(name), tmp_path, settings)
    vertices, triangles = depth_mesh(open_posed_rgbd(tmp_path), every=2)
    found = Counter(verdict(vertices, triangles, random_rotation(seed)) for seed in range(ROTATIONS))
    assert not found["wrong"], found
    assert found["upright"] >= 0.6 * ROTATIONS, found
