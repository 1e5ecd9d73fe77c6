"""What an episode of a task is, what a robot knows at one time, and what it does next. Pure values."""

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
    """A thing that an episode puts into the scene."""

    name: str
    """Letters, digits and ``_``; unique in the scene."""
    model: str
    """Name of an object of ours, see docs/objects.md, or path of a URDF."""
    pose: Pose
    """T_world_root at the begin."""
    text: str = ""
    """URDF that is loaded in place of the model's; empty = the model as it is."""


@dataclass(frozen=True, slots=True)
class Goal:
    """What is wanted."""

    text: str
    """One sentence for people."""
    position: Vec3 | None = None
    """World metres; None = the robot has to find it."""
    radius: float = 0.0
    """Metres: so near to it is there."""
    target: str = ""
    """Name of the item that it is about; empty = none."""
    target_class: str = ""
    """Semantic class of that item."""


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
    """Metres that the robot has to go at least; NaN = that says nothing about the task."""
    time_limit: float
    """Seconds of simulation time."""
    removed: tuple[str, ...] = ()
    """Names of bodies of the scene that are not there meanwhile."""


@dataclass(frozen=True, slots=True)
class View:
    """What is known at one time."""

    time: float
    """Seconds since the begin of the episode."""
    links: Mapping[str, Pose]
    """T_world_link of everything that moves, by ``<body>/<link>``."""
    base_link: str
    """``<robot>/<link>``: which of them is the robot's base."""
    linear: float = 0.0
    """Forward speed of the base, m/s."""
    angular: float = 0.0
    """Yaw rate of the base, rad/s."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Joints of the robot that are not of its drive, radians or metres."""
    held: str = ""
    """Name of what the robot's hand holds; empty = nothing."""
    speeds: Mapping[str, float] = field(default_factory=dict)
    """Of the origins of ``links``, m/s."""

    @property
    def base(self) -> Pose:
        """T_world_base."""
        return self.links[self.base_link]

    @property
    def xy(self) -> tuple[float, float]:
        """Of the base, world metres."""
        return self.base.position[0], self.base.position[1]

    @property
    def yaw(self) -> float:
        """Heading of the base, radians."""
        return yaw_from_quat(self.base.quat_xyzw)

    def distance_to(self, point: Vec3 | tuple[float, float]) -> float:
        """Returns the level distance from the base to a point, world metres."""
        x, y = self.xy
        return math.hypot(point[0] - x, point[1] - y)

    def in_base(self, point: Vec3 | tuple[float, float]) -> tuple[float, float]:
        """Returns how far in front of the base and how far to its left a point is, metres."""
        x, y = self.xy
        dx, dy, c, s = point[0] - x, point[1] - y, math.cos(self.yaw), math.sin(self.yaw)
        return c * dx + s * dy, c * dy - s * dx


@dataclass(frozen=True, slots=True)
class Action:
    """What the robot does until the next action."""

    linear: float = 0.0
    """Forward speed of the base, m/s."""
    angular: float = 0.0
    """Yaw rate of the base, rad/s."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Where joints of the arm shall be, radians or metres; those that are not named stay as they were told."""
    grasp: bool | None = None
    """True = close the hand and hold what is there, False = open it, None = as it is."""


def view_of(
    state: SceneState, robot: str, base_link: str, begin_ns: int, *, joints: Mapping[str, float] | None = None, held: str = ""
) -> View:
    """Returns what is known at the tick of a state.

    Args:
        state: where everything is.
        robot: its name.
        base_link: of its links, the base.
        begin_ns: stamp at which the episode began.
        joints: of the robot's arm.
        held: what its hand holds.
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
    return View(
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
    """Returns what physics loads of an item.

    Raises:
        SpawnError: there is no such object.
    """
    body = _model_body(item.model, item.text)
    return BodySpec(item.name, body.model, item.pose, body.static, body.semantic_class, body.joints)


def item_root(item: Item) -> str:
    """Returns the whole name of an item's root link, ``<name>/<link>``."""
    return f"{item.name}/{_model_body(item.model, item.text).model.root}"
