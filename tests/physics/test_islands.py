"""States of a world that reads only bodies that may have moved, against a world that always reads all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, VelocityCommand

ASLEEP = 640
"""Steps after which bodies at rest sleep."""
READS = 40
"""Reads after which the sleeping bodies are known."""


def link(name: str, size: tuple[float, float, float], at: Pose | None = None, mass: float = 1.0) -> UrdfLink:
    place, moment = at or Pose(), 0.01 * mass
    return UrdfLink(
        name, (), (UrdfCollision(Shape("box", size), place),), Inertial(mass, place, (moment, 0.0, 0.0, moment, 0.0, moment))
    )


def box(name: str, x: float, y: float, z: float = 0.1, size: float = 0.2) -> BodySpec:
    return BodySpec(name, UrdfModel(name, Path("/nowhere/x.urdf"), (link("body", (size, size, size)),), ()), Pose((x, y, z)))


def door(name: str, x: float, y: float, *, static: bool) -> BodySpec:
    """A leaf that swings about z at the edge of a post, which is fixed or stands freely."""
    post, leaf = link("post", (0.2, 0.2, 0.4)), link("leaf", (0.04, 0.6, 0.2), Pose((0.0, 0.4, -0.08)), 0.1)
    hinge = UrdfJoint("hinge", "revolute", "post", "leaf", Pose(), (0.0, 0.0, 1.0), -2.0, 2.0, damping=0.2, friction=0.1)
    return BodySpec(name, UrdfModel(name, Path("/nowhere/d.urdf"), (post, leaf), (hinge,)), Pose((x, y, 0.2)), static=static)


@pytest.fixture
def omni(root: Path) -> RobotSpec:
    return replace(load_robot(root / "config/robots/omni_bot"), name="robot")


def world_of(*bodies: BodySpec, robots: tuple[RobotSpec, ...] = ()) -> PhysicsWorld:
    return PhysicsWorld(SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=0.0, robots=robots, bodies=bodies))


def drive(world: PhysicsWorld, speed: float = 0.5) -> None:
    world.command("robot", VelocityCommand((speed, 0.0, 0.0), (0.0, 0.0, 0.0), world.stamp_ns))


def drop(world: PhysicsWorld) -> None:
    if world.step_count == ASLEEP:
        world.set_state("ball", Pose((2.0, 0.0, 1.0)))


def push(world: PhysicsWorld) -> None:
    if world.step_count == ASLEEP:
        world.set_state("ball", linear=(-2.0, 0.0, 0.0))


def take_away(world: PhysicsWorld) -> None:
    if world.step_count == ASLEEP:
        world.remove("ball")


def hang(world: PhysicsWorld) -> None:
    if world.step_count == ASLEEP:
        world.attachments.attach("robot", world.scene.robots[0].base_link, "ball", "body", kind="ball", max_force=50.0)
    drive(world, -0.4)


ROW = tuple(box(f"box{k}", 0.62 + 0.203 * k, 0.0) for k in range(3))
CASES: dict[str, tuple[tuple[BodySpec, ...], Callable[[PhysicsWorld], None], set[str]]] = {
    "the robot pushes a row": ((*ROW, box("far", 0.0, 3.0)), drive, {"box0", "box1", "box2"}),
    "the robot pushes a door": ((door("door", 0.55, -0.4, static=True),), drive, {"door"}),
    "the robot pushes a door on a post that stands": ((door("door", 0.55, -0.4, static=False),), drive, {"door"}),
    "a ball falls on a pile": (
        (box("low", 2.0, 0.0), box("high", 2.0, 0.0, 0.3), box("ball", 4.0, 0.0)),
        drop,
        {"low", "high", "ball"},
    ),
    "a ball hits a row": ((box("ball", 3.0, 0.0), box("a", 2.5, 0.0), box("b", 2.299, 0.0)), push, {"ball", "a", "b"}),
    "a pile loses its foot": ((box("ball", 2.0, 0.0), box("a", 2.0, 0.0, 0.3), box("b", 2.0, 0.0, 0.5)), take_away, {"a", "b"}),
    "the robot pulls": ((box("ball", 1.0, 0.0), box("far", 0.0, 3.0)), hang, {"ball"}),
}


@pytest.mark.parametrize("case", CASES)
def test_states_are_those_of_a_world_that_always_reads_all_bodies(omni: RobotSpec, case: str) -> None:
    bodies, act, moving = CASES[case]
    moved: set[str] = set()
    with world_of(*bodies, robots=(omni,)) as world, world_of(*bodies, robots=(omni,)) as other:
        for one in (world, other):
            one.step(ASLEEP - READS)
        for k in range(READS + 120):
            for one in (world, other):
                if k >= READS:
                    act(one)
                one.step(5 if k > READS and k % 4 == 0 else 1)
            other._poses.forget()
            ours, theirs = world.state(), other.state()
            for name in ("positions", "quats_xyzw", "twists"):
                assert getattr(ours, name).tobytes() == getattr(theirs, name).tobytes(), (case, world.step_count, name)
            if k >= READS:
                moved |= {full.split("/")[0] for full, twist in zip(ours.links, ours.twists, strict=True) if twist.any()}
    assert moved - {"robot"} == moving, "and no other"


def test_the_engine_counts_the_solver_bodies_of_moving_bodies_and_robots(omni: RobotSpec) -> None:
    bodies = (
        box("near", 0.62, 0.0),
        box("far", 0.0, 2.0),
        door("door", 0.9, -0.4, static=True),
        door("gate", 3.0, 0.0, static=False),
    )
    wall = replace(box("wall", -2.0, 0.0), static=True)
    seen: set[float] = set()
    with world_of(*bodies, wall, robots=(omni,)) as world:
        for step in range(ASLEEP + 240):
            if step > ASLEEP:
                drive(world)
            world.step(1)
            parts, steps = world._bullet.active_bodies.pop_peak()
            awake = [one for one in world._all() if not one.sleeps or world._bullet.raw_states(one.engine_body)[:, 7:].any()]
            others = parts - sum(one.engine_body.solver_bodies for one in awake)
            assert steps == 1
            # Nothing moves the door: its velocity is exactly 0 before it sleeps.
            assert others == 0 or (others == 1 and step < ASLEEP), step
            seen.add(parts)
    assert min(seen) == world._robots["robot"].engine_body.solver_bodies and max(seen) > min(seen) + 4, (
        "all slept, and were active before"
    )


def test_while_all_bodies_sleep_the_robot_alone_is_read(omni: RobotSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = (box("a", 2.0, 0.0), door("door", -2.0, 0.0, static=True), door("gate", 3.0, 0.0, static=False))
    read: list[int] = []
    raw_states, at_rest = Bullet.raw_states, Bullet.at_rest
    with world_of(*bodies, robots=(omni,)) as world:
        robot = world._robots["robot"].engine_body.uid
        for _ in range(READS):
            world.step(ASLEEP // READS)
            world.state()
        monkeypatch.setattr(Bullet, "raw_states", lambda self, *of: read.extend(one.uid for one in of) or raw_states(self, *of))
        monkeypatch.setattr(Bullet, "at_rest", lambda self, of: read.extend(one.uid for one in of) or at_rest(self, of))
        for k in range(64):
            world.command("robot", VelocityCommand((0.2, 0.1, 0.0), (0.0, 0.0, math.sin(k)), world.stamp_ns))
            world.step(1 + k % 3)
            world.state()
    assert read.count(robot) == 64
    assert len(read) == 64 + 4 * len(bodies), "the others at every 16th read, for safety"


def test_a_robot_with_an_unknown_number_of_solver_bodies_hides_no_body_that_wakes(omni: RobotSpec) -> None:
    with world_of(box("a", 0.0, 2.0), robots=(omni,)) as world:
        world._robots["robot"].engine_body.solver_bodies = math.nan
        for _ in range(READS):
            world.step(ASLEEP // READS)
            world.state()
        world._bullet.wake(world._bodies["a"].engine_body)
        for _ in range(2):
            world.step(1)
            state = world.state()
        assert state.twists[-1].any(), "it is active"


def test_with_more_bodies_than_the_engine_can_report_on_their_velocities_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = [box(f"box{k}", 0.5 * (k % 8), 0.5 * (k // 8), 0.05, 0.1) for k in range(65)]
    with world_of(*bodies) as world:
        world.step(1)
        assert world._bullet.active_bodies.pop_peak() == (math.inf, 1)
        world.remove("box64")
        world.step(1)
        assert world._bullet.active_bodies.pop_peak() == (64, 1), "each is an island of its own"
        world.add(bodies[64])
        for _ in range(ASLEEP // 20):
            world.step(20)
            world.state()
        assert not world.state().twists.any()
        world.set_state("box0", linear=(3.0, 0.0, 0.0))
        state = world.state()
        for _ in range(15):
            world.step(4)
            before, state = state, world.state()
            assert state.positions[0, 0] > before.positions[0, 0]
            assert np.allclose([world.body_pose(f"box{k}").position for k in range(65)], state.positions, rtol=0.0, atol=1e-12)
        assert state.twists[1].any(), "the next one was hit"
