"""A scanner's errors in depths and poses."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.types import CameraSpec, Frame
from gibson_sim_tools.scanning.defects import depth_edges, estimated_poses, image_effects, measured_depth
from gibson_sim_tools.scanning.settings import PRESETS, Defects, FuseSettings, ScanCamera, TourSettings

CLEAN = Defects()
CAMERA = CameraSpec("0", "", width=80, height=60)


def frame(depth, rgb: int = 128) -> Frame:
    image = np.broadcast_to(np.asarray(depth, dtype=np.float32), (60, 80)).copy()
    return Frame(CAMERA, 0, np.eye(4), np.full((60, 80, 3), rgb, dtype=np.uint8), image)


def two_walls() -> np.ndarray:
    """The left half at 2 m, the right half at 3 m."""
    return np.where(np.arange(80) < 40, 2.0, 3.0)


def lost(depth) -> float:
    return float(np.isnan(depth).mean())


def test_a_scanner_without_defects_measures_the_ground_truth():
    assert (measured_depth(frame(two_walls()), CLEAN, None, 0, 0) == two_walls().astype(np.float32)).all()


def test_surfaces_out_of_range_have_no_depth():
    depth = measured_depth(frame(two_walls()), replace(CLEAN, range_max=2.5), None, 0, 0)
    assert np.isnan(depth[:, 40:]).all() and (depth[:, :40] == 2.0).all()
    assert lost(measured_depth(frame(np.inf), CLEAN, None, 0, 0)) == 1.0


def test_noise_grows_with_the_square_of_the_range():
    noisy = replace(CLEAN, depth_quadratic=0.002)
    near, far = (np.std(measured_depth(frame(z), noisy, None, 0, 0)) for z in (1.0, 4.0))
    assert near == pytest.approx(0.002, rel=0.1)
    assert far == pytest.approx(0.032, rel=0.1)


def test_edges_are_found_on_both_sides_and_not_on_slopes():
    found = depth_edges(np.broadcast_to(two_walls(), (60, 80)).astype(np.float32))
    assert np.flatnonzero(found[30]).tolist() == [39, 40]
    assert not depth_edges(np.tile(np.linspace(1.0, 9.0, 80, dtype=np.float32), (60, 1)))[:, 1:-1].any()


def test_depth_is_lost_near_edges_only_and_in_patches():
    depth = measured_depth(frame(two_walls()), replace(CLEAN, edge_px=4), None, 0, 0)
    band = depth[:, 35:45]
    assert 0.3 < lost(band) < 0.9
    assert not np.isnan(depth[:, :34]).any() and not np.isnan(depth[:, 46:]).any()


def test_flying_pixels_lie_between_the_two_surfaces():
    depth = measured_depth(frame(two_walls()), replace(CLEAN, flying_fraction=1.0), None, 0, 0)
    assert ((depth[:, 39:41] > 2.0) & (depth[:, 39:41] < 3.0)).mean() > 0.95
    assert (depth[:, 41:] == 3.0).all()


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_pixels_without_depth_raise_no_warning(preset):
    """A window beside a wall, and one all over the image: numpy is silent, and nothing flies where there is nothing."""
    window = np.broadcast_to(two_walls(), (60, 80)).copy()
    window[10:50, 20:60] = np.inf
    defects = Defects(**{name: value for name, value in PRESETS[preset].items() if name in Defects.__dataclass_fields__})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        depth = measured_depth(frame(window), defects, None, 0, 0)
        assert lost(measured_depth(frame(np.full((60, 80), np.nan)), defects, None, 0, 0)) == 1.0
    assert np.isnan(depth[15:45, 25:55]).all()


def test_black_surfaces_lose_depth_and_grey_ones_do_not():
    dark = replace(CLEAN, dark_fraction=0.6)
    assert lost(measured_depth(frame(2.0, rgb=0), dark, None, 0, 0)) == pytest.approx(0.6, abs=0.12)
    assert lost(measured_depth(frame(2.0, rgb=80), dark, None, 0, 0)) == 0.0


def test_shiny_surfaces_lose_depth():
    shiny = np.zeros((60, 80), dtype=bool)
    shiny[:, :40] = True
    depth = measured_depth(frame(2.0), replace(CLEAN, shiny_fraction=0.9), shiny, 0, 0)
    assert lost(depth[:, :40]) == pytest.approx(0.9, abs=0.1)
    assert lost(depth[:, 40:]) == 0.0


def test_errors_depend_on_seed_and_frame_only():
    kinect = Defects(**{k: v for k, v in PRESETS["kinect"].items() if hasattr(CLEAN, k)})
    frames = [
        measured_depth(replace(frame(two_walls()), camera=replace(CAMERA, name=str(n))), kinect, None, s, n)
        for s, n in ((0, 0), (0, 0), (1, 0), (0, 1))
    ]
    assert np.array_equal(frames[0], frames[1], equal_nan=True)
    assert not np.array_equal(frames[0], frames[2], equal_nan=True)
    assert not np.array_equal(frames[0], frames[3], equal_nan=True)


def poses(count: int) -> np.ndarray:
    return np.stack([matrix_from_pose(pose_from_xyz_rpy((0.5 * k, 0, 1), (0, 0, 0))) for k in range(count)])


def test_without_noise_poses_are_true():
    assert np.allclose(estimated_poses(poses(5), CLEAN, 0), poses(5), atol=1e-12)


def test_pose_noise_has_the_requested_size():
    found = np.linalg.inv(poses(400)) @ estimated_poses(poses(400), replace(CLEAN, pose_noise_m=0.003, pose_noise_deg=0.3), 0)
    assert found[:, :3, 3].std() == pytest.approx(0.003, rel=0.1)
    turns = np.degrees(np.stack([found[:, 2, 1], found[:, 0, 2], found[:, 1, 0]]))
    assert turns.std() == pytest.approx(0.3, rel=0.1)


def test_drift_begins_at_zero_and_grows_with_the_root_of_the_distance():
    errors = [
        estimated_poses(poses(51), replace(CLEAN, drift_m=0.01), seed)[:, :3, 3] - poses(51)[:, :3, 3] for seed in range(30)
    ]
    assert np.abs([e[0] for e in errors]).max() == 0.0
    assert np.std([e[50] for e in errors]) == pytest.approx(0.01 * math.sqrt(25.0), rel=0.25)
    steps = np.diff(errors[0], axis=0)
    assert np.abs(steps).max() < 0.05


def test_drift_keeps_the_direction_of_gravity():
    found = estimated_poses(poses(100), replace(CLEAN, drift_deg=1.0), 3)
    assert np.allclose(found[:, 2, :3], poses(100)[:, 2, :3], atol=1e-12)
    assert not np.allclose(found[-1, :2, :2], np.eye(2), atol=1e-3)


def test_exposure_and_white_balance_differ_from_view_to_view():
    jitter = replace(CLEAN, exposure_jitter_ev=0.2, white_balance_jitter=0.05)
    effects = [image_effects(jitter, 0, n) for n in range(300)]
    assert np.std([e.exposure_ev for e in effects]) == pytest.approx(0.2, rel=0.15)
    assert np.std([e.white_balance_k for e in effects]) == pytest.approx(325.0, rel=0.15)
    assert image_effects(jitter, 0, 5) == effects[5]


def test_every_preset_is_made_of_settings():
    names = {name for part in (TourSettings, ScanCamera, Defects) for name in part.__dataclass_fields__}
    for values in PRESETS.values():
        assert set(values) <= names
        for part in (TourSettings, ScanCamera, Defects):
            part(**{k: v for k, v in values.items() if k in part.__dataclass_fields__})


@pytest.mark.parametrize(
    "make",
    [
        lambda: TourSettings(pitches_deg="up"),
        lambda: TourSettings(pitches_deg="100"),
        lambda: TourSettings(height_min=1.6, height_max=1.2),
        lambda: TourSettings(coverage=1.5),
        lambda: Defects(range_min=3.0, range_max=2.0),
        lambda: Defects(shutter_s=2.0),
        lambda: FuseSettings(voxel=0.0005),
    ],
)
def test_an_impossible_setting_is_refused(make):
    with pytest.raises(ConfigError, match="must"):
        make()
