"""What becomes of a mutant that loads: time passes, sensors measure, pictures are drawn."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fuzz.seeds import SIZE
from fuzz.trial import Trial
from gibson_sim.config import PhysicsConfig
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from gibson_sim.sensors.suite import SensorSuite
from gibson_sim.standard.filters import TagsFilter
from gibson_sim.standard.simulator import Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.types import CameraSpec, Pose, VelocityCommand

STEPS = 8
YARD = SceneSpec("yard", Path("/nowhere"), "0", (), (), ground_z=0.0)
_MOST_ASKED = 4
_MOST_PIXELS = 256 * 256
_DOWN = CameraSpec(
    "eye", "", Pose((-1.5, 0.0, 1.0), (-0.5, 0.5, -0.5, 0.5)), SIZE, SIZE, math.radians(80.0), outputs=("rgb", "depth")
)


@contextmanager
def simulator(scene: SceneSpec | None = YARD) -> Iterator[Simulator]:
    """A simulator, closed afterwards."""
    made = Simulator(scene, PhysicsConfig())
    try:
        yield made
    finally:
        made.close()


def live(trial: Trial, made: Simulator) -> None:
    """Lets time pass in a world, asks what clients ask, and draws it."""
    if made.state is not SimulationState.PLAYING:
        trial.call("play", made.set_state, int(SimulationState.PLAYING))
    trial.call("step", _steps, made)
    trial.reach("physics")
    assert made.world is not None
    for name in made.population.names[:_MOST_ASKED]:
        state = trial.call("entity_state", made.population.state, name, go_on=True, secret=True)
        if state is not None and not np.isfinite([*state.pose.position, *state.pose.quat_xyzw]).all():
            trial.fault(f"entity {name} is at {state.pose} after {STEPS} steps")
        trial.call("entity_bounds", made.population.bounds, name, go_on=True, secret=True)
        trial.call("joint_states", made.world.joint_states, name, go_on=True)
    trial.call("named_poses", made.named_poses, TagsFilter(), go_on=True, secret=True)
    trial.call("rays", made.world.cast_rays, np.tile((0.0, 0.0, 0.3), (8, 1)), _around(8), 10.0, go_on=True)
    for robot in made.world.scene.robots:
        trial.call("drive", _drive, made.world, robot.name, go_on=True)
    trial.call("reset", made.reset, go_on=True, secret=True)
    trial.call("step", _steps, made)
    draw(trial, made.world)


def _steps(made: Simulator) -> None:
    for _ in range(STEPS):
        made.step()


def _around(count: int) -> np.ndarray:
    angles = np.linspace(0.0, 2 * math.pi, count, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)


def _drive(world: PhysicsWorld, name: str) -> None:
    """Drives a robot for a tenth of a second and lets its sensors measure."""
    robot = next(robot for robot in world.scene.robots if robot.name == name)
    sensors = SensorSuite(robot, world.step_hz, 60, world.scene.gravity, 1)
    sensors.reset(world.step_count)
    if robot.drive is not None:
        world.command(name, VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.5), world.stamp_ns))
    for _ in range(3 * STEPS):
        world.step()
        sensors.measure(world, world.step_count, world.stamp_ns)
    world.odometry(name)
    world.odometry_covariance(name)


def draw(trial: Trial, world: PhysicsWorld) -> None:
    """Draws a world through a camera of the fuzzer and through those of its robots."""
    scene = drawn_scene(world.scene, world.links)
    renderer = trial.call("renderer", Renderer, scene)
    try:
        cameras = [_DOWN, *(c for c in scene.cameras if c.width * c.height <= _MOST_PIXELS)]
        before = world.state()
        world.step()
        for camera in cameras[:3]:
            frames = trial.call("render", renderer.render, world.state(), [camera], before, go_on=True)
            if frames and frames[0].rgb is not None and frames[0].rgb.shape[:2] != (camera.height, camera.width):
                trial.fault(f"a picture of {camera.width}x{camera.height} has shape {frames[0].rgb.shape}")
        trial.reach("renderer")
    finally:
        renderer.close()
