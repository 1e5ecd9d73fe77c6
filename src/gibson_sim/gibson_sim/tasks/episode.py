"""Value types of tasks: episodes, observations, actions. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from gibson_sim.description.body import BodySpec
from gibson_sim.geometry.transforms import matrix_from_quat, yaw_from_quat
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.types import NS_PER_S, Pose, SceneState, Vec3


@dataclass(frozen=True, slots=True)
class Item:
    """An object that an episode adds to the scene."""

    name: str
    """Name, unique in the scene: letters, digits and ``_``."""
    model: str
    """Name of a built-in object, see docs/objects.md, or path of a URDF."""
    pose: Pose
    """T_world_root at the start."""
    text: str = ""
    """URDF text loaded instead of the model; empty = load the model."""


@dataclass(frozen=True, slots=True)
class Goal:
    """The goal of an episode."""

    text: str
    """Description, one sentence."""
    position: Vec3 | None = None
    """Goal position, world frame, metres; None = unknown, the robot must find it."""
    radius: float = 0.0
    """Distance to ``position`` within which the goal is reached, metres."""
    target: str = ""
    """Name of the target item; empty = none."""
    target_class: str = ""
    """Semantic class of the target item."""


@dataclass(frozen=True, slots=True)
class Episode:
    """One attempt at a task: equal seeds give equal episodes."""

    task: str
    seed: int
    start: Pose
    """T_world_base of the robot."""
    items: tuple[Item, ...]
    goal: Goal
    shortest: float
    """Length of the shortest path to the goal, metres; NaN = not defined for the task."""
    time_limit: float
    """Maximum duration, seconds of simulation time."""
    removed: tuple[str, ...] = ()
    """Names of bodies of the scene that are removed for the episode."""


@dataclass(frozen=True, slots=True)
class Observation:
    """The input of a policy at one time."""

    time: float
    """Simulation time since the start of the episode, seconds."""
    links: Mapping[str, Pose]
    """T_world_link of all links of robots and bodies, by ``<body>/<link>``."""
    base_link: str
    """Name of the robot's base link in ``links``, ``<robot>/<link>``."""
    linear: float = 0.0
    """Forward speed of the base, m/s."""
    angular: float = 0.0
    """Yaw rate of the base, rad/s."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Positions of the robot's joints, except those of its drive, radians or metres."""
    held: str = ""
    """Name of the body held by the gripper; empty = none."""
    speeds: Mapping[str, float] = field(default_factory=dict)
    """Speeds of the origins of ``links``, m/s."""
    touch: tuple[float, float] = (0.0, 0.0)
    """Direction of lateral contacts: unit vector, x, y in the base frame; zeros = no contact."""

    @property
    def base(self) -> Pose:
        """T_world_base."""
        return self.links[self.base_link]

    @property
    def xy(self) -> tuple[float, float]:
        """x, y of the base, world frame, metres."""
        return self.base.position[0], self.base.position[1]

    @property
    def yaw(self) -> float:
        """Heading of the base, radians."""
        return yaw_from_quat(self.base.quat_xyzw)

    def distance_to(self, point: Vec3 | tuple[float, float]) -> float:
        """Returns the horizontal distance, metres, from the base to a point of the world frame."""
        x, y = self.xy
        return math.hypot(point[0] - x, point[1] - y)

    def in_base(self, point: Vec3 | tuple[float, float]) -> tuple[float, float]:
        """Transforms x, y of a world point to the base frame: distances ahead and to the left, metres."""
        x, y = self.xy
        dx, dy, c, s = point[0] - x, point[1] - y, math.cos(self.yaw), math.sin(self.yaw)
        return c * dx + s * dy, c * dy - s * dx


@dataclass(frozen=True, slots=True)
class Action:
    """A command to the robot, in effect until the next one."""

    linear: float = 0.0
    """Forward speed of the base, m/s."""
    angular: float = 0.0
    """Yaw rate of the base, rad/s."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Target positions of arm joints, radians or metres; other joints keep their targets."""
    grasp: bool | None = None
    """True = close the gripper and hold the object between the fingers, False = open it, None = no change."""


def observation_of(
    state: SceneState, robot: str, base_link: str, begin_ns: int, *, joints: Mapping[str, float] | None = None, held: str = ""
) -> Observation:
    """Returns the observation in a scene state.

    Args:
        state: poses and velocities of all links.
        robot: name of the robot.
        base_link: base link of the robot.
        begin_ns: stamp of the start of the episode.
        joints: positions of the arm joints, radians or metres.
        held: name of the body held by the gripper.
    """
    base = f"{robot}/{base_link}"
    row = state.links.index(base)
    rotation = matrix_from_quat(state.quats_xyzw[row])
    poses = {
        link: Pose((x, y, z), (qx, qy, qz, qw))
        for link, (x, y, z), (qx, qy, qz, qw) in zip(
            state.links, state.positions.tolist(), state.quats_xyzw.tolist(), strict=True
        )
    }
    return Observation(
        time=(state.stamp_ns - begin_ns) / NS_PER_S,
        links=poses,
        base_link=base,
        linear=float(state.twists[row, :3] @ rotation[:, 0]),
        angular=float(state.twists[row, 5]),
        joints=joints or {},
        held=held,
        speeds=dict(zip(state.links, np.linalg.norm(state.twists[:, :3], axis=1).tolist(), strict=True)),
    )


@lru_cache(maxsize=256)
def _model_body(model: str, text: str = "") -> BodySpec:
    body = load_spawnable("" if text else model, text, name=model, pose=Pose())
    assert isinstance(body, BodySpec), model
    return body


def item_body(item: Item) -> BodySpec:
    """Returns the body that physics loads for an item.

    Raises:
        SpawnError: the object does not exist or cannot be loaded.
    """
    body = _model_body(item.model, item.text)
    return BodySpec(item.name, body.model, item.pose, body.static, body.semantic_class, body.joints)


def item_root(item: Item) -> str:
    """Returns the full name of an item's root link, ``<name>/<link>``."""
    return f"{item.name}/{_model_body(item.model, item.text).model.root}"
