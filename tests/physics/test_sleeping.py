"""Sleeping bodies wake only when they must."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, VelocityCommand

ASLEEP = 720
"""Steps after which bodies at rest sleep."""


def box(name: str, x: float, y: float, z: float, size: tuple[float, float, float] = (0.2, 0.2, 0.2)) -> BodySpec:
    inertial = Inertial(1.0, Pose(), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    link = UrdfLink("body", (), (UrdfCollision(Shape("box", size), Pose()),), inertial)
    return BodySpec(name, UrdfModel(name, Path("/nowhere/x.urdf"), (link,), ()), Pose((x, y, z)))


def world_of(*bodies: BodySpec, robots: tuple[RobotSpec, ...] = ()) -> PhysicsWorld:
    return PhysicsWorld(SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=0.0, robots=robots, bodies=bodies))


@pytest.fixture
def omni(root: Path) -> RobotSpec:
    return replace(load_robot(root / "config/robots/omni_bot"), name="robot")


def asleep(world: PhysicsWorld, names: list[str]) -> bool:
    """The velocity of an active body is never exactly 0: its weight and the contact force differ in the last digit."""
    rows = [world.links.index(f"{name}/body") for name in names]
    return not world.state().twists[rows].any()


def drive(world: PhysicsWorld, x: float, y: float, yaw: float, steps: int) -> None:
    world.command("robot", VelocityCommand((x, y, 0.0), (0.0, 0.0, yaw), world.stamp_ns))
    world.step(steps)


def test_forty_bodies_sleep_on_while_an_omni_robot_drives_about(omni: RobotSpec) -> None:
    names = [f"box{k}" for k in range(40)]
    bodies = [box(name, 1.5 + 0.25 * (k % 8), -1.0 + 0.4 * (k // 8), 0.1) for k, name in enumerate(names)]
    with world_of(*bodies, robots=(omni,)) as world:
        world.step(ASLEEP)
        assert asleep(world, names)
        for k in range(24):
            drive(world, 0.3 * (-1) ** (k // 4), 0.2 * (-1) ** (k // 2), 0.5, 10)
            assert asleep(world, names)
        assert abs(world.base_pose("robot").quat_xyzw[2]) > 0.1, "it drove"


def test_robot_that_pushes_a_sleeping_box_wakes_it_and_no_other(omni: RobotSpec) -> None:
    with world_of(box("near", 0.6, 0.0, 0.1), box("far", 0.0, 2.0, 0.1), robots=(omni,)) as world:
        world.step(ASLEEP)
        for _ in range(36):
            drive(world, 0.5, 0.0, 0.0, 10)
        assert world.body_pose("near").position[0] > 0.65
        assert asleep(world, ["far"])


def test_pile_wakes_up_to_its_top_when_the_table_below_it_is_deleted() -> None:
    table = box("table", 0.0, 0.0, 0.25, (1.0, 1.0, 0.5))
    pile = [box(f"box{k}", 0.0, 0.0, 0.6 + 0.2 * k) for k in range(4)]
    with world_of(table, *pile, box("far", 3.0, 0.0, 0.1)) as world:
        world.step(2 * ASLEEP)
        assert asleep(world, ["table", "box0", "box1", "box2", "box3", "far"])
        world.remove("table")
        for _ in range(30):
            world.step(8)
            assert asleep(world, ["far"])
        assert [world.body_pose(f"box{k}").position[2] for k in range(4)] == pytest.approx([0.1, 0.3, 0.5, 0.7], abs=0.01)


@pytest.mark.parametrize("how", ["moved", "thrown"])
def test_pile_falls_when_the_body_under_it_is_pulled_away(how: str) -> None:
    with world_of(box("low", 0.0, 0.0, 0.1), box("high", 0.0, 0.0, 0.3), box("far", 3.0, 0.0, 0.1)) as world:
        world.step(ASLEEP)
        if how == "moved":
            world.set_state("low", pose_from_xyz_rpy((0.0, 2.0, 0.1)))
        else:
            world.set_state("low", linear=(0.0, 6.0, 0.0))
        for _ in range(24):
            world.step(10)
            assert asleep(world, ["far"])
        assert world.body_pose("high").position[2] == pytest.approx(0.1, abs=5e-3)


def test_body_placed_on_a_sleeping_body_wakes_only_that_body() -> None:
    with world_of(box("a", 0.0, 0.0, 0.1), box("far", 1.0, 0.0, 0.1)) as world:
        world.step(ASLEEP)
        world.add(replace(box("wall", 0.15, 0.0, 0.1), static=True))
        world.step(60)
        assert world.body_pose("a").position[0] < -0.02
        assert asleep(world, ["far"])


def test_states_follow_sleeping_bodies_that_are_pushed_thrown_moved_or_unsupported(omni: RobotSpec) -> None:
    tower = [box(f"tower{k}", 1.0, 0.0, 0.1 + 0.2 * k) for k in range(3)]
    bodies = [
        *tower,
        *(box(f"box{k}", 1.5 + 0.21 * k, 0.0, 0.1) for k in range(4)),
        box("shelf", -2.0, 0.0, 0.1),
        box("vase", -2.0, 0.0, 0.3),
    ]
    with world_of(*bodies, robots=(omni,)) as world:
        moved: set[str] = set()
        for step in range(1, 1500):
            if step > ASLEEP:
                world.command("robot", VelocityCommand((0.4, 0.0, 0.0), (0.0, 0.0, 0.0), world.stamp_ns))
            if step == 900:
                world.remove("shelf")
                moved.add("shelf")
            if step == 1000:
                world.set_state("box3", pose=Pose((0.0, 3.0, 0.5)))
            if step == 1300:
                world.step(600)
            world.step(4 if step % 2 else 1)
            state = world.state()
            for name in set(world.names) - {"robot"} if step % 3 == 0 else ():
                row, pose = state.links.index(f"{name}/body"), world.body_pose(name)
                assert state.positions[row].tolist() == pytest.approx(pose.position, abs=1e-12)
                assert state.quats_xyzw[row].tolist() == pytest.approx(pose.quat_xyzw, abs=1e-12)
                if step > ASLEEP and state.twists[row].any():
                    moved.add(name)
        assert moved == {body.name for body in bodies}, "all of them woke"
