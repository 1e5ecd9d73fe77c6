"""Gibson Sim: a ROS 2 simulation server for indoor robots, and a simulation in one Python process.

    import gibson_sim as gs

    with gs.Simulation("linden_flat", robot="gibson_bot", seed=0) as sim:
        sim.command(linear=0.3, angular=0.1)                          # m/s, rad/s
        state = sim.step(seconds=1.0)                                 # exactly 240 physics steps
        frame = sim.render("camera", outputs=["rgb", "depth"])        # drawn from that state, nothing else
        print(sim.robot.pose, frame.rgb.shape, sim.scan())

Names in ``__all__`` are public: they change only with an entry in the changelog. All modules are private.

Simulation      scene, robots, physics, sensors and renderer in one process; returns ``Robot``, ``SavedRun`` and ``Scan``
Renderer        renders a scene at given states: all camera models, colour, depth, labels, normals, flow; without physics;
                ``MeshFiles`` and ``RenderOptions`` are its settings
PhysicsWorld    physics without rendering: takes commands and steps, returns poses
load_scene, load_robot, list_scenes, list_robots, list_objects, drawn_scene, camera_pose
*Spec           descriptions of scenes, robots, bodies, cameras and light
SceneState, Frame, ...   frozen values; ``Simulation.render`` explains what a frame holds
GibsonSimError  and its subclasses: all errors that are raised on purpose, with one-line messages

SI units and radians, frames of REP 103 and REP 105, quaternions (x, y, z, w). PyBullet, OpenGL, ROS and PyTorch are imported on demand,
not with this package. The tutorial is docs/python.md.
"""

from __future__ import annotations

import difflib
from importlib import import_module
from typing import TYPE_CHECKING

from gibson_sim.field_docs import with_field_docs

__version__ = "0.1.0"

_NAMES_OF_MODULE = {
    "gibson_sim.simulation": ("Body", "Robot", "SavedRun", "Simulation"),
    "gibson_sim.render.renderer": ("MeshFiles", "RenderOptions", "Renderer"),
    "gibson_sim.physics.world": ("PhysicsWorld",),
    "gibson_sim.resources": ("list_robots", "list_scenes"),
    "gibson_sim.scenes.load": ("load_scene",),
    "gibson_sim.robots.load": ("load_robot",),
    "gibson_sim.scenes.spawnables": ("list_objects",),
    "gibson_sim.scenes.spawning": ("SpawnError",),
    "gibson_sim.scenes.spec": ("DrawnScene", "LightSpec", "PointLight", "SceneSpec", "drawn_scene"),
    "gibson_sim.robots.spec": ("RobotSpec",),
    "gibson_sim.description.body": ("BodySpec",),
    "gibson_sim.geometry.transforms": ("camera_pose",),
    "gibson_sim.sensors.lidar": ("Scan",),
    "gibson_sim.types": (
        "OUTPUTS", "CameraSpec", "Contact", "DepthNoise", "Frame", "ImageEffects", "JointStates", "Odometry", "Pose", "SceneState",
        "VelocityCommand",
    ),
    "gibson_sim.errors": (
        "CommandError", "ConfigError", "EnvironmentProblemError", "GibsonSimError", "GraphicsUnavailableError", "MeshError", "PhysicsError",
        "RenderError", "RobotError", "SceneError", "SceneMismatchError", "SceneNotFoundError", "StartError",
    ),
}  # fmt: skip
"""Module -> public names that it defines."""
_MODULE_OF_NAME = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names}

if TYPE_CHECKING:
    from gibson_sim.errors import (
        CommandError, ConfigError, EnvironmentProblemError, GibsonSimError, GraphicsUnavailableError, MeshError, PhysicsError, RenderError,
        RobotError, SceneError, SceneMismatchError, SceneNotFoundError, StartError,
    )  # fmt: skip
    from gibson_sim.geometry.transforms import camera_pose
    from gibson_sim.physics.world import PhysicsWorld
    from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
    from gibson_sim.resources import list_robots, list_scenes
    from gibson_sim.description.body import BodySpec
    from gibson_sim.robots.spec import RobotSpec
    from gibson_sim.scenes.load import load_scene
    from gibson_sim.robots.load import load_robot
    from gibson_sim.scenes.spawnables import list_objects
    from gibson_sim.scenes.spawning import SpawnError
    from gibson_sim.scenes.spec import (
        DrawnScene,
        LightSpec,
        PointLight,
        SceneSpec,
        drawn_scene,
    )
    from gibson_sim.sensors.lidar import Scan
    from gibson_sim.simulation import (
        Body,
        Robot,
        SavedRun,
        Simulation,
    )
    from gibson_sim.types import (
        OUTPUTS, CameraSpec, Contact, DepthNoise, Frame, ImageEffects, JointStates, Odometry, Pose, SceneState, VelocityCommand,
    )  # fmt: skip

__all__ = [
    "OUTPUTS", "Body", "BodySpec", "CameraSpec", "CommandError", "ConfigError", "Contact", "DepthNoise", "DrawnScene", "EnvironmentProblemError",
    "Frame", "GibsonSimError", "GraphicsUnavailableError", "ImageEffects", "JointStates", "LightSpec", "MeshError",
    "MeshFiles", "Odometry",
    "PhysicsError", "PhysicsWorld", "PointLight", "Pose", "RenderError", "RenderOptions", "Renderer", "Robot", "RobotError", "RobotSpec", "SavedRun",
    "Scan", "SceneError", "SceneMismatchError", "SceneNotFoundError", "SceneSpec", "SceneState", "Simulation", "SpawnError", "StartError",
    "VelocityCommand", "camera_pose", "drawn_scene", "list_objects", "list_robots", "list_scenes", "load_robot", "load_scene",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Loads a public name on first access."""
    if name not in _MODULE_OF_NAME:
        near = difflib.get_close_matches(name, __all__, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    value = globals()[name] = with_field_docs(getattr(import_module(_MODULE_OF_NAME[name]), name))
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
