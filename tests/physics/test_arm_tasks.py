"""Tasks of a robot with an arm: pick and place, and the item in the cabinet."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy, transform_points
from gibson_sim.tasks.episode import Episode, Observation, item_root
from gibson_sim.tasks.furnishing import extent, furniture_of, item_centre, item_on_point
from gibson_sim.tasks.ground import Ground, ground_of
from gibson_sim.tasks.kinds.arm_task import RandomArmPolicy
from gibson_sim.tasks.kinds.open_cabinet import CABINET, THING, OpenCabinet, front_of
from gibson_sim.tasks.kinds.pick_and_place import APART, NEAR, PickAndPlace
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun, run_episode
from gibson_sim.tasks.scripts.driving import pose_xy
from gibson_sim.tasks.task import Task
from gibson_sim.types import Pose, Vec3
from gibson_sim_bench.tasks import TaskPlan, measure

BASE, TOOL = "robot/base_footprint", "robot/gripper_link"
FAR: Vec3 = (9.0, 9.0, 2.0)
ARM_TASKS = ("pick-and-place", "open-cabinet-and-fetch")


@pytest.fixture(scope="module")
def arena() -> Ground:
    return ground_of("arena", "arm_bot")


@pytest.fixture(scope="module")
def run() -> Iterator[TaskRun]:
    with TaskRun(PickAndPlace(), step_hz=120) as one:
        yield one


class NearPick(PickAndPlace):
    """Begins where the arm reaches the item."""

    def generate(self, seed: int, ground: Ground) -> Episode:
        return _near(super().generate(seed, ground))


class NearCabinet(OpenCabinet):
    """Begins before the cabinet."""

    def generate(self, seed: int, ground: Ground) -> Episode:
        return _near(super().generate(seed, ground))


def _near(episode: Episode) -> Episode:
    there = furniture_of(episode.items[0])
    return replace(episode, start=pose_from_xyz_rpy((*there.stand, 0.0), (0.0, 0.0, there.yaw)))


def _observation(
    episode: Episode, thing: Pose, tool: Vec3, *, held: str = "", speed: float = 0.0, opening: float = 0.0
) -> Observation:
    """Item, hand and drawer or door at given positions."""
    item = episode.items[-1]
    links = {item_root(one): one.pose for one in episode.items}
    links |= {item_root(item): thing, TOOL: Pose(tool), BASE: episode.start}
    if isinstance(task_of(episode.task), OpenCabinet):
        front = front_of(episode)
        x, y, z = (0.177, front.side * 0.4, front.low)
        place = episode.items[0].pose
        x += opening if front.slides else 0.0
        position = transform_points(matrix_from_pose(place), np.array([(x, y, z)]))[0]
        yaw = furniture_of(episode.items[0]).yaw + math.pi + (0.0 if front.slides else front.side * opening)
        links[f"{CABINET}/{front.link}"] = pose_from_xyz_rpy((position[0], position[1], position[2]), (0.0, 0.0, yaw))
    return Observation(1.0, links, BASE, held=held, speeds={item_root(item): speed})


@pytest.mark.parametrize("name", ARM_TASKS)
def test_equal_seeds_give_equal_episodes_and_others_differ(arena: Ground, name: str) -> None:
    task = task_of(name)
    assert task.generate(3, arena) == task.generate(3, arena)
    assert task.generate(3, arena) != task.generate(5, arena)


@pytest.mark.parametrize("name", ARM_TASKS)
def test_no_episode_starts_solved_or_with_intersecting_furniture(arena: Ground, name: str) -> None:
    task = task_of(name)
    for seed in range(3):
        episode = task.generate(seed, arena)
        obs = _observation(episode, episode.items[-1].pose, FAR)
        assert not task.succeeded(episode, obs, arena)
        assert task.remaining(episode, obs, arena) > 1.0
        furniture = [furniture_of(item) for item in episode.items[:-1]]
        space = arena.space.with_obstacles([one.outline() for one in furniture])
        for one in furniture:
            assert (arena.floor.clearance(one.outline()) > 0.0).all()
            assert space.connected(pose_xy(episode.start), one.stand)


def test_even_seeds_are_drawers_and_odd_ones_doors(arena: Ground) -> None:
    task = OpenCabinet()
    fronts = [front_of(task.generate(seed, arena)) for seed in range(6)]
    assert [front.slides for front in fronts] == [True, False] * 3
    assert len({front.link for front in fronts}) > 2


def test_object_in_a_drawer_or_on_a_shelf_is_behind_the_closed_front(arena: Ground) -> None:
    task = OpenCabinet()
    for seed in range(4):
        episode = task.generate(seed, arena)
        obs = _observation(episode, episode.items[1].pose, FAR)
        front = front_of(episode)
        assert front.opening(obs) == pytest.approx(0.0, abs=1e-9)
        assert front.clearance(obs, episode.items[1]) == 0.0


def test_a_room_without_space_for_the_task_is_refused(arena: Ground) -> None:
    rows, columns = np.indices(arena.floor.shape)
    # 1.2 x 1.2 m of floor are left.
    small = replace(arena.floor, occupied=arena.floor.occupied | (rows > 26) | (columns > 26))
    for name, words in (
        ("pick-and-place", "no wall has room for a table"),
        ("open-cabinet-and-fetch", "no wall has room for a cabinet"),
    ):
        with pytest.raises(SceneError, match=f"task {name}: scene 'arena' has no room for it: {words}"):
            task_of(name).generate(0, replace(arena, floor=small))


@pytest.mark.parametrize("name", ARM_TASKS)
def test_a_robot_without_an_arm_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="has no arm with a gripper; choose a robot that has one, such as arm_bot"):
        task_of(name).generate(0, ground_of("arena", "gibson_bot"))


@pytest.mark.parametrize(
    ("offset", "tool", "held", "speed", "done"),
    [
        (0.029, 0.2, "", 0.0, True),
        (0.031, 0.2, "", 0.0, False),
        (0.0, 0.2, "thing", 0.0, False),
        (0.0, 0.2, "", 0.05, False),
        (0.0, 0.05, "", 0.0, False),
    ],
    ids=["near", "too far", "held", "moving", "hand at it"],
)
def test_an_object_is_placed_once_it_rests_within_3_cm_and_is_released(
    arena: Ground, offset: float, tool: float, held: str, speed: float, done: bool
) -> None:
    task = PickAndPlace()
    episode = task.generate(0, arena)
    thing = episode.items[-1]
    assert episode.goal.position is not None
    x, y, z = episode.goal.position
    there = item_on_point("thing", thing.model, (x + offset, y, z), 0.5).pose
    obs = _observation(episode, there, FAR, held=held, speed=speed)
    mx, my, mz = item_centre(thing, obs)
    obs = replace(obs, links={**obs.links, TOOL: Pose((mx, my, mz + tool))})
    assert task.succeeded(episode, obs, arena) == done
    if offset <= NEAR:
        assert task.remaining(episode, obs, arena) == pytest.approx(offset, abs=1e-6)


def test_pick_and_place_positions_are_apart_and_on_surfaces(arena: Ground) -> None:
    task = PickAndPlace()
    for seed in (0, 1, 2, 3, 200):  # in the last one, no other item is on the small table of the first place that is drawn
        episode = task.generate(seed, arena)
        thing, goal = episode.items[-1], episode.goal.position
        assert goal is not None
        low, _ = extent(thing.model)
        x, y, z = thing.pose.position
        assert math.dist((x, y, z + low[2]), goal) >= APART
        assert goal[2] in [pytest.approx(extent(item.model)[1][2]) for item in episode.items[:-1]]


@pytest.mark.parametrize("seed", [0, 1], ids=["drawer", "door"])
def test_an_object_is_fetched_once_it_is_held_outside_and_the_front_is_open(arena: Ground, seed: int) -> None:
    task = OpenCabinet()
    episode = task.generate(seed, arena)
    cabinet, enough = furniture_of(episode.items[0]), front_of(episode).enough
    outside = item_on_point(THING, episode.items[1].model, cabinet.point(0.8, 0.0, 0.5), 0.0).pose
    near = item_on_point(THING, episode.items[1].model, cabinet.point(0.30, 0.0, 0.5), 0.0).pose
    for thing, held, opening, done in (
        (outside, THING, enough + 0.01, True),
        (outside, "", enough + 0.01, False),
        (outside, THING, enough - 0.01, False),
        (near, THING, enough + 0.01, False),
    ):
        obs = _observation(episode, thing, thing.position, held=held, opening=opening)
        assert front_of(episode).opening(obs) == pytest.approx(opening)
        assert task.succeeded(episode, obs, arena) == done
        assert (task.remaining(episode, obs, arena) == 0.0) == done


def test_random_arm_policy_moves_arm_and_gripper_within_limits(arena: Ground) -> None:
    episode = PickAndPlace().generate(0, arena)
    policy = PickAndPlace().policy("random", episode, arena)
    assert isinstance(policy, RandomArmPolicy)
    obs = _observation(episode, episode.items[-1].pose, FAR)
    actions = [policy.act(replace(obs, time=float(time))) for time in range(0, 40, 3)]
    assert {action.grasp for action in actions} == {True, False}
    assert all(-1.221 <= action.joints["shoulder_lift_joint"] <= 1.518 for action in actions)
    assert len({action.joints["elbow_flex_joint"] for action in actions}) == len(actions)


@pytest.mark.parametrize(("task", "seed"), [(NearPick(), 30), (NearCabinet(), 35)], ids=["pick and place", "cabinet door"])
def test_the_script_succeeds_without_collisions(run: TaskRun, task: Task, seed: int) -> None:
    run.task = task
    found = run_episode(run, seed, "scripted")
    assert found.success and found.collisions == 0
    assert found.goal_distance < NEAR / 2.0


def test_tasks_with_an_arm_can_be_measured() -> None:
    (row,) = measure(TaskPlan(("pick-and-place",), ("state",), (1,), steps=2, loose_scene="")).rows
    assert (row.task, row.scene) == ("pick-and-place", "arena")
    assert row.steps_per_s > 0.0


def test_the_environment_of_a_task_with_an_arm_passes_the_check_of_gymnasium() -> None:
    try:
        from gymnasium.utils.env_checker import check_env

        from gibson_sim.tasks.environments import TaskEnvironment
    except ImportError:
        message = "SKIPPED: Gymnasium is not installed: pip install 'gibson_sim[gym]'"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    environment = TaskEnvironment("pick-and-place")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment, skip_render_check=True)
    environment.close()
