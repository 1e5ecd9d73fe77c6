"""Dry friction of hinges and prismatic joints."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.urdf import Inertial, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointEfforts
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

KG, FROM_HINGE, ABOUT_HINGE = 20.0, 0.4, 4.3
"""The leaf: mass, kg, distance from the hinge to its centre, m, and inertia about the hinge, kg m^2."""
FRAME = UrdfLink("frame", (), (), Inertial(1.0, Pose(), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)))
LEAF = UrdfLink("leaf", (), (), Inertial(KG, Pose((FROM_HINGE, 0.0, 0.0)), (1.0, 0.0, 0.0, 1.0, 0.0, 1.1)))
HINGE = UrdfJoint("hinge", "revolute", "frame", "leaf", Pose(), (0.0, 0.0, 1.0), -2.5, 2.5)
SLIDE = UrdfJoint("slide", "prismatic", "frame", "leaf", Pose(), (1.0, 0.0, 0.0), 0.0, 1.0)


def world_of(joint: UrdfJoint, pose: Pose | None = None, start: float = 0.0) -> PhysicsWorld:
    model = UrdfModel("door", Path("/nowhere/d.urdf"), (FRAME, LEAF), (joint,))
    door = BodySpec("door", model, pose or Pose(), static=True, joints=((joint.name, start),))
    return PhysicsWorld(SceneSpec("test", Path("/nowhere"), "", (), (), bodies=(door,)))


def speed(world: PhysicsWorld) -> float:
    return float(world.state().twists[world.links.index("door/leaf"), 5])


def turned(world: PhysicsWorld) -> float:
    return 2.0 * math.asin(float(world.state().quats_xyzw[world.links.index("door/leaf"), 2]))


def slid(world: PhysicsWorld) -> float:
    state = world.state()
    frame, leaf = (world.links.index(f"door/{link}") for link in ("frame", "leaf"))
    return float(np.linalg.norm(state.positions[leaf] - state.positions[frame]))


def pushed(world: PhysicsWorld, effort: float, steps: int) -> None:
    world.command_joints("door", JointEfforts((effort,), ("hinge",)))
    world.step(steps)


def test_a_swinging_door_is_slowed_evenly_stops_and_never_gains_energy() -> None:
    with world_of(replace(HINGE, friction=2.0)) as world:
        pushed(world, 6.0, 240)
        # Friction takes 2 of 6 N m, and acts alone afterwards.
        begin = speed(world)
        assert begin == pytest.approx(4.0 / ABOUT_HINGE, rel=0.02)
        pushed(world, 0.0, 0)
        speeds = []
        for _ in range(120):
            world.step(1)
            speeds.append(speed(world))
        assert speeds[-1] == pytest.approx(begin - 2.0 / ABOUT_HINGE * 0.5, rel=0.02)
        for _ in range(400):
            world.step(1)
            speeds.append(speed(world))
        assert (np.diff(np.square(speeds)) <= 1e-12).all()
        assert abs(speeds[-1]) < 1e-6


def test_a_push_below_friction_moves_nothing_and_a_door_at_rest_sleeps() -> None:
    with world_of(replace(HINGE, friction=2.0)) as world:
        pushed(world, 1.9, 240)
        assert abs(turned(world)) < 1e-6
    with world_of(replace(HINGE, friction=2.0), start=0.5) as world:
        world.step(720)
        assert not world.state().twists.any()
        assert turned(world) == pytest.approx(0.5, abs=1e-6)


def test_a_leaning_drawer_holds_by_friction_or_slides_with_what_is_left() -> None:
    leaning = pose_from_xyz_rpy((0.0, 0.0, 2.0), (0.0, math.radians(10.0), 0.0))
    down = 9.81 * math.sin(math.radians(10.0))
    with world_of(replace(SLIDE, friction=1.1 * KG * down), leaning, 0.1) as world:
        world.step(240)
        assert slid(world) == pytest.approx(0.1, abs=1e-4)
    with world_of(replace(SLIDE, friction=0.5 * KG * down), leaning, 0.1) as world:
        world.step(120)
        assert slid(world) == pytest.approx(0.1 + 0.5 * (0.5 * down) * 0.25, rel=0.02)


def test_a_door_without_friction_swings_on() -> None:
    with world_of(HINGE, start=-1.0) as world:
        pushed(world, 2.0, 240)
        pushed(world, 0.0, 240)
        assert speed(world) == pytest.approx(2.0 / ABOUT_HINGE, rel=0.02)


def test_friction_comes_back_with_a_reset() -> None:
    with world_of(replace(HINGE, friction=2.0)) as world:
        pushed(world, 8.0, 60)
        world.reset()
        world.step(1)
        pushed(world, 1.9, 60)
        assert abs(turned(world)) < 1e-6
