"""The learned policy, with a hand-made network whose recorded images encode their positions in their colours."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.errors import ModelError, SettingError, ViewError
from gibson_path_following.localisation.pose_filter import OffsetCalibration, PoseFilter, node_poses, relative_pose
from gibson_path_following.localisation.pose_tracking import PoseTrackingSettings
from gibson_path_following.obstacles.occupancy import OccupancySettings
from gibson_path_following.obstacles.speed_limits import SpeedSettings
from gibson_path_following.policies.follower import PathFollower
from gibson_path_following.policies.learned import LearnedPolicy, LearnedSettings
from gibson_path_following.policies.path_model import DEFAULT_MODEL, PathModel
from gibson_path_following.types import STOP, Image, PathNode, Place, RecordedPath, Step, Velocity, View
from support.path_models import METADATA, path_model

HFOV = math.radians(100.0)
AHEAD = Velocity(0.4, 0.0)
STEP_NS = 500_000_000  # 0.2 m at 0.4 m/s
FREE = (3.0,) * 24


def colour(x: float, y: float, yaw: float) -> Image:
    """Returns the image that the network by hand sees at a pose."""
    return np.full((64, 96, 3), (round(100 * x), round(100 * y) + 100, round(100 * yaw) + 100), np.uint8)


def path_of(images: list[Image], velocity: Velocity = AHEAD) -> RecordedPath:
    nodes = tuple(PathNode((image,), k * STEP_NS, 0.2 * k, ((0, velocity),)) for k, image in enumerate(images))
    return RecordedPath("pinhole", HFOV, nodes)


def model(folder: Path, free: tuple[float, ...] = FREE) -> PathModel:
    file = folder / "model.onnx"
    file.write_bytes(path_model(free))
    return PathModel(file)


def at(index: float) -> Place:
    return Place(index, 1.0, False)


VIEW = (np.zeros((64, 96, 3), np.uint8),)


def test_network_predicts_poses_of_recorded_images(tmp_path: Path) -> None:
    found = model(tmp_path).estimate(VIEW[0], np.stack([colour(0.5, 0.2, -0.3), colour(1.0, 0.0, 0.0)]))
    np.testing.assert_allclose(found.pose, [[0.5, 0.2, -0.3], [1.0, 0.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(found.match, [1.0, 1.0])
    network = model(tmp_path)
    # All is farther than the last edge, 3 m.
    np.testing.assert_allclose(found.hit, np.tile(np.eye(len(network.edges))[-1], (24, 1)), atol=1e-6)


def test_network_of_the_package_sees_an_image_in_itself() -> None:
    network = PathModel(DEFAULT_MODEL)
    image = np.kron(np.random.default_rng(0).integers(0, 256, (8, 12, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    found = network.estimate(image, image[None])
    assert found.match[0] > 0.5
    assert np.hypot(*found.pose[0, :2]) < 0.3
    assert abs(found.pose[0, 2]) < 0.2
    np.testing.assert_allclose(found.hit.sum(axis=1), 1.0, atol=1e-4)
    assert found.hit.shape == (len(network.bearings), len(network.edges))
    assert DEFAULT_MODEL.stat().st_size < 10e6
    assert DEFAULT_MODEL.with_suffix(".md").is_file()


def test_bearings_are_the_centres_of_equal_strips(tmp_path: Path) -> None:
    bearings = model(tmp_path).bearings
    assert bearings[0] == pytest.approx(math.atan(23.0 / 24.0 * math.tan(HFOV / 2.0)))
    np.testing.assert_allclose(bearings, -bearings[::-1])


def test_robot_beside_the_path_turns_back_to_it(tmp_path: Path) -> None:
    # All recorded images are seen 0.3 m to the left, where they truly are ahead: the robot is to the right of its path.
    images = [colour(0.0, 0.0, 0.0), *(colour(0.2 * k, 0.3, 0.0) for k in range(1, 12))]
    policy = LearnedPolicy(path_of(images), model(tmp_path))
    velocity = policy.act(VIEW, 0, at(0.0))
    assert policy.tracker.filter.pose[1] < -0.15
    assert velocity.linear > 0.0
    assert velocity.angular > 0.1


def test_robot_on_the_path_drives_straight_at_the_recorded_speed(tmp_path: Path) -> None:
    images = [colour(0.2 * k, 0.0, 0.0) for k in range(12)]
    velocity = LearnedPolicy(path_of(images), model(tmp_path)).act(VIEW, 0, at(0.0))
    assert velocity.linear == pytest.approx(0.4)
    assert velocity.angular == pytest.approx(0.0, abs=0.05)


def driven(folder: Path, free: tuple[float, ...], views: int, min_range: float = 0.35) -> tuple[LearnedPolicy, list[Velocity]]:
    """Returns a policy that stands at the start of a straight path and sees the same again and again, and its velocities."""
    images = [colour(0.2 * k, 0.0, 0.0) for k in range(12)]
    # The network by hand predicts the same obstacles in all images, recorded ones too.
    settings = LearnedSettings(occupancy=OccupancySettings(recorded_hit_factor=0.0, min_range=min_range))
    policy = LearnedPolicy(path_of(images), model(folder, free), settings)
    return policy, [policy.act(VIEW, k * 200_000_000, at(0.0)) for k in range(views)]


def test_robot_stops_before_a_wall(tmp_path: Path) -> None:
    # The robot is 0.175 m in front of its middle, the camera 0.12 m: 0.245 m are left.
    _, velocities = driven(tmp_path, (0.3,) * 24, 5, min_range=0.2)
    assert velocities[-1] == STOP


def test_robot_stops_for_some_views_before_an_obstacle_below_the_minimum_range_and_then_creeps(tmp_path: Path) -> None:
    policy, velocities = driven(tmp_path, (0.2,) * 24, 20)
    assert policy.plan is not None
    assert policy.plan.is_free
    views = policy.settings.speed.max_stop_views
    assert velocities[:views] == [STOP] * views
    assert all(0.0 < velocity.linear <= policy.settings.speed.slow_linear + 1e-9 for velocity in velocities[views:])


def test_one_view_of_an_obstacle_slows_the_robot_before_the_grid_has_it(tmp_path: Path) -> None:
    policy, velocities = driven(tmp_path, (0.7,) * 24, 1)
    assert policy.plan is not None
    assert policy.plan.is_free
    assert velocities[0].linear == pytest.approx(policy.settings.speed.slow_linear)
    # An obstacle beside the plan does not.
    beside = (0.7,) * 4 + (3.0,) * 20
    assert driven(tmp_path, beside, 1)[1][0].linear == pytest.approx(0.4)


def test_robot_is_slower_before_a_wall_that_is_farther_away(tmp_path: Path) -> None:
    _, velocities = driven(tmp_path, (0.7,) * 24, 6)
    assert 0.0 < velocities[-1].linear < 0.3


def test_robot_drives_round_an_obstacle_on_its_path(tmp_path: Path) -> None:
    # An obstacle 0.8 m ahead in the left half of the view, and at two bearings of the right half.
    policy, velocities = driven(tmp_path, (0.8,) * 14 + (3.0,) * 10, 6)
    assert policy.plan is not None
    assert policy.plan.is_free
    assert policy.plan.offsets.min() < -0.2
    assert velocities[-1].angular < 0.0
    assert velocities[-1].linear > 0.0


def test_blocked_robot_backs_up_after_a_wait(tmp_path: Path) -> None:
    _, velocities = driven(tmp_path, (0.3,) * 24, 16, min_range=0.2)
    assert any(velocity.linear < 0.0 for velocity in velocities)


def test_robot_stops_after_some_views_without_a_match(tmp_path: Path) -> None:
    images = [np.zeros((64, 96, 3), np.uint8)] * 12  # no red: no match
    policy = LearnedPolicy(
        path_of(images), model(tmp_path), LearnedSettings(tracking=PoseTrackingSettings(max_unmatched_views=2))
    )
    velocities = [policy.act(VIEW, k * 200_000_000, at(0.0)) for k in range(4)]
    assert [velocity.linear > 0.0 for velocity in velocities] == [True, True, False, False]
    assert velocities[-1] == STOP


def test_network_sees_a_view_from_a_quarter_of_a_metre_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = LearnedPolicy(path_of([colour(0.2 * k, 0.0, 0.0) for k in range(12)]), model(tmp_path))
    shown = []
    estimate = policy.model.estimate
    monkeypatch.setattr(policy.model, "estimate", lambda *images: shown.append(images[2]) or estimate(*images))
    views = [np.full((64, 96, 3), k, np.uint8) for k in range(6)]

    def drive(first_ns: int) -> None:
        for k, view in enumerate(views):
            policy.act((view,), first_ns + k * 200_000_000, replace(at(0.5 * k), moved=Step(0.1 if k else 0.0, 0.0)))

    drive(0)
    assert shown[0] is None
    assert shown[5] is not None
    image, pose = shown[5]
    assert int(image[0, 0, 0]) in (2, 3)
    np.testing.assert_allclose(pose, [-0.1 * (5 - int(image[0, 0, 0])), 0.0, 0.0], atol=1e-9)
    shown.clear()
    drive(60_000_000_000)
    assert shown[0] is None, "long ago: who knows where the robot was driven"


def test_a_network_that_sees_an_earlier_image_needs_the_height_of_its_camera(tmp_path: Path) -> None:
    file = tmp_path / "model.onnx"
    file.write_bytes(path_model(FREE, earlier=True))
    with pytest.raises(ModelError, match=r"its metadata lack one of hfov_deg, .*, offset_deviation, camera_height as numbers"):
        PathModel(file)
    file.write_bytes(path_model(FREE, earlier=True, metadata={**METADATA, "camera_height": "0"}))
    with pytest.raises(ModelError, match=r"its camera_height is 0, must be 0\.01 to 100 m"):
        PathModel(file)
    file.write_bytes(path_model(FREE, earlier=True, metadata={**METADATA, "camera_height": "0.46"}))
    assert PathModel(file).estimate(VIEW[0], VIEW[0][None], (VIEW[0], np.array([-0.2, 0.0, 0.0]))).hit.shape == (24, 31)


def test_images_of_a_wider_camera_are_cut(tmp_path: Path) -> None:
    wide = np.zeros((128, 192, 3), np.uint8)
    wide[:, 48:144] = 200  # the middle half of the width: tan 45 degrees * 2 = tan 63.4 degrees
    resampled = model(tmp_path).resample(wide, 2.0 * math.atan(2.0 * math.tan(HFOV / 2.0)))
    assert resampled.shape == (64, 96, 3)
    assert resampled.min() == 200


def test_paths_of_fisheyes_are_refused(tmp_path: Path) -> None:
    path = RecordedPath("fisheye_pair", math.pi, path_of([VIEW[0]] * 3).nodes)
    with pytest.raises(ViewError, match="needs a pinhole camera"):
        LearnedPolicy(path, model(tmp_path))


@pytest.mark.parametrize("hfov_deg", ["nan", "inf", "0", "0.001", "-5", "180", "1e9"])
def test_a_network_with_an_impossible_field_of_view_is_refused(tmp_path: Path, hfov_deg: str) -> None:
    file = tmp_path / "model.onnx"
    file.write_bytes(path_model(FREE, metadata={**METADATA, "hfov_deg": hfov_deg}))
    with pytest.raises(ModelError, match=f"its hfov_deg is {float(hfov_deg):g}, must be 10 to 179; export".replace("+", r"\+")):
        PathModel(file)


@pytest.mark.parametrize("step", [1e-12, 1e12, math.inf])
def test_a_network_with_impossible_ranges_is_refused(tmp_path: Path, step: float) -> None:
    edges = ",".join(str(k * step if k else 0) for k in range(31))
    file = tmp_path / "model.onnx"
    file.write_bytes(path_model(FREE, metadata={**METADATA, "free_edges": edges}))
    with pytest.raises(ModelError, match=r"must be 31 that grow from 0 m to at least 0\.5 m and at most 100 m"):
        PathModel(file)


@pytest.mark.parametrize("poses", [1, 100])
def test_a_network_whose_outputs_do_not_fit_the_recorded_images_is_refused(tmp_path: Path, poses: int) -> None:
    file = tmp_path / "model.onnx"
    file.write_bytes(path_model(FREE, poses=poses))
    with pytest.raises(ModelError, match=rf"its outputs pose, scale, match, hit have shapes \({poses}, 3\), .*, must be \("):
        PathModel(file)


def test_other_networks_are_refused_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "other.onnx"
    file.write_bytes(path_model(FREE, outputs=("a", "b", "c", "d")))
    known = r"must be present, recorded, earlier \(the last one may be missing\) and pose, scale, match, hit"
    with pytest.raises(ModelError, match=rf"its outputs a, b, c, d; {known}"):
        PathModel(file)
    file.write_bytes(path_model(FREE, metadata={}))
    with pytest.raises(ModelError, match="its metadata lack one of hfov_deg, free_edges, offset_ratio, offset_deviation"):
        PathModel(file)
    file.write_bytes(path_model(FREE, metadata={**METADATA, "free_edges": "0,1,3"}))
    with pytest.raises(ModelError, match="its free_edges are 3 numbers, 0 to 3, must be 31 that grow from 0 m"):
        PathModel(file)
    file.write_bytes(path_model(FREE, metadata={**METADATA, "offset_ratio": "0"}))
    with pytest.raises(ModelError, match=r"its offset_ratio is 0 and its offset_deviation 0, must be 0\.05 to 2 and 0 to 10 m"):
        PathModel(file)
    with pytest.raises(ModelError, match=r"nowhere\.onnx"):
        PathModel(tmp_path / "nowhere.onnx")


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"lookahead_distance is 9, must be 0.05 to 3"):
        LearnedSettings(lookahead_distance=9.0)
    with pytest.raises(SettingError, match=r"slowdown_probabilities is .*, must be two probabilities, the smaller one first"):
        SpeedSettings(slowdown_probabilities=(0.6, 0.2))


def test_node_poses_integrate_the_recorded_velocities() -> None:
    # A quarter turn to the left in 5 parts of 0.2 m: a circle of radius 2 / pi.
    path = path_of([VIEW[0]] * 6, Velocity(0.4, 0.4 * math.pi / 2.0))
    poses = node_poses(path)
    assert poses is not None
    np.testing.assert_allclose(poses[-1], [2.0 / math.pi, 2.0 / math.pi, math.pi / 2.0], atol=1e-9)


def test_path_without_velocities_has_no_poses() -> None:
    nodes = tuple(PathNode(VIEW, k * STEP_NS, 0.2 * k, ()) for k in range(3))
    assert node_poses(RecordedPath("pinhole", HFOV, nodes)) is None


def test_filter_converges_to_exact_measurements() -> None:
    truth = np.array([0.25, -0.2, 0.15])
    found = PoseFilter()
    found.reset(np.zeros(3))
    for node in (np.array([0.4, 0.0, 0.0]), np.array([0.8, 0.1, 0.2]), np.array([1.2, 0.2, 0.3])) * 3:
        assert found.correct(node, np.array(relative_pose(truth, node)), np.full(3, 0.01))
    np.testing.assert_allclose(found.pose, truth, atol=0.02)


def test_calibration_keeps_underestimated_offsets_from_pulling_the_pose_to_the_path() -> None:
    truth, predicted = np.array([0.0, 0.3, 0.0]), np.array([0.0, 0.25 * 0.3, 0.0])
    poses = []
    for offsets in (OffsetCalibration(), OffsetCalibration(0.25, 0.4)):
        found = PoseFilter(offsets)
        found.reset(np.zeros(3))
        for k in range(60):
            for node in (np.array([0.2, 0.0, 0.0]), np.array([0.6, 0.0, 0.0])):
                assert found.correct(node, np.array(relative_pose(predicted, node)), np.full(3, 0.05), path_pose=np.zeros(3)), k
        poses.append(found.pose)
    assert poses[0][1] == pytest.approx(predicted[1], abs=0.02)
    assert poses[1][1] == pytest.approx(truth[1], abs=0.06)


def test_a_node_behind_a_corner_does_not_push_a_robot_that_is_on_its_path() -> None:
    node, found = np.array([0.6, 0.6, math.pi / 2.0]), PoseFilter(OffsetCalibration(0.25, 0.4))
    found.reset(np.zeros(3))
    for _ in range(20):
        assert found.correct(node, np.array(relative_pose(np.zeros(3), node)), np.full(3, 0.05), path_pose=np.zeros(3))
    np.testing.assert_allclose(found.pose, np.zeros(3), atol=1e-6)


def test_filter_rejects_a_measurement_beyond_its_gate() -> None:
    found = PoseFilter()
    found.reset(np.zeros(3))
    assert not found.correct(np.array([0.5, 0.0, 0.0]), np.array([0.5, 3.0, 0.0]), np.full(3, 0.05))
    np.testing.assert_array_equal(found.pose, np.zeros(3))


def test_column_shift_corrects_the_heading() -> None:
    found = PoseFilter()
    found.reset(np.zeros(3))
    for _ in range(20):
        assert found.correct_heading(np.array([0.2, 0.0, 0.0]), 0.2)
    # A robot that must turn to the left to look as at a node beside which it is not, looks to the right.
    assert found.pose[2] == pytest.approx(-0.2, abs=0.1)
    assert not found.correct_heading(np.array([0.2, 0.0, 0.0]), -2.0)


def test_station_corrects_the_pose_along_the_path_alone() -> None:
    found = PoseFilter()
    found.reset(np.array([0.0, 0.0, math.pi / 2.0]))
    found.correct_station(np.array([0.5, 0.4, math.pi / 2.0]), 0.001)
    np.testing.assert_allclose(found.pose, [0.0, 0.4, math.pi / 2.0], atol=1e-3)


def test_robot_stops_by_itself_behind_the_end_of_the_path(tmp_path: Path) -> None:
    images = [colour(0.0, 0.0, 0.0)] * 6  # every node is where the robot is
    policy = LearnedPolicy(
        path_of(images), model(tmp_path), LearnedSettings(tracking=PoseTrackingSettings(use_column_shift=False))
    )
    policy.act(VIEW, 0, at(5.0))
    policy.tracker.filter.reset(np.array([1.15, 0.0, 0.0]))
    policy.tracker.filter.covariance = np.zeros((3, 3))
    assert policy.act(VIEW, 1, at(5.0)) == STOP


def test_prediction_moves_the_pose_and_adds_variance() -> None:
    found = PoseFilter()
    found.reset(np.array([0.0, 0.0, math.pi / 2.0]))
    before = np.trace(found.covariance)
    found.predict(Step(0.45, 0.0))
    np.testing.assert_allclose(found.pose, [0.0, 0.45, math.pi / 2.0], atol=1e-9)
    assert np.trace(found.covariance) > before


def test_policy_is_localised_while_recorded_images_match(tmp_path: Path) -> None:
    seen = LearnedPolicy(
        path_of([colour(0.2 * k, 0.0, 0.0) for k in range(12)]),
        model(tmp_path),
        LearnedSettings(tracking=PoseTrackingSettings(max_lost_views=3)),
    )
    assert not seen.is_localised
    seen.act(VIEW, 0, at(0.0))
    assert seen.is_localised
    lost = Place(9.0, 0.0, is_lost=True)
    localised = []
    for k in range(1, 5):
        seen.act(VIEW, k * 200_000_000, lost)
        localised.append(seen.is_localised)
    assert localised == [True, True, False, False]
    assert seen.tracker.filter.pose[0] < 0.3  # it does not go where the localiser believes
    assert seen.act(VIEW, 9_000_000_000, lost) == STOP  # the camera was covered meanwhile
    assert not seen.is_localised
    unseen = LearnedPolicy(path_of([np.zeros((64, 96, 3), np.uint8)] * 12), model(tmp_path))
    unseen.act(VIEW, 0, at(0.0))
    assert not unseen.is_localised


@pytest.mark.parametrize("localised", [True, False])
def test_follower_drives_on_where_its_localiser_is_lost_if_the_policy_is_localised(localised: bool) -> None:
    class Driving:
        is_localised = localised

        def reset(self) -> None: ...

        def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
            return AHEAD

    images = np.random.default_rng(0).integers(0, 256, (16, 64, 96, 3), dtype=np.uint8)  # no two are alike
    follower = PathFollower(path_of(list(images[:10])), Driving())
    velocities = [follower.observe(k * 200_000_000, (images[10],)) for k in range(8)]
    assert follower.place is not None
    assert follower.place.is_lost
    assert (velocities[-1] == AHEAD) == localised
    assert (follower.state == "following") == localised


def test_robot_turns_where_the_path_turns_in_place_and_drives_on_behind_that(tmp_path: Path) -> None:
    # 0.6 m ahead, half a turn to the left in nodes of 20 degrees at 1 rad/s, and 0.6 m back. No node is seen: it goes by what it drives.
    turn, turn_ns = math.radians(20.0), round(1e9 * math.radians(20.0))
    parts = [(0.2, AHEAD, STEP_NS)] * 3 + [(0.0, Velocity(0.0, 1.0), turn_ns)] * 9 + [(0.2, AHEAD, STEP_NS)] * 3
    nodes, stamp_ns, distance = [], 0, 0.0
    for length, velocity, duration_ns in [*parts, (0.0, STOP, 0)]:
        nodes.append(PathNode(VIEW, stamp_ns, distance, ((0, velocity),)))
        stamp_ns, distance = stamp_ns + duration_ns, distance + length
    path = RecordedPath("pinhole", HFOV, tuple(nodes))
    tracking = PoseTrackingSettings(use_column_shift=False, max_unmatched_views=1000, max_disagreement=1000.0)
    policy = LearnedPolicy(path, model(tmp_path), LearnedSettings(tracking=tracking))
    step, poses = Step(), []
    for k in range(120):
        velocity = policy.act(VIEW, k * 200_000_000, Place(0.0, 1.0, False, moved=step))
        step = Step(0.2 * velocity.linear, 0.2 * velocity.angular)
        poses.append(policy.tracker.filter.pose.copy())
    at_turn, end = max(poses, key=lambda pose: float(pose[0])), poses[-1]
    assert at_turn[0] == pytest.approx(0.6, abs=0.1)
    assert end[0] == pytest.approx(0.0, abs=0.2)
    assert end[1] == pytest.approx(0.0, abs=0.1)
    assert end[2] == pytest.approx(math.radians(180.0), abs=0.2)
    assert turn * 9 == pytest.approx(math.pi)
