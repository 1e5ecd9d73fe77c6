"""The rules of grasping: when a gripper grasps an object, which object, and when it releases it. Pure.

``PhysicsWorld.arms`` applies them, and ``docs/manipulation.md`` describes them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from gibson_sim.description.urdf import UrdfModel
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.commands import JointCommand, JointEfforts, JointPositions, JointTrajectory, JointVelocities
from gibson_sim.robots.spec import GripperSpec

GraspMode = Literal["physical", "assisted", "sticky"]
GRASP_MODES: tuple[GraspMode, ...] = ("physical", "assisted", "sticky")
GripperMove = Literal["closes", "opens", "stays"]
_SMALL_MOVE = 0.02
"""Minimum motion, as a fraction of the range of a gripper, of a command that closes or opens it."""
_HANDLES = ("handle", "knob")
"""Words in the names of links that are handles."""


@dataclass(frozen=True, slots=True)
class GraspSettings:
    """Settings of grippers for holding objects."""

    mode: GraspMode = "assisted"
    """Grasp mode. physical: only friction. assisted: a ball joint to an object in reach. sticky: a rigid joint to an object that the
    gripper touches."""
    distance: float = 0.2
    """assisted: greatest distance from the tool's origin to a surface, metres."""
    max_force: float = 500.0
    """Force limit of the joint between gripper and object, N; sticky: also its torque limit, N m. A stronger pull moves them apart."""
    release_force: float = 0.0
    """Force above which the gripper releases, N; 0 = never."""
    release_angle: float = math.radians(90.0)
    """Opening angle beyond which the gripper releases a door, radians; 0 = never."""

    def __post_init__(self) -> None:
        if self.mode not in GRASP_MODES:
            raise ConfigError(f"grasp mode is {quoted(self.mode)}, must be one of {', '.join(GRASP_MODES)}")
        for name, unit in (("distance", "m"), ("max_force", "N")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"grasp {name} is {value} {unit}, must be a finite number above 0")
        for name, unit in (("release_force", "N"), ("release_angle", "rad")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigError(f"grasp {name} is {value} {unit}, must be a finite number, 0 or more; 0 = never let go for it")


@dataclass(frozen=True, slots=True)
class GraspState:
    """State of a grasp."""

    arm: str
    mode: GraspMode
    holding: bool = False
    body: str = ""
    """Name of the held body or other robot."""
    link: str = ""
    force: float = 0.0
    """Load of the joint in the last step, N; physical: sum of the normal forces at all points of contact."""
    torque: float = 0.0
    """Torque on a rigid joint in the last step, N m."""
    reason: str = ""
    """Reason why it holds no object, or released it; empty if it was not commanded to grasp, or is open."""


class Candidate(NamedTuple):
    """A link that a gripper can grasp."""

    body: str
    link: str
    distance: float
    """Distance, metres; the smallest is best."""


def is_handle(link: str) -> bool:
    """Returns whether the name of a link is that of a handle or a knob."""
    return any(word in link.lower() for word in _HANDLES)


def best_candidate(candidates: Iterable[Candidate], within: float) -> Candidate | None:
    """Returns the link that a gripper grasps: the nearest handle or knob within a distance, else the nearest link; None = none."""
    near = [candidate for candidate in candidates if candidate.distance < within]
    return min(near, key=lambda c: (not is_handle(c.link), c.distance, c.body, c.link), default=None)


def gripper_move(gripper: GripperSpec, command: JointCommand, positions: Mapping[str, float]) -> GripperMove:
    """Returns the effect of a command on a gripper with joints at ``positions``, determined by the first of its joints in the command.

    A command without names applies to the joints in ``positions``, in their order.
    """
    if isinstance(command, JointTrajectory):
        rows = command.points[-1].positions if command.points else ()
    elif isinstance(command, JointPositions):
        rows = command.positions
    else:
        rows = command.efforts if isinstance(command, JointEfforts) else command.velocities
    commanded = dict(zip(command.names or tuple(positions), rows, strict=False))
    span = gripper.closed - gripper.open
    low, high = sorted((gripper.open, gripper.closed))
    for joint in gripper.joints:
        if joint in commanded:
            speeds = isinstance(command, (JointVelocities, JointEfforts))
            # A finger that is pressed beyond its limit counts as at its limit.
            now = min(max(positions[joint], low), high)
            # Any speed is sufficient, since the motion has no end.
            change = math.copysign(1.0, span) * commanded[joint] if speeds else (commanded[joint] - now) / span
            least = 0.0 if speeds else _SMALL_MOVE
            return "closes" if change > least else "opens" if change < -least else "stays"
    return "stays"


def hinge_of(model: UrdfModel, link: str) -> str | None:
    """Returns the hinge of the door of a link: the first revolute joint from the root to the link; None = no hinge."""
    above = {joint.child: joint for joint in model.joints}
    hinge = None
    while link in above:
        joint = above[link]
        if joint.kind in ("revolute", "continuous"):
            hinge = joint.name
        link = joint.parent
    return hinge


def release_reason(settings: GraspSettings, force: float, hinge: float | None) -> str:
    """Returns the reason why a gripper must release its object; empty = it must not.

    Args:
        settings: The limits.
        force: Load of the joint in the last step, N.
        hinge: Opening angle of the held door, radians; None = the object is not a door.
    """
    if settings.release_force and force > settings.release_force:
        return f"let go: {force:.0f} N is more than the set force, {settings.release_force:g} N"
    if settings.release_angle and hinge is not None and abs(hinge) > settings.release_angle:
        most = math.degrees(settings.release_angle)
        return f"let go: the door is {math.degrees(abs(hinge)):.1f} degrees open, more than the set angle, {most:g} degrees"
    return ""
