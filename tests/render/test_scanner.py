"""Scans of a tiny room, drawn and written."""

from __future__ import annotations

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gibson_sim.cli import main as cli
from gibson_sim.errors import ConfigError
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.scanning.capture import ScanSettings, scan
from gibson_sim_tools.scanning.clean_scene import opaque_triangles, sample_surface
from gibson_sim_tools.scanning.comparison import observed_points
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.settings import Defects, ScanCamera, TourSettings
from gibson_sim_tools.scanning.trajectories import read_stamped_poses
from support.scenes import write_room

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

FLOOR = "  - {name: floor, box: [4.0, 4.0, 0.2], pose: {xyz: [0, 0, -0.1]}, color: [0.5, 0.5, 0.5], semantic_class: floor}\n"
CEILING = "  - {name: lid, box: [4.0, 4.0, 0.1], pose: {xyz: [0, 0, 2.05]}, color: [0.6, 0.6, 0.6], semantic_class: ceiling}\n"
SETTINGS = ScanSettings(
    TourSettings(turn_deg=45.0, clearance=1.4), ScanCamera(width=64, height=48, fov_y_deg=60.0, samples=1), Defects()
)
PHONE = Defects(
    depth_quadratic=0.002, edge_px=1, shiny_fraction=0.9, shiny_classes="floor", pose_noise_m=0.003, exposure_jitter_ev=0.3,
    shutter_s=0.05, shot_noise=0.02,
)  # fmt: skip


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return load_scene(write_room(tmp_path_factory.mktemp("room"), FLOOR + CEILING))


@pytest.fixture(scope="module")
def clean(room, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan") / "clean"
    return folder, scan(room, folder, SETTINGS)


def contents(folder) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_scan_is_posed_rgbd_that_fits_the_scene(room, clean):
    folder, plan = clean
    rgbd = open_posed_rgbd(folder)
    assert (rgbd.layout, len(rgbd)) == ("gibson_sim", 3 * len(plan.views))
    frame = rgbd[1]
    K, T = rgbd.intrinsics.matrix, frame.T_world_camera
    v, u = np.mgrid[4:44, 4:60]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    points = (rays * frame.depth[4:44, 4:60, None]).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    inner = np.array([[-1.95, -1.95, 0.0], [1.95, 1.95, 2.0]])
    off = np.minimum(np.abs(points - inner[0]), np.abs(points - inner[1])).min(axis=1)
    assert np.nanmax(off) < 0.002


def test_scan_covers_at_least_97_percent_of_the_surfaces(room, clean):
    folder, plan = clean
    assert plan.coverage >= 0.98
    surface = sample_surface(*opaque_triangles(room), 4000, np.random.default_rng(1))
    inside = (
        (np.abs(surface.points[:, :2]) < 1.951).all(axis=1) & (surface.points[:, 2] > -0.001) & (surface.points[:, 2] < 2.001)
    )
    shown = observed_points(surface, open_posed_rgbd(folder))
    assert shown[inside].mean() > 0.97
    outside = (np.abs(surface.points[:, :2]) > 2.049).any(axis=1)
    assert shown[outside].mean() < 0.01


def test_a_resumed_scan_equals_an_uninterrupted_one(room, clean, tmp_path):
    folder, _ = clean
    shutil.copytree(folder, tmp_path / "part")
    for number in (0, 7, 20):
        (tmp_path / "part" / "depth" / f"{number:06d}.png").unlink()
    scan(room, tmp_path / "part", SETTINGS)
    assert contents(tmp_path / "part") == contents(folder)


def test_another_scan_and_other_files_are_not_overwritten(room, clean, tmp_path):
    folder, _ = clean
    with pytest.raises(ScanError, match="another scan"):
        scan(room, folder, replace(SETTINGS, defects=PHONE))
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(ScanError, match="is not a scan"):
        scan(room, tmp_path, SETTINGS)


def test_defects_are_decided_by_the_seed(room, tmp_path):
    spoiled = ScanSettings(replace(SETTINGS.tour, frames=5, pitches_deg="-30"), SETTINGS.camera, PHONE)
    for name in ("a", "b"):
        scan(room, tmp_path / name, spoiled)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    rgbd = open_posed_rgbd(tmp_path / "a")
    assert len(rgbd) == 5
    (_, true), (_, measured) = (read_stamped_poses(tmp_path / "a" / name) for name in ("true_poses.txt", "poses.txt"))
    assert 0.001 < float(np.abs(true[:, :3, 3] - measured[:, :3, 3]).max()) < 0.02
    holes = np.mean([np.isnan(f.depth).mean() for f in rgbd])
    assert 0.2 < holes < 0.95  # such a camera sees mostly floor


def test_the_command_scans_and_reports_its_coverage(tmp_path, capsys):
    scene = write_room(tmp_path / "room", FLOOR + CEILING)
    argv = [
        "scene",
        "scan",
        str(scene),
        "--output",
        str(tmp_path / "out"),
        "--preset",
        "clean",
        "--clearance",
        "1.4",
        "--frames",
        "3",
        "--width",
        "32",
        "--height",
        "24",
    ]
    with pytest.raises(SystemExit) as end:
        cli.main(argv)
    assert end.value.code == 0
    assert "3 images from 1 views, 1 stations" in capsys.readouterr().out
    assert cv2.imread(str(tmp_path / "out" / "color" / "000002.jpg")).shape == (24, 32, 3)


def test_an_impossible_option_is_refused_in_words(tmp_path):
    with pytest.raises(ConfigError, match="coverage"):
        TourSettings(coverage=0.0)
