"""Environments of a task as one vector: episodes follow each other as learners expect, in processes that end with it."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv

from gibson_sim.errors import ConfigError
from gibson_sim.robots.load import load_robot
from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.environments import TaskEnvironment, in_processes
from gibson_sim.tasks.episode import Observation

# A step of a second: an episode of 90 s ends after 90 steps of a robot that stands still.
OPTIONS = {"scene": "arena", "control_hz": 1, "step_hz": 60}
STEPS = 90
STILL = np.zeros((2, 2), dtype=np.float32)


@pytest.fixture(scope="module")
def pair() -> Iterator[AsyncVectorEnv]:
    envs = in_processes(2, "point-goal", autoreset="same_step", **OPTIONS)
    yield envs
    envs.close()


def test_each_environment_of_a_vector_begins_the_episode_of_its_own_seed(pair: AsyncVectorEnv) -> None:
    observations, infos = pair.reset(seed=5)
    assert infos["seed"].tolist() == [5, 6]
    alone = TaskEnvironment("point-goal", **OPTIONS)
    try:
        expected, _ = alone.reset(seed=6)
    finally:
        alone.close()
    np.testing.assert_array_equal(observations[1], expected)


def test_the_last_step_of_an_episode_reports_its_observation_and_begins_the_next_one(pair: AsyncVectorEnv) -> None:
    first, _ = pair.reset(seed=[1, 2])
    for _ in range(STEPS - 1):
        *_, truncated, infos = pair.step(STILL)
        assert not truncated.any()
        assert "final_obs" not in infos
    observations, _, terminated, truncated, infos = pair.step(STILL)
    assert truncated.tolist() == [True, True]
    assert terminated.tolist() == [False, False]
    for row in range(2):
        # The robot stood: the goal is where it was at first, and elsewhere in the next episode.
        np.testing.assert_allclose(infos["final_obs"][row][:2], first[row][:2], atol=0.01)
        assert np.abs(observations[row][:2] - first[row][:2]).max() > 0.01
    assert infos["final_info"]["time"].tolist() == pytest.approx([90.0, 90.0])
    assert infos["final_info"]["success"].tolist() == [False, False]
    # Each draws the seeds of its later episodes itself.
    assert infos["seed"][0] != infos["seed"][1]


def test_later_episodes_repeat_with_the_seed_of_the_first(pair: AsyncVectorEnv) -> None:
    seeds = []
    for _ in range(2):
        pair.reset(seed=7)
        seeds.append(pair.reset()[1]["seed"].tolist())
    assert seeds[0] == seeds[1]


def test_processes_of_a_vector_end_with_it() -> None:
    before = set(multiprocessing.active_children())
    envs = in_processes(1, "point-goal", **OPTIONS)
    assert len(set(multiprocessing.active_children()) - before) == 1
    envs.close()
    assert set(multiprocessing.active_children()) <= before
    assert "LP_NUM_THREADS" not in os.environ


@pytest.mark.parametrize(
    ("count", "autoreset", "message"),
    [(0, "next_step", "count is 0, must be 1 or more"), (1, "never", "must be one of next_step, same_step, disabled")],
)
def test_an_impossible_vector_is_refused(count: int, autoreset: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        in_processes(count, "point-goal", autoreset=autoreset)


def test_speeds_backwards_are_those_that_are_allowed() -> None:
    robot = load_robot("gibson_bot")
    still = Observation(time=0.0, links={}, base_link="robot/base_footprint")

    def speeds(reverse: float) -> list[float]:
        controls = Controls(robot, 0.1, reverse)
        return [controls.action([value, 0.0], still).linear for value in (-1.0, 0.0, 1.0)]

    # The limit of gibson_bot is 0.5 m/s.
    assert speeds(1.0) == pytest.approx([-0.5, 0.0, 0.5])
    assert speeds(0.1) == pytest.approx([-0.05, 0.225, 0.5])
    assert speeds(0.0) == pytest.approx([0.0, 0.25, 0.5])
    with pytest.raises(ConfigError, match=r"reverse is 1\.5, must be 0"):
        speeds(1.5)
