"""Robots that would start inside of anything are refused; what they stand on or touch does not count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.config import PhysicsConfig
from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.errors import StartError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.physics.engine import pybullet
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.standard.codes import SimulationError, SpawnCode
from gibson_sim.standard.filters import EntityFilters
from gibson_sim.standard.population import SpawnRequest
from gibson_sim.standard.simulator import Simulator
from gibson_sim.types import Pose
from support.yard import box

MakeScene = Callable[..., SceneSpec]
SOFA = CollisionSpec("sofa", Shape("box", (2.0, 0.9, 0.8)), Pose((3.0, 0.0, 0.4)))


def at(robot: RobotSpec, x: float, y: float = 0.0, name: str = "robot") -> RobotSpec:
    return replace(robot, name=name, start=pose_from_xyz_rpy((x, y, 0.0), (0.0, 0.0, 0.4)))


def hollow(folder: Path) -> CollisionSpec:
    """The sofa as hollow triangles."""
    corners = [(x, y, z) for z in (0.0, 0.8) for y in (-0.45, 0.45) for x in (2.0, 4.0)]
    faces = ["1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6", "1 3 4 2", "5 6 8 7"]
    (folder / "sofa.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {f}\n" for f in faces))
    return CollisionSpec("sofa", Shape("mesh", (1.0, 1.0, 1.0), str(folder / "sofa.obj")))


@pytest.mark.parametrize("kind", ["box", "triangles"])
def test_a_start_inside_furniture_is_refused_and_says_where(
    robot: RobotSpec, make_scene: MakeScene, tmp_path: Path, kind: str
) -> None:
    sofa = SOFA if kind == "box" else hollow(tmp_path)
    words = r"robot 'robot' would start at \(2\.05, 0\.00, 0\.00\), 0\.\d\d m deep in 'sofa'; at most 0\.05 m are allowed: choose a free"
    with pytest.raises(StartError, match=words):
        PhysicsWorld(make_scene(at(robot, 2.05), collisions=(sofa,)))


@pytest.mark.parametrize("x", [0.0, 1.75])
def test_a_start_beside_furniture_is_fine(robot: RobotSpec, make_scene: MakeScene, x: float) -> None:
    with PhysicsWorld(make_scene(at(robot, x), collisions=(SOFA,))) as world:
        world.step(60)
        assert max(contact.force for contact in world.contacts("robot")) < 200.0


def test_two_robots_in_one_place_and_a_body_in_the_way_are_refused(robot: RobotSpec, make_scene: MakeScene) -> None:
    with pytest.raises(StartError, match=r"'second' would start .* deep in 'robot'|'robot' would start .* deep in 'second'"):
        PhysicsWorld(make_scene(at(robot, 0.0), at(robot, 0.05, name="second")))
    crate: BodySpec = box("crate", 0.0)
    with pytest.raises(StartError, match="deep in 'crate'"):
        PhysicsWorld(replace(make_scene(at(robot, 0.0)), bodies=(crate,)))


def test_a_robot_that_was_refused_leaves_nothing(robot: RobotSpec, make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(at(robot, 0.0), collisions=(SOFA,))) as world:
        bodies = pybullet.getNumBodies(physicsClientId=world._bullet.client)
        for _ in range(8):
            with pytest.raises(StartError):
                world.add(at(robot, 2.5, name="second"))
        assert world.names == ("robot",)
        assert pybullet.getNumBodies(physicsClientId=world._bullet.client) == bodies
        world.add(at(robot, 0.0, 2.0, name="second"))
        world.step(10)
        assert world.names == ("robot", "second")


def test_checking_a_start_for_collisions_keeps_the_run_bit_equal(robot: RobotSpec, make_scene: MakeScene) -> None:
    def run(world: PhysicsWorld) -> bytes:
        world.step(100)
        return world.state().positions.tobytes() + world.state().twists.tobytes()

    with PhysicsWorld(make_scene(at(robot, 1.75), collisions=(SOFA,))) as world:
        first = run(world)
        world.reset()
        assert run(world) == first


def test_spawn_in_collision_fails_with_invalid_pose(robot: RobotSpec, make_scene: MakeScene) -> None:
    simulator = Simulator(make_scene(at(robot, 0.0), collisions=(SOFA,)), PhysicsConfig())
    try:
        with pytest.raises(SimulationError, match="deep in 'sofa'") as error:
            simulator.population.spawn(SpawnRequest("two", uri="gibson_bot", namespace="two", position=(3.0, 0.3, 0.0)))
        assert error.value.code is SpawnCode.INVALID_POSE
        assert [entity.name for entity in simulator.population.select(EntityFilters())] == ["robot"]
    finally:
        simulator.close()
