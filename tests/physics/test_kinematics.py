"""Forward and inverse kinematics of a lift and an arm of seven joints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.urdf import UrdfModel, read_urdf
from gibson_sim.errors import CommandError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.robots.joints.kinematics import Chain, ChainSolution
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec

JOINTS = (
    # name, kind, origin, axis, limits
    ("lift", "prismatic", (-0.1, 0.0, 0.4), (0, 0, 1), (0.0, 0.4)),
    ("shoulder_pan", "revolute", (0.1, 0.0, 0.35), (0, 0, 1), (-1.6, 1.6)),
    ("shoulder_lift", "revolute", (0.12, 0.0, 0.06), (0, 1, 0), (-1.2, 1.5)),
    ("upperarm_roll", "continuous", (0.22, 0.0, 0.0), (1, 0, 0), None),
    ("elbow_flex", "revolute", (0.13, 0.0, 0.0), (0, 1, 0), (-2.2, 2.2)),
    ("forearm_roll", "continuous", (0.2, 0.0, 0.0), (1, 0, 0), None),
    ("wrist_flex", "revolute", (0.12, 0.0, 0.0), (0, 1, 0), (-2.1, 2.1)),
    ("wrist_roll", "continuous", (0.14, 0.0, 0.0), (1, 0, 0), None),
)
NAMES = tuple(name for name, *_ in JOINTS)
MASS = '<inertial><mass value="{}"/><inertia ixx="{}" iyy="{}" izz="{}"/></inertial>'


def _urdf() -> str:
    text = f'<robot name="arm"><link name="base">{MASS.format(200, 20, 20, 20)}</link>'
    above = "base"
    for name, kind, (x, y, z), axis, limits in JOINTS:
        lower, upper = limits or (0.0, -1.0)
        text += f'<link name="{name}_link">{MASS.format(0.5, 0.002, 0.002, 0.002)}</link>'
        text += f'<joint name="{name}" type="{kind}"><parent link="{above}"/><child link="{name}_link"/>'
        text += f'<origin xyz="{x} {y} {z}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
        text += f'<limit lower="{lower}" upper="{upper}" effort="200" velocity="3"/></joint>'
        above = f"{name}_link"
    hand = '<origin xyz="0.1 0.02 0.01" rpy="0.3 0.2 0.1"/>'
    text += f'<link name="hand"/><joint name="mount" type="fixed"><parent link="{above}"/><child link="hand"/>{hand}</joint>'
    wheel = '<parent link="base"/><child link="wheel"/><axis xyz="0 1 0"/>'
    return (
        text
        + f'<link name="wheel">{MASS.format(1, 0.01, 0.01, 0.01)}</link><joint name="roll" type="continuous">{wheel}</joint></robot>'
    )


@pytest.fixture
def robot(tmp_path: Path) -> RobotSpec:
    (tmp_path / "arm.urdf").write_text(_urdf())
    (tmp_path / "robot.yaml").write_text("urdf: arm.urdf\nradius: 0.3\nheight: 1.0\n")
    return replace(load_robot(tmp_path), start=pose_from_xyz_rpy((1.0, -2.0, 0.5), (0.0, 0.1, 0.8)))


@pytest.fixture
def model(robot: RobotSpec) -> UrdfModel:
    return read_urdf(robot.urdf)


def random_joints(rng: np.random.Generator) -> dict[str, float]:
    return {name: float(rng.uniform(*(limits or (-math.pi, math.pi)))) for name, _, _, _, limits in JOINTS}


def joints_of(solution: ChainSolution) -> dict[str, float]:
    return dict(zip(solution.names, solution.positions, strict=True))


def keeps_limits(joints: dict[str, float]) -> bool:
    return all(limits is None or limits[0] <= joints[name] <= limits[1] for name, _, _, _, limits in JOINTS)


def test_pose_of_the_hand_is_that_of_the_engine(robot: RobotSpec, model: UrdfModel) -> None:
    with PhysicsWorld(SceneSpec("test", Path("/nowhere"), "", (), (), gravity=(0.0, 0.0, 0.0), robots=(robot,))) as world:
        world.command_joints("robot", JointPositions((0.2, 0.5, -0.4, 1.0, 0.9, -0.7, 0.6, 0.3), NAMES))
        world.step(720)
        states = world.joint_states("robot")
        expected = Chain(model, "hand").pose(dict(zip(states.names, states.positions.tolist(), strict=True)))
        state = world.state()
        row = state.links.index("robot/hand")
        T_world_base = matrix_from_pose(world.base_pose("robot"))
        assert state.positions[row] == pytest.approx((T_world_base @ expected)[:3, 3], abs=1e-6)
        quat = pose_from_matrix(T_world_base @ expected).quat_xyzw
        assert abs(float(np.dot(quat, state.quats_xyzw[row]))) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("rest", "count"), [(None, 50), (dict.fromkeys(NAMES, 0.3), 15)], ids=["free", "with_a_rest_pose"])
def test_random_reachable_poses_are_reached_within_the_limits(
    model: UrdfModel, rest: dict[str, float] | None, count: int
) -> None:
    chain, rng = Chain(model, "hand"), np.random.default_rng(0)
    for _ in range(count):
        target = chain.pose(random_joints(rng))
        solution = chain.solve(target, dict.fromkeys(NAMES, 0.0), rest=rest)
        assert solution.within(1e-3, math.radians(0.5))
        assert keeps_limits(joints_of(solution))
        reached = chain.pose(joints_of(solution))
        assert reached[:3, 3] == pytest.approx(target[:3, 3], abs=1e-3)
        assert (np.trace(reached[:3, :3].T @ target[:3, :3]) - 1) / 2 > math.cos(math.radians(0.5))


def test_pose_out_of_reach_is_approached_and_the_error_says_how_far(model: UrdfModel) -> None:
    chain = Chain(model, "hand")
    target = np.eye(4)
    target[:3, 3] = 5.0, 0.0, 0.8
    solution = chain.solve(target, {}, orientation=False)
    assert solution.angle_error == 0.0
    reached = chain.pose(joints_of(solution))[:3, 3]
    assert solution.position_error == pytest.approx(float(np.linalg.norm(reached - target[:3, 3])), abs=1e-9)
    # Stretched out: 0.12 m of the shoulder, 0.81 m of the arm to the last joint, and 0.1 m of the hand.
    assert reached[0] == pytest.approx(1.03, abs=0.01)
    assert keeps_limits(joints_of(solution))


def test_rest_pose_takes_what_the_target_leaves_free(model: UrdfModel) -> None:
    chain = Chain(model, "hand")
    start = dict(zip(NAMES, (0.2, 0.3, 0.4, 0.8, 0.9, 0.2, 0.6, 0.1), strict=True))
    target = chain.pose(start)
    high, low = (chain.solve(target, start, rest={"lift": lift}) for lift in (0.3, 0.1))
    assert high.position_error < 1e-6 and low.position_error < 1e-6
    assert joints_of(high)["lift"] > 0.28
    assert joints_of(low)["lift"] < 0.12


def test_small_step_of_the_hand_is_a_small_step_of_the_joints(model: UrdfModel) -> None:
    chain = Chain(model, "hand")
    start = dict(zip(NAMES, (0.2, 0.3, 0.4, 0.8, 0.9, 0.2, 0.6, 0.1), strict=True))
    target = chain.pose(start)
    target[:3, 3] += 0.001, -0.002, 0.001
    solution = chain.solve(target, start)
    assert solution.position_error < 1e-6
    assert max(abs(joints_of(solution)[name] - start[name]) for name in NAMES) < 0.02


def test_locked_joints_keep_their_positions(model: UrdfModel) -> None:
    chain = Chain(model, "hand", NAMES[1:])
    goal = {"lift": 0.25, "shoulder_pan": 0.4, "shoulder_lift": -0.3, "elbow_flex": 0.8, "wrist_flex": 0.5}
    solution = chain.solve(chain.pose(goal), {"lift": 0.25})
    assert "lift" not in solution.names
    assert solution.within(1e-3, math.radians(0.5))


def test_equal_targets_have_bit_equal_solutions(model: UrdfModel) -> None:
    target = Chain(model, "hand").pose(random_joints(np.random.default_rng(7)))
    first, second = (Chain(model, "hand").solve(target, {}) for _ in range(2))
    assert first == second


def test_world_solves_a_chain_at_the_pose_of_its_body_and_the_arm_reaches_the_target(model: UrdfModel) -> None:
    start = pose_from_xyz_rpy((1.0, -2.0, 0.5), (0.0, 0.1, 0.8))
    goal = pose_from_xyz_rpy((1.45, -1.45, 1.1), (0.4, 0.5, 0.9))
    arm = BodySpec("arm", model, start, static=True)
    with PhysicsWorld(SceneSpec("test", Path("/nowhere"), "", (), (), bodies=(arm,))) as world:
        before = world.state().positions.tobytes()
        solution = world.solve_chain("arm", "hand", goal, rest=dict.fromkeys(NAMES, 0.2))
        assert world.state().positions.tobytes() == before, "nothing moved"
        assert solution.within(1e-5, 1e-5)
        world.command_joints("arm", JointPositions(solution.positions, solution.names))
        world.step(4 * 240)
        state = world.state()
        row = state.links.index("arm/hand")
        assert state.positions[row] == pytest.approx(goal.position, abs=1e-3)
        angle = 2.0 * math.acos(min(1.0, abs(float(np.dot(goal.quat_xyzw, state.quats_xyzw[row])))))
        assert angle < math.radians(0.5)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda model: Chain(model, "foot"), "no link 'foot'; known: base, "),
        (lambda model: Chain(model, "base"), "no joint moves link 'base'"),
        (lambda model: Chain(model, "hand", ("roll",)), "joint 'roll' does not move link 'hand'; these do: lift, "),
        (lambda model: Chain(model, "hand", ()), "no joint of the chain to link 'hand' may move; name at least one of lift, "),
        (lambda model: Chain(model, "hand").solve(np.full((4, 4), math.nan), {}), "has a number that is not finite"),
    ],
)
def test_impossible_chains_are_refused(model: UrdfModel, ask: Callable[[UrdfModel], object], words: str) -> None:
    with pytest.raises(CommandError, match=words):
        ask(model)
