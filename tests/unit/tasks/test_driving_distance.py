"""The distance that rewards derive from leads around walls, and has no jumps."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.tasks.distance import DrivingDistance
from gibson_sim.tasks.environments import COLLISION_REWARD, CONTACT_REWARD, STEP_REWARD, TaskEnvironment
from gibson_sim.tasks.ground import Ground, ground_of


@pytest.fixture(scope="module")
def arena() -> Ground:
    return ground_of("arena", "gibson_bot")


def test_distance_in_a_room_is_the_straight_one(arena: Ground) -> None:
    distance = DrivingDistance(arena, (3.0, 1.0))
    assert distance((1.0, 1.0)) == pytest.approx(2.0, abs=0.06)
    assert distance((3.0, 1.0)) == pytest.approx(0.0, abs=0.06)


def test_distance_leads_through_the_doorway(arena: Ground) -> None:
    # The wall between the rooms ends at x = 4.20 to 4.32 m, y = 1.75 m. A disc of 0.215 m rolls around its two corners: a tangent of
    # 1.515 m, an arc of 46.5 degrees, 0.174 m, on either side, and 0.12 m between. The grid adds at most 1.3 %, its cells a little at
    # the corners. Straight through the wall it would be 2.52 m.
    assert 3.50 <= DrivingDistance(arena, (5.52, 0.8))((3.0, 0.8)) <= 3.70


def test_direction_leads_to_the_doorway_and_then_to_the_goal(arena: Ground) -> None:
    distance = DrivingDistance(arena, (5.52, 0.8))
    # The tangent of 1.515 m above; the goal itself is straight ahead, behind the wall.
    forward, left = distance.direction((3.0, 0.8))
    assert np.degrees(np.arctan2(left, forward)) == pytest.approx(46.5, abs=6.0)
    near = DrivingDistance(arena, (3.0, 1.0))
    assert near.direction((2.0, 1.0)) == pytest.approx((1.0, 0.0), abs=0.1)
    assert near.direction((3.0, 1.3)) == pytest.approx((0.0, -1.0), abs=0.2)


def test_distance_has_no_jumps_even_beside_walls_where_no_path_begins(arena: Ground) -> None:
    distance = DrivingDistance(arena, (3.0, 2.2))
    # Towards the wall at x = 0, past the place where paths end.
    along = np.array([distance((x, 2.2)) for x in np.arange(0.02, 2.9, 0.01)])
    assert np.abs(np.diff(along)).max() < 0.03
    assert distance((0.05, 2.2)) == pytest.approx(2.95, abs=0.1)


def test_rewards_add_up_to_the_path_that_was_covered() -> None:
    env = TaskEnvironment("point-goal", scene="arena", control_hz=2, step_hz=60)
    try:
        env.reset(seed=3)
        run = env._running()
        goal = run.episode.goal.position
        assert goal is not None
        distance = DrivingDistance(run.ground, goal[:2])
        before, total, touching = distance(run.observation.xy), 0.0, 0
        for _ in range(12):
            _, reward, _, _, info = env.step(np.array([0.4, 0.3], dtype=np.float32))
            total += reward
            touching += run.touching
        covered = before - distance(run.observation.xy)
        assert abs(covered) > 0.1
        assert not info["success"]
        others = 12 * STEP_REWARD + info["collisions"] * COLLISION_REWARD + touching * CONTACT_REWARD
        assert total == pytest.approx(covered + others, abs=1e-9)
    finally:
        env.close()


def test_each_step_against_a_wall_costs() -> None:
    env = TaskEnvironment("point-goal", scene="arena", control_hz=1, step_hz=60)
    try:
        env.reset(seed=3)
        ahead = np.array([1.0, 0.0], dtype=np.float32)
        # The rooms are 8.5 m long: at 0.5 m/s the robot is at a wall after 20 s, wherever it began.
        for _ in range(20):
            env.step(ahead)
        assert env._running().touching
        place = env._running().observation.xy
        state, reward, _, _, info = env.step(ahead)
        assert env._running().observation.xy == pytest.approx(place, abs=0.02)
        assert info["collisions"] == 1
        # The wall is ahead; goal, speeds and class of the goal, 20 numbers, come before the touch.
        assert state[20] > 0.7
        assert reward == pytest.approx(STEP_REWARD + CONTACT_REWARD, abs=0.03)
    finally:
        env.close()
