"""Worlds for physics tests: our robot on a plane or on a floor of triangles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import VelocityCommand

MakeScene = Callable[..., SceneSpec]


@pytest.fixture
def robot(root: Path) -> RobotSpec:
    """Our own robot, at the origin."""
    return load_robot(root / "config/robots/gibson_bot")


@pytest.fixture
def make_scene(tmp_path: Path) -> MakeScene:
    """Makes a scene of robots and collision shapes, by default on a ground plane."""

    def make(*robots: RobotSpec, collisions: tuple[CollisionSpec, ...] = (), ground_z: float | None = 0.0) -> SceneSpec:
        return SceneSpec("test", tmp_path, "", (), collisions, ground_z=ground_z, robots=robots)

    return make


@pytest.fixture
def mesh_floor(tmp_path: Path) -> CollisionSpec:
    """A floor of 12 x 12 m at z = 0: 4,050 triangles whose corners lie anywhere."""
    n, size = 45, 12.0
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(-size / 2, size / 2, n + 1), np.linspace(-size / 2, size / 2, n + 1), indexing="ij")
    x, y = (c + rng.uniform(-0.08, 0.08, c.shape) for c in (x, y))
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)[None]).ravel() + 1
    faces = [(i, i + n + 1, i + n + 2) for i in first] + [(i, i + n + 2, i + 1) for i in first]
    lines = [f"v {a:.6f} {b:.6f} 0" for a, b in zip(x.ravel(), y.ravel(), strict=True)] + [f"f {a} {b} {c}" for a, b, c in faces]
    path = tmp_path / "floor.obj"
    path.write_text("\n".join(lines) + "\n")
    return CollisionSpec("floor", Shape("mesh", (1.0, 1.0, 1.0), str(path)))


@pytest.fixture(params=["plane", "triangles"])
def flat(request: pytest.FixtureRequest, make_scene: MakeScene, mesh_floor: CollisionSpec, robot: RobotSpec) -> SceneSpec:
    """Our robot on a flat floor, once a plane, once triangles."""
    if request.param == "plane":
        return make_scene(robot)
    return make_scene(robot, collisions=(mesh_floor,), ground_z=None)


@pytest.fixture
def drive() -> Callable[[PhysicsWorld, float, float, float], None]:
    """Sends a velocity 20 times a second for a number of seconds."""

    def _drive(world: PhysicsWorld, linear: float, angular: float, seconds: float) -> None:
        for _ in range(round(seconds * 20)):
            world.command("robot", VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
            world.step(world.step_hz // 20)

    return _drive
