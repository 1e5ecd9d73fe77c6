"""A world after a reset against a new one, to the bit: piles that a robot pushes, after other pushes and other bodies."""

from __future__ import annotations

import ctypes
import gc
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.metrics import Metrics
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun, run_episode
from gibson_sim.types import Pose, VelocityCommand

SIZE = 0.24
"""Edge of a box, metres."""
STEPS = 240


def box(name: str, x: float, y: float, z: float) -> BodySpec:
    moment = 2.0 * SIZE**2 / 6
    inertial = Inertial(2.0, Pose(), (moment, 0.0, 0.0, moment, 0.0, moment))
    shape = UrdfCollision(Shape("box", (SIZE, SIZE, SIZE)), Pose())
    return BodySpec(
        name, UrdfModel(name, Path("/nowhere/x.urdf"), (UrdfLink("body", (), (shape,), inertial),), ()), Pose((x, y, z))
    )


def pile(shift: float = 0.0) -> tuple[BodySpec, ...]:
    """Two walls of boxes across the living room of the flat, three wide and two high, 0.5 m apart."""
    return tuple(
        box(f"box_{row}{column}{layer}", 2.3 + shift * layer + 0.5 * row, 3.55 + 0.25 * column, SIZE * (0.5 + 1.002 * layer))
        for row in range(2)
        for column in range(-1, 2)
        for layer in range(2)
    )


@pytest.fixture
def scene(root: Path) -> SceneSpec:
    robot = replace(load_robot(root / "config/robots/omni_bot"), name="robot", start=Pose((1.3, 3.5, 0.0)))
    return replace(load_scene("flat"), robots=(robot,), bodies=pile())


@pytest.fixture
def world(scene: SceneSpec) -> Iterator[PhysicsWorld]:
    with PhysicsWorld(scene) as made:
        yield made


def push(world: PhysicsWorld, turn: float = 0.0) -> list[bytes]:
    """Drives into the pile; returns all poses and velocities after each tenth step."""
    seen = []
    for k in range(STEPS // 10):
        spin = turn + 0.8 * math.sin(0.3 * k)
        world.command("robot", VelocityCommand((0.7, 0.15 * math.cos(0.2 * k), 0.0), (0.0, 0.0, spin), world.stamp_ns))
        world.step(10)
        state = world.state()
        seen.append(state.positions.tobytes() + state.quats_xyzw.tobytes() + state.twists.tobytes())
    return seen


def begin(world: PhysicsWorld, robots: Sequence[RobotSpec], bodies: Sequence[BodySpec]) -> None:
    world.repopulate(robots, bodies)
    world.set_step_count(0)


def test_after_a_reset_a_pile_is_pushed_as_in_a_new_world(scene: SceneSpec, world: PhysicsWorld) -> None:
    with PhysicsWorld(scene) as other:
        new = push(other)
        poses = other.state().positions
    assert np.linalg.norm(poses[-len(scene.bodies) :, :2] - [b.start.position[:2] for b in scene.bodies], axis=1).max() > 0.1, (
        "it is"
    )
    assert push(world) == new
    world.reset()
    assert push(world) == new
    world.reset()
    assert push(world, turn=0.6) != new, "another run"
    world.reset()
    assert push(world) == new


def test_repopulated_world_equals_a_new_world(scene: SceneSpec, world: PhysicsWorld) -> None:
    with PhysicsWorld(scene) as other:
        new = push(other)
    push(world, turn=-0.4)
    begin(world, scene.robots, scene.bodies)
    assert push(world) == new
    begin(world, scene.robots, pile(shift=0.06)[:7])
    assert len(push(world)) == len(new)
    world.remove("box_001")
    world.add(box("late", 3.6, 3.5, 0.5))
    world.step(100)
    begin(world, scene.robots, scene.bodies)
    assert push(world) == new


def test_an_episode_of_a_task_does_not_depend_on_those_before_it() -> None:
    def episode(run: TaskRun, seed: int) -> tuple[Metrics, bytes]:
        metrics = run_episode(run, seed, "scripted")
        return metrics, run.world.state().positions.tobytes()

    with TaskRun(task_of("point-goal")) as run:
        alone = episode(run, 9)
        assert alone[0].pushed > 0, "boxes are pushed"
        episode(run, 8)
        assert episode(run, 9) == alone


def test_grasping_finds_links_after_a_reset(root: Path) -> None:
    arm = replace(load_robot(root / "config/robots/arm_bot"), name="arm")
    with PhysicsWorld(SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=0.0, robots=(arm,))) as world:
        world.step(10)
        x, y, z = world.arms.tool_pose("arm").position
        world.add(box("near", x, y, z - SIZE / 2))
        for _ in range(2):
            assert world.arms.grasp("arm").body == "near"
            world.reset()


def test_resets_and_new_worlds_keep_no_memory(scene: SceneSpec, world: PhysicsWorld) -> None:
    trim = ctypes.CDLL(None).malloc_trim

    def resident() -> float:
        gc.collect()
        trim(0)
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

    bare = replace(scene, robots=(), bodies=())
    for again in (world.reset, lambda: PhysicsWorld(bare).close()):
        for _ in range(3):
            again()
        before = resident()
        for _ in range(6):
            again()
        assert resident() - before < 6.0, "MB; the meshes of the flat are 3.5 MB each time"
