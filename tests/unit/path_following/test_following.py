"""A place is found by images, recorded velocities are repeated, and the robot stops whenever it cannot rely on either."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.images.lens import ZoomEstimate
from gibson_path_following.localisation.localiser import Localiser, LocaliserSettings, NodeMatcher
from gibson_path_following.localisation.motion_model import MotionModel
from gibson_path_following.localisation.motions import CommandLog, Motion, motion_between, segments
from gibson_path_following.policies.follower import FollowerSettings, PathFollower
from gibson_path_following.policies.teach_repeat import TeachRepeatPolicy, TeachRepeatSettings
from gibson_path_following.types import STOP, PathNode, Place, RecordedPath, Velocity, View
from support.path_views import STEP_NS, fisheye_view, pinhole_view, straight_path

DEG = math.pi / 180.0
AHEAD = Velocity(0.4, 0.0)
NODE = Motion(0.2, 0.0, 0.5)
"""What is driven from one node to the next."""


def test_motions_are_integrals_of_what_was_commanded() -> None:
    sent = [(1_000_000_000, Velocity(0.4, 0.2)), (2_000_000_000, STOP), (3_000_000_000, Velocity(0.0, -1.0))]
    found = motion_between(sent, 500_000_000, 3_500_000_000)
    assert (found.distance, found.turn, found.duration) == pytest.approx((0.4, 0.2 - 0.5, 1.5))
    log = CommandLog()
    for stamp, velocity in sent:
        log.add(stamp, velocity)
    assert log.motion(500_000_000, 3_500_000_000) == found
    log.add(3_000_000_000, STOP)  # replaces what did not take effect
    assert log.motion(500_000_000, 3_500_000_000).turn == pytest.approx(0.2)


def test_motion_is_unknown_before_a_command_has_come() -> None:
    log = CommandLog()
    assert log.known_motion(0, 1_000_000_000) is None
    log.add(2_000_000_000, Velocity(0.4, 0.0))
    assert log.known_motion(0, 1_000_000_000) is None, "on another clock, as of a bag, commands say nothing either"
    assert log.known_motion(1_000_000_000, 3_000_000_000) == Motion(0.4, 0.0, 1.0)


def test_segments_are_as_long_as_odometry_says_and_turn_as_was_driven() -> None:
    assert segments(straight_path(3, angular=0.5)) == (
        Motion(pytest.approx(0.2), pytest.approx(0.25), 0.5),
        Motion(pytest.approx(0.2), pytest.approx(0.25), 0.5),
    )


def test_a_place_between_two_nodes_is_found_without_any_command() -> None:
    localiser = Localiser(straight_path())
    for _ in range(2):
        found = localiser.update(pinhole_view(6.5, 4.0 * DEG, gain=0.5))
    assert found.index == pytest.approx(6.5, abs=0.5)
    assert found.confidence > 0.8 and not found.is_lost


def test_on_a_path_of_images_alone_commands_do_not_hold_the_place() -> None:
    nodes = tuple(PathNode(node.view, node.stamp_ns, 0.0, ()) for node in straight_path().nodes)
    localiser = Localiser(RecordedPath("pinhole", straight_path().hfov, nodes))
    for index in range(10):
        found = localiser.update(pinhole_view(index), NODE)
    assert found.index == pytest.approx(9.0, abs=0.4) and not found.is_lost


def test_the_belief_moves_with_the_commands_and_images_correct_what_slips() -> None:
    localiser = Localiser(straight_path())
    localiser.reset(0.0)
    for step in range(12):
        found = localiser.update(pinhole_view(0.6 * step), NODE)  # 0.6 nodes, though one was commanded
    assert found.index == pytest.approx(0.6 * 11, abs=0.4)


def test_motion_carries_no_belief_to_the_ends_of_the_path_but_from_beside_them() -> None:
    localiser = Localiser(straight_path(), LocaliserSettings(score_gain=0.1))  # images say nothing
    localiser.reset(5.0, 0.3)
    localiser.update(pinhole_view(5.0), NODE)
    assert localiser.belief[-4:].sum() < 0.01 and localiser.belief[:4].sum() < 0.01
    localiser.reset(10.8, 0.3)
    for _ in range(4):
        localiser.update(pinhole_view(11.0), NODE)
    assert localiser.belief[-2:].sum() > 0.8


def test_a_robot_that_stands_stays_where_it_is_although_an_image_fits_elsewhere() -> None:
    localiser = Localiser(straight_path())
    localiser.reset(2.0)
    for _ in range(4):
        localiser.update(pinhole_view(2.0), Motion(0.0, 0.0, 0.0))
    assert localiser.update(pinhole_view(9.0), Motion(0.0, 0.0, 0.0)).index == pytest.approx(2.0, abs=0.6)


def test_images_of_another_place_make_it_lost_and_those_of_the_path_make_it_found() -> None:
    localiser = Localiser(straight_path())
    localiser.reset(3.0)
    for _ in range(3):
        assert localiser.update(pinhole_view(3.0), Motion(0.0, 0.0, 0.0)).index == pytest.approx(3.0, abs=0.3)
    foreign = [localiser.update(pinhole_view(1000 + i), NODE).is_lost for i in range(6)]
    assert foreign[0] is False and foreign[-1] is True
    found = [localiser.update(pinhole_view(8.0), NODE if i == 0 else Motion(0.0, 0.0, 0.0)) for i in range(5)]
    assert not found[-1].is_lost and found[-1].index == pytest.approx(8.0, abs=0.4)


def test_a_path_of_two_fisheyes_is_localised_with_a_robot_that_looks_aside() -> None:
    nodes = tuple(PathNode(fisheye_view(i), i * STEP_NS, 0.2 * i, ((0, Velocity(0.4)),)) for i in range(5))
    localiser = Localiser(RecordedPath("fisheye_pair", math.pi, nodes))
    for _ in range(2):
        found = localiser.update(fisheye_view(3, 25.0 * DEG))
    assert found.index == pytest.approx(3.0, abs=0.4)


def test_recorded_velocities_are_repeated_where_the_heading_is_right() -> None:
    policy = TeachRepeatPolicy(straight_path(angular=0.0))
    found = policy.act(pinhole_view(4.0), 0, Place(4.0, 1.0, False))
    assert found.linear == pytest.approx(0.4, abs=0.01)
    assert found.angular == pytest.approx(0.0, abs=0.02)


def test_a_robot_that_looks_to_the_left_is_turned_to_the_right() -> None:
    settings = TeachRepeatSettings(heading_gain=1.5, nodes_ahead=0)
    policy = TeachRepeatPolicy(straight_path(), settings)
    place = Place(4.0, 1.0, False)
    assert policy.heading_error(pinhole_view(4.0, 10.0 * DEG), place) == pytest.approx(-10.0 * DEG, abs=0.6 * DEG)
    found = policy.act(pinhole_view(4.0, 10.0 * DEG), 0, place)
    assert found.angular == pytest.approx(-1.5 * 10.0 * DEG, abs=0.02)
    assert 0.0 < found.linear < 0.4


def test_follower_slows_down_while_an_image_does_not_match() -> None:
    policy = TeachRepeatPolicy(straight_path())
    found = policy.act(pinhole_view(4.0), 0, Place(4.0, 0.0, False))
    assert found.linear == pytest.approx(0.2, abs=0.01)


def test_turns_of_the_path_are_driven_and_are_no_heading_error() -> None:
    # 0.2 rad/s for 0.5 s: each node looks 0.1 rad further to the left, which a view of the node before shows as well.
    path = straight_path(angular=0.2)
    nodes = tuple(
        PathNode(pinhole_view(0.0, 0.1 * i), node.stamp_ns, node.distance, node.velocities) for i, node in enumerate(path.nodes)
    )
    policy = TeachRepeatPolicy(RecordedPath(path.camera, path.hfov, nodes))
    assert policy.heading_error(nodes[4].view, Place(4.0, 1.0, False)) == pytest.approx(0.0, abs=0.01)
    assert policy.act(nodes[4].view, 0, Place(4.0, 1.0, False)).angular == pytest.approx(0.2, abs=0.02)


class Recorded:
    """A policy that notes what it is called with."""

    def __init__(self, velocity: Velocity) -> None:
        self.velocity, self.places, self.resets = velocity, list[Place](), 0

    def reset(self) -> None:
        self.resets += 1

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        self.places.append(place)
        return self.velocity


def _follower(velocity: Velocity = AHEAD, **settings: float) -> tuple[PathFollower, Recorded]:
    policy = Recorded(velocity)
    return PathFollower(straight_path(), policy, FollowerSettings(**settings)), policy


def _found(follower: PathFollower, views: int = 2) -> int:
    """Shows some nodes from the first on; returns the stamp of the last."""
    for i in range(views):
        follower.observe(i * STEP_NS, pinhole_view(i))
    return (views - 1) * STEP_NS


def test_a_path_is_followed_to_its_end_and_the_robot_stays_there() -> None:
    follower, policy = _follower()
    assert follower.state == "waiting" and follower.tick(0) == STOP and follower.state == "waiting"
    states = []
    for i in range(14):
        place = min(i, 11)
        follower.observe(i * STEP_NS, pinhole_view(place))
        states.append(follower.state)
    assert states[0] == "localising" and set(states[1:11]) == {"following"} and states[-1] == "finished"
    assert follower.tick(100 * STEP_NS) == STOP and follower.state == "finished"
    assert follower.observe(101 * STEP_NS, pinhole_view(3)) == STOP
    assert policy.places[5].index == pytest.approx(6.0, abs=0.4)  # of the seventh view: it was lost at the first
    follower.reset()
    assert follower.state == "waiting" and policy.resets == 2


def test_follower_stops_when_images_are_too_old_and_resumes_with_new_ones() -> None:
    follower, _ = _follower(stale_after=0.5)
    last = _found(follower)
    assert follower.tick(last + 500_000_000) == Velocity(0.4, 0.0)
    assert follower.tick(last + 500_000_001) == STOP and follower.state == "stale"
    assert follower.observe(last + 600_000_000, pinhole_view(1)) == Velocity(0.4, 0.0)
    assert follower.state == "following"


def test_follower_stops_at_images_from_the_future_and_when_images_cease() -> None:
    follower, _ = _follower(stale_after=0.5)
    last = _found(follower)
    assert follower.tick(last - 500_000_001) == STOP and follower.state == "stale"
    arrived = last + 200_000_000
    follower.observe(arrived + 400_000_000, pinhole_view(1), arrived)
    assert follower.tick(arrived + 500_000_000) == Velocity(0.4, 0.0)
    assert follower.tick(arrived + 500_000_001) == STOP and follower.state == "stale"


def test_follower_stops_at_a_covered_lens_and_resumes_afterwards() -> None:
    follower, policy = _follower()
    last = _found(follower, 4)
    calls = len(policy.places)
    for i in range(1, 16):
        assert follower.observe(last + i * 200_000_000, (np.full((64, 96, 3), 9, dtype=np.uint8),)) == STOP
        assert follower.tick(last + i * 200_000_000) == STOP and follower.state == "lost"
    assert len(policy.places) == calls
    assert follower.observe(last + 16 * 200_000_000, pinhole_view(3)) == Velocity(0.4, 0.0)
    assert policy.places[-1].index == pytest.approx(3.0, abs=0.5)


def test_follower_stops_while_it_is_lost() -> None:
    follower, _ = _follower(search=False)
    last = _found(follower, 4)
    for i in range(8):
        velocity = follower.observe(last + (i + 1) * STEP_NS, pinhole_view(2000 + i))
    assert velocity == STOP and follower.state == "lost"


def test_a_robot_that_stands_elsewhere_at_the_start_is_lost_after_a_while() -> None:
    follower, _ = _follower(search_after=1.0, search=False)
    states = []
    for i in range(8):
        follower.observe(i * 200_000_000, pinhole_view(2000 + i))
        states.append(follower.state)
    assert states == 5 * ["localising"] + 3 * ["lost"]


def test_a_robot_that_is_lost_looks_to_both_sides_once_and_then_stands() -> None:
    follower, _ = _follower(search_after=1.0)
    stamp = _found(follower, 4)
    yaw, turned, states = 0.0, [0.0], list[str]()
    for _ in range(220):
        stamp += 200_000_000
        velocity = follower.observe(stamp, pinhole_view(2000, yaw))
        if states and states[-1] != "following":
            assert velocity.linear == 0.0
        yaw += 0.2 * velocity.angular
        turned.append(yaw)
        states.append(follower.state)
    assert states[-1] == "lost" and velocity == STOP and "searching" in states
    start = turned[states.index("searching")]
    assert max(turned) - start == pytest.approx(60.0 * DEG, abs=8.0 * DEG)
    assert min(turned) - start == pytest.approx(-60.0 * DEG, abs=8.0 * DEG)


def test_a_place_that_looks_like_this_one_does_not_move_a_robot_that_is_not_lost() -> None:
    localiser = Localiser(straight_path())
    localiser.reset(1.0)
    for _ in range(3):
        localiser.update(pinhole_view(1.0), Motion(0.0, 0.0, 0.0))
    found = localiser.update(pinhole_view(10.0), NODE)
    assert found.index < 4.0 and found.confidence == 0.0 and not found.is_lost


def test_latency_and_turns_are_learned_from_what_is_seen() -> None:
    model, log, step_ns = MotionModel(), CommandLog(), 200_000_000
    rng = np.random.default_rng(3)
    sent = [0.0, 0.0, *rng.uniform(-0.6, 0.6, 40).tolist()]
    for k, rate in enumerate(sent):
        log.add(k * step_ns, Velocity(0.4, rate))
        if k >= 2:  # what is seen from k - 1 to k was commanded two views earlier; of it, 80 % are made
            commanded = sent[k - 3] if k >= 3 else 0.0
            model.learn(log, (k - 1) * step_ns, k * step_ns, 0.8 * 0.2 * commanded)
    assert model.latency == pytest.approx(0.4)
    assert model.turn_ratio == pytest.approx(0.8, abs=0.03)
    pending = model.pending(log, len(sent) * step_ns, 0.5)
    assert pending.distance == pytest.approx(0.5 * 0.4 * 0.4)
    assert pending.turn == pytest.approx(0.8 * 0.2 * (sent[-1] + sent[-2]), abs=0.02)


def test_the_zoom_at_which_views_fit_best_is_learned_and_a_first_view_says_little() -> None:
    lens = ZoomEstimate()
    scores = 0.6 - 8.0 * (ZoomEstimate.LOG_ZOOMS - 0.06) ** 2
    lens.add(scores, 1.0)
    assert 1.0 < lens.zoom < math.exp(0.05)  # 8 (z - 0.06)^2 + 3 z^2 is least at 0.48 / 11
    assert not lens.is_settled
    for _ in range(60):
        lens.add(scores, 1.0)
    assert lens.is_settled and lens.zoom == pytest.approx(math.exp(0.06), abs=0.005)


def test_old_images_change_nothing_and_impossible_velocities_are_limited() -> None:
    follower, policy = _follower(Velocity(3.0, -9.0))
    last = _found(follower)
    assert follower.tick(last) == Velocity(0.5, -1.0)
    calls = len(policy.places)
    assert follower.observe(last, pinhole_view(5)) == Velocity(0.5, -1.0)
    assert len(policy.places) == calls
    policy.velocity = Velocity(math.nan, 0.0)
    assert follower.observe(last + STEP_NS, pinhole_view(2)) == STOP


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(SettingError, match=r"stale_after is 0, must be 0\.01 to 60"):
        FollowerSettings(stale_after=0.0)
    with pytest.raises(SettingError, match=r"start is -1, must be a node"):
        FollowerSettings(start=-1.0)
    with pytest.raises(SettingError, match=r"score_gain is nan"):
        LocaliserSettings(score_gain=math.nan)
    with pytest.raises(SettingError, match=r"heading_gain is -1, must be 0 to 20"):
        TeachRepeatSettings(heading_gain=-1.0)


def test_limits_of_scores_are_lower_for_a_camera_that_sees_all_around() -> None:
    nodes = tuple(PathNode(fisheye_view(i), i * STEP_NS, 0.2 * i, ()) for i in range(2))
    assert NodeMatcher(straight_path(2)).score_scale == pytest.approx(1.0, abs=0.01)
    assert NodeMatcher(RecordedPath("fisheye_pair", math.pi, nodes)).score_scale == pytest.approx(math.sqrt(100.0 / 360.0))
