"""Episodes of tasks, their metrics and their observations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.robots.load import load_robot
from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.episode import Episode, Goal, Item, Observation, item_root, observation_of
from gibson_sim.tasks.ground import Ground, footprint, ground_of
from gibson_sim.tasks.kinds.open_door import JAMBS, WALL_X
from gibson_sim.tasks.metrics import Meter, episode_values, summary, touched_by, wilson
from gibson_sim.tasks.observing import CLASSES, FARTHEST, SCAN_RANGE, ObservationLayout, full_state, own_state
from gibson_sim.tasks.registry import TASKS, check_baseline, task_of
from gibson_sim.tasks.scripts.arm import drive
from gibson_sim.tasks.scripts.driving import Driver
from gibson_sim.types import Contact, Pose, SceneState

BASE = "robot/base_footprint"
BASE_TASKS = ("point-goal", "push-through", "object-search")


@pytest.fixture(scope="module")
def arena() -> Ground:
    return ground_of("arena", "gibson_bot")


def _observation(
    episode: Episode | None = None, time: float = 0.0, xyyaw: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Observation:
    """Items at their initial poses, the base at ``xyyaw``."""
    links = {item_root(item): item.pose for item in (episode.items if episode else ())}
    links[BASE] = pose_from_xyz_rpy((xyyaw[0], xyyaw[1], 0.0), (0.0, 0.0, xyyaw[2]))
    return Observation(time, links, BASE)


@pytest.mark.parametrize("name", BASE_TASKS)
def test_equal_seeds_give_equal_episodes_and_others_differ(arena: Ground, name: str) -> None:
    task = task_of(name)
    assert task.generate(7, arena) == task.generate(7, arena)
    assert task.generate(7, arena) != task.generate(8, arena)


@pytest.mark.parametrize("name", BASE_TASKS)
def test_no_episode_starts_at_its_goal_or_with_the_robot_in_collision(arena: Ground, name: str) -> None:
    task = task_of(name)
    for seed in range(2):
        episode = task.generate(seed, arena)
        x, y, _ = episode.start.position
        obs = replace(_observation(episode), links={**_observation(episode).links, BASE: episode.start})
        assert not task.succeeded(episode, obs, arena)
        assert task.remaining(episode, obs, arena) > episode.goal.radius
        assert arena.floor.clearance((x, y)) >= arena.robot.radius
        assert 0.0 < episode.shortest < 20.0


def test_boxes_of_push_through_block_the_only_path(arena: Ground) -> None:
    for seed in range(2):
        episode = task_of("push-through").generate(seed, arena)
        assert episode.goal.position is not None
        start, goal = episode.start.position[:2], episode.goal.position[:2]
        assert arena.space.planner.path(start, goal)[-1] == pytest.approx(goal)
        assert not arena.space.with_obstacles([footprint(item.model, item.pose) for item in episode.items]).connected(start, goal)


def test_policy_that_does_not_push_stops_before_the_boxes(arena: Ground) -> None:
    task = task_of("push-through")
    episode = task.generate(0, arena)
    careful = task.policy("careful", episode, arena)
    obs = replace(_observation(episode), links={**_observation(episode).links, BASE: episode.start})
    action = careful.act(obs)
    assert (action.linear, action.angular) == (0.0, 0.0)
    assert isinstance(careful, Driver) and careful.blocked
    # A script that does not wait for a way gives up there.
    with pytest.raises(StopIteration):
        next(drive(obs, careful, waits=False))
    assert next(drive(obs, careful)).linear == 0.0


def test_target_of_object_search_is_hidden_at_first_and_its_position_is_not_given(arena: Ground) -> None:
    task = task_of("object-search")
    for seed in range(2):
        episode = task.generate(seed, arena)
        target = episode.items[0]
        assert episode.goal.target == target.name and episode.goal.position is None
        assert not arena.sees(episode.start, [target.pose.position[:2]])[0]
        assert sum(item.model == target.model for item in episode.items) == 1


def test_an_object_is_found_only_within_a_metre_and_in_view(arena: Ground) -> None:
    item = Item("thing_1", "ball", Pose((2.0, 2.2, 0.0)))
    episode = Episode("object-search", 0, Pose(), (item,), Goal("", None, 1.0, "thing_1", "ball"), 1.0, 60.0)
    task = task_of("object-search")
    assert task.succeeded(episode, _observation(episode, xyyaw=(1.1, 2.2, 0.0)), arena)
    assert not task.succeeded(episode, _observation(episode, xyyaw=(0.9, 2.2, 0.0)), arena)
    assert not task.succeeded(episode, _observation(episode, xyyaw=(1.1, 2.2, math.pi)), arena)


def test_walls_hide_objects(arena: Ground) -> None:
    base = pose_from_xyz_rpy((3.6, 1.0, 0.0), (0.0, 0.0, 0.0))
    assert arena.sees(base, [(4.0, 1.0), (4.9, 1.0)]).tolist() == [True, False]


def test_the_outline_of_a_turned_box_is_turned() -> None:
    # box_cardboard: 0.30 x 0.40 m.
    corners = footprint("box_cardboard", pose_from_xyz_rpy((1.0, 2.0, 0.0), (0.0, 0.0, math.pi / 2)))
    assert corners.min(axis=0) == pytest.approx((0.8, 1.85))
    assert corners.max(axis=0) == pytest.approx((1.2, 2.15))


def test_an_item_is_an_outline_that_paths_lead_around(arena: Ground) -> None:
    box = footprint("box_cardboard", Pose((2.0, 2.2, 0.0)))
    straight = arena.space.planner.path((1.0, 2.2), (3.0, 2.2))
    round_it = arena.space.with_obstacles([box]).planner.path((1.0, 2.2), (3.0, 2.2))
    assert len(straight) == 2 and len(round_it) > 2
    assert np.abs(round_it[:, 1] - 2.2).max() >= 0.2 + arena.robot.radius - 0.05


def test_metrics_of_a_made_up_drive() -> None:
    item = Item("box_1", "box_small", Pose((3.0, 0.0, 0.0)))
    episode = Episode("t", 0, Pose(), (item,), Goal("", (2.0, 0.0, 0.0), 0.1), 2.0, 60.0)
    meter = Meter(episode, _observation(episode))
    meter.update(_observation(episode, 1.0, (1.0, 0.0, 0.0)), ())
    meter.update(_observation(episode, 2.0, (1.0, 1.0, 0.0)), ("wall",))
    meter.update(_observation(episode, 3.0, (1.0, 1.0, 0.0)), ("wall",))  # still the same collision
    end = _observation(episode, 4.0, (2.0, 1.0, 0.0))
    end = replace(end, links={**end.links, item_root(item): Pose((3.3, 0.4, 0.0))})
    meter.update(end, ("wall", "sofa"))
    found = meter.metrics(end, success=True, goal_distance=0.5)
    assert (found.path_length, found.spl, found.collisions) == (pytest.approx(3.0), pytest.approx(2.0 / 3.0), 2)
    assert (found.pushed, found.pushed_distance, found.time) == (1, pytest.approx(0.5), 4.0)
    assert meter.metrics(end, success=False, goal_distance=0.5).spl == 0.0


def test_the_floor_and_pushable_objects_are_no_collisions() -> None:
    def contact(body: str, normal: tuple[float, float, float], force: float = 5.0) -> Contact:
        return Contact("robot", "base", body, "", (0.0, 0.0, 0.0), normal, force)

    contacts = [contact("floor", (0.0, 0.0, 1.0)), contact("box_1", (1.0, 0.0, 0.0)), contact("wall", (0.0, 1.0, 0.0))]
    contacts += [contact("near", (1.0, 0.0, 0.0), 0.0), replace(contact("sofa", (1.0, 0.0, 0.0)), body_a="other")]
    assert touched_by("robot", contacts, {"robot", "box_1"}) == {"wall"}


def test_the_interval_of_a_rate_is_wilsons() -> None:
    # Newcombe 1998, table I: 81 of 263 gives 0.2553 to 0.3662.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)
    assert episode_values(summary([]))["spl"] is None


def test_velocities_of_a_view_are_those_of_the_base() -> None:
    quat = pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)).quat_xyzw
    twist = np.array([[0.0, 0.4, 0.0, 0.0, 0.0, 0.7]])
    state = SceneState(3_000_000_000, 720, 1, (BASE,), np.array([[1.0, 2.0, 0.0]]), np.array([quat]), twist)
    obs = observation_of(state, "robot", "base_footprint", 1_000_000_000)
    assert (obs.time, obs.linear, obs.angular) == (2.0, pytest.approx(0.4), pytest.approx(0.7))
    assert obs.in_base((1.0, 5.0)) == pytest.approx((3.0, 0.0))
    assert obs.in_base((0.0, 2.0)) == pytest.approx((0.0, 1.0))


def test_observations_stay_within_their_bounds_and_have_the_goal_first() -> None:
    item = Item("a", "ball", Pose((1.0, 2.0, 0.1)))
    episode = Episode("t", 0, Pose(), (item,), Goal("", (100.0, -3.0, 0.0), 0.1, "a", "ball"), 2.0, 60.0)
    layout = ObservationLayout((), (), ())
    obs = _observation(episode)

    def rays(origins: np.ndarray, directions: np.ndarray, longest: float) -> np.ndarray:
        return np.full(len(origins), np.inf)

    state = full_state(layout, episode, obs, ("ball",), rays, (0.6, 0.8))
    low, high = layout.state()
    assert state.shape == low.shape and (state >= low).all() and (state <= high).all()
    assert state[:2].tolist() == [FARTHEST, -3.0]
    own = own_state(layout, episode, obs)
    assert own[5 + CLASSES.index("ball")] == 1.0 and own[5:].sum() == 1.0
    assert state[len(own) : len(own) + 2].tolist() == pytest.approx([0.6, 0.8]), "the robot looks along x"
    assert set(state[len(own) + 2 : len(own) + 34].tolist()) == {SCAN_RANGE}
    assert state[len(own) + 34 :][:5].tolist() == pytest.approx([1.0, 1.0, 2.0, 0.1, CLASSES.index("ball") + 1.0])


def test_actions_are_fractions_of_the_maximum_velocity(arena: Ground) -> None:
    controls = Controls(arena.robot, 0.1)
    action = controls.action([0.5, -3.0], _observation())
    assert (action.linear, action.angular) == (0.25, -2.0)
    with pytest.raises(Exception, match="finite numbers"):
        controls.action([math.nan, 0.0], _observation())


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"'fly' is unknown; known: point-goal"):
        task_of("fly")
    with pytest.raises(ConfigError, match="baseline 'careful' is unknown; known: scripted, random, none"):
        check_baseline(task_of("point-goal"), "careful")


def test_a_scene_without_doors_has_no_room_for_push_through(arena: Ground) -> None:
    one_room = Ground(arena.scene, arena.robot, arena.floor)
    one_room.__dict__["doors"] = ()
    with pytest.raises(SceneError, match="choose another scene"):
        task_of("push-through").generate(0, one_room)


def test_doors_hang_in_the_doorway_and_open_towards_the_robot(arena: Ground) -> None:
    task, sides = TASKS["open-door"], set()
    for seed in range(12):
        episode = task.generate(seed, arena)
        (door,) = episode.items
        x, y, _ = door.pose.position
        before = math.copysign(1.0, episode.start.position[0] - WALL_X)
        assert x == WALL_X and min(abs(y - jamb) for jamb in JAMBS) == pytest.approx(0.022)
        # docs/objects.md: a left door opens to +y of its own frame, a right one to -y.
        yaw = 2.0 * math.atan2(door.pose.quat_xyzw[2], door.pose.quat_xyzw[3])
        sign = 1.0 if door.model.endswith("left") else -1.0
        assert sign * -math.sin(yaw) * before > 0.9
        sides.add((before, door.model))
    assert len(sides) == 4


def test_arm_actions_are_joint_position_steps_and_a_grasp_command() -> None:
    controls = Controls(load_robot("arm_bot"), 0.1)
    assert controls.size == 2 + 7 + 1
    lower, upper = controls.layout.lower[1], controls.layout.upper[1]
    obs = Observation(0.0, {BASE: Pose()}, BASE, joints=dict.fromkeys(controls.layout.joints, upper - 0.15))
    controls.begin(obs)
    action = [0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    first, second = controls.action(action, obs), controls.action(action, obs)
    pan, lift = controls.layout.joints[:2]
    assert first.joints[pan] == pytest.approx(upper - 0.15 - 0.1) and first.joints[lift] == pytest.approx(upper - 0.05)
    assert second.joints[lift] == upper > lower
    assert first.grasp is True and controls.action([0.0] * 10, obs).grasp is False
