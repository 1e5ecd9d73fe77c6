"""The kinematic tree of a URDF: links, shapes, joints, mimic joints, and its scaling. Pure values; ``description.urdf`` reads them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gibson_sim.description.gazebo import GazeboTags
from gibson_sim.description.shapes import Shape
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.quoting import clipped, quoted
from gibson_sim.types import Pose, Rgba, Vec3

MAX_NAME_BYTES = 500
"""Maximum length of the name of a link or joint, bytes: the physics engine copies names into buffers of fixed size."""
JOINT_TYPES = ("fixed", "continuous", "revolute", "prismatic", "floating", "planar")


@dataclass(frozen=True, slots=True)
class UrdfVisual:
    """A visual of a link."""

    shape: Shape
    pose: Pose
    """T_link_visual."""
    color: Rgba | None
    """Colour of its material, sRGB and alpha, 0 to 1; None = the material has no colour."""
    texture: str = ""
    """Absolute path of the image of its material, which replaces the colour; empty = none."""


@dataclass(frozen=True, slots=True)
class UrdfCollision:
    """A collision shape of a link."""

    shape: Shape
    pose: Pose
    """T_link_shape."""


@dataclass(frozen=True, slots=True)
class Inertial:
    """Mass properties of a link."""

    mass: float
    """Mass, kg."""
    pose: Pose
    """T_link_inertial: its position is the centre of mass."""
    inertia: tuple[float, float, float, float, float, float]
    """Inertia ixx, ixy, ixz, iyy, iyz, izz in the inertial frame, kg m^2."""


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """A rigid link."""

    name: str
    visuals: tuple[UrdfVisual, ...] = ()
    collisions: tuple[UrdfCollision, ...] = ()
    inertial: Inertial | None = None
    friction: float | None = None
    """Coulomb friction from ``<contact><lateral_friction value=""/></contact>`` (an extension of Bullet); None = not given."""
    rolling_friction: float = 0.0
    """Rolling friction of a round link, metres, from ``<rolling_friction value=""/>`` in ``<contact>``."""
    spinning_friction: float = 0.0
    """Torsional friction about the contact normal, metres, from ``<spinning_friction value=""/>``."""
    stiffness: float = 0.0
    """Contact stiffness, N/m, from ``<stiffness value=""/>``; 0 = rigid contact. A body with both rests mainly on its rigid contacts."""
    contact_damping: float = 0.0
    """Contact damping, N s/m, from ``<damping value=""/>``."""


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint; at position 0 the child frame is at ``pose`` in the parent frame."""

    name: str
    kind: str
    """Type, one of ``JOINT_TYPES``."""
    parent: str
    child: str
    pose: Pose
    """T_parent_child at joint position 0."""
    axis: Vec3
    """Axis, unit vector in the child frame."""
    lower: float = 0.0
    """Lower position limit, radians or metres; lower > upper = no limits."""
    upper: float = -1.0
    effort: float = 0.0
    """Effort limit, N m or N; 0 = not given."""
    velocity: float = 0.0
    """Velocity limit, rad/s or m/s; 0 = not given."""
    damping: float = 0.0
    """Damping, N m s/rad or N s/m."""
    mimic: Mimic | None = None
    """Leader of a mimic joint; None for other joints."""
    friction: float = 0.0
    """Dry friction while the motor is off, N m or N."""

    @property
    def is_bounded(self) -> bool:
        """Whether the joint has position limits."""
        return self.kind != "continuous" and self.lower <= self.upper

    @property
    def has_motor(self) -> bool:
        """Whether the joint can be commanded: mimic joints cannot, and a continuous joint without effort and velocity limits is a caster."""
        if self.mimic is not None:
            return False
        return self.kind in ("revolute", "prismatic") or (self.kind == "continuous" and max(self.effort, self.velocity) > 0.0)

    def motion(self, position: float) -> Mat4:
        """Returns T_zero_child, (4, 4): the motion of the child frame from position 0 to ``position`` (radians or metres)."""
        x, y, z = self.axis
        if self.kind == "prismatic":
            return np.array(
                [
                    [1.0, 0.0, 0.0, x * position],
                    [0.0, 1.0, 0.0, y * position],
                    [0.0, 0.0, 1.0, z * position],
                    [0.0, 0.0, 0.0, 1.0],
                ]
            )
        s, c = math.sin(position), math.cos(position)
        v = 1.0 - c
        return np.array(
            [
                [c + x * x * v, x * y * v - z * s, x * z * v + y * s, 0.0],
                [x * y * v + z * s, c + y * y * v, y * z * v - x * s, 0.0],
                [x * z * v - y * s, y * z * v + x * s, c + z * z * v, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


@dataclass(frozen=True, slots=True)
class UrdfModel:
    """A validated tree of links and joints."""

    name: str
    path: Path
    links: tuple[UrdfLink, ...]
    """Links, the root first, each parent before its children."""
    joints: tuple[UrdfJoint, ...]
    """Joints in the order of the file."""
    warnings: tuple[str, ...] = field(default=())
    gazebo: GazeboTags = field(default_factory=GazeboTags)
    """Content of its ``<gazebo>`` elements."""

    def __post_init__(self) -> None:
        """Raises RobotError if a name is longer than the physics engine can hold, which would crash."""
        for what, names in (("link", [link.name for link in self.links]), ("joint", [joint.name for joint in self.joints])):
            longest = max(names, key=len, default="")
            if len(longest.encode()) > MAX_NAME_BYTES:
                raise RobotError(
                    f"{self.path}: {what} {clipped(longest, 40)} has a name of {len(longest.encode())} bytes, at most {MAX_NAME_BYTES} are "
                    "allowed; shorten it"
                )

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        return self.links[0].name

    def link(self, name: str) -> UrdfLink:
        """Returns the link of this name, or raises RobotError that lists the known ones."""
        for link in self.links:
            if link.name == name:
                return link
        raise RobotError(f"{self.path}: no link {quoted(name)}; known: {', '.join(link.name for link in self.links)}")

    def joint(self, name: str) -> UrdfJoint:
        """Returns the joint of this name, or raises RobotError that lists the known ones."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise RobotError(f"{self.path}: no joint {quoted(name)}; known: {', '.join(joint.name for joint in self.joints)}")

    def fixed_to_root(self) -> tuple[str, ...]:
        """Returns the root and the links that are connected to it by fixed joints only, in the order of ``links``."""
        names = {self.root}
        fixed_parent = {joint.child: joint.parent for joint in self.joints if joint.kind == "fixed"}
        for link in self.links[1:]:
            if fixed_parent.get(link.name) in names:
                names.add(link.name)
        return tuple(link.name for link in self.links if link.name in names)

    def transforms(self, positions: Mapping[str, float] | None = None) -> dict[str, Mat4]:
        """Returns link name -> T_root_link, (4, 4), with joints at ``positions`` (radians or metres); missing joints are at 0."""
        joint_positions = positions or {}
        by_child = {joint.child: joint for joint in self.joints}
        transforms = {self.root: matrix_from_pose(Pose())}
        for link in self.links[1:]:
            joint = by_child[link.name]
            transforms[link.name] = transforms[joint.parent] @ matrix_from_pose(joint.pose)
            if joint_positions.get(joint.name):
                transforms[link.name] = transforms[link.name] @ joint.motion(joint_positions[joint.name])
        return transforms

    def with_followers(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Returns the joint positions with those of mimic joints added; missing leaders are at 0."""
        all_positions = dict(positions)
        for joint in self.joints:
            if joint.mimic is not None:
                all_positions[joint.name] = joint.mimic.position(positions.get(joint.mimic.leader, 0.0))
        return all_positions


def scaled_model(model: UrdfModel, factor: float) -> UrdfModel:
    """Returns the model with all lengths scaled by ``factor`` at constant density: mass scales with the third power.

    The travel of prismatic joints scales with ``factor``; angles do not change. Damping and friction scale with mass and inertia, so that joints
    come to rest as before.
    """
    if factor == 1.0:
        return model
    links = tuple(_link(link, factor) for link in model.links)
    factors = {joint.name: factor if joint.kind == "prismatic" else 1.0 for joint in model.joints}
    return replace(model, links=links, joints=tuple(_joint(joint, factor, factors) for joint in model.joints))


def _link(link: UrdfLink, factor: float) -> UrdfLink:
    inertial = link.inertial
    if inertial is not None:
        ixx, ixy, ixz, iyy, iyz, izz = (moment * factor**5 for moment in inertial.inertia)
        inertial = Inertial(inertial.mass * factor**3, _pose(inertial.pose, factor), (ixx, ixy, ixz, iyy, iyz, izz))
    return replace(
        link,
        visuals=tuple(replace(v, shape=_shape(v.shape, factor), pose=_pose(v.pose, factor)) for v in link.visuals),
        collisions=tuple(replace(c, shape=_shape(c.shape, factor), pose=_pose(c.pose, factor)) for c in link.collisions),
        inertial=inertial,
    )


def _joint(joint: UrdfJoint, factor: float, factors: dict[str, float]) -> UrdfJoint:
    travel_factor = factors[joint.name]
    # The damping of a prismatic joint (N s/m) scales with the mass, that of a hinge (N m s/rad) with the inertia.
    damping = joint.damping * factor ** (3 if joint.kind == "prismatic" else 5)
    # The friction of a prismatic joint (N) scales with mass times length, that of a hinge (N m) with the inertia.
    friction = joint.friction * factor ** (4 if joint.kind == "prismatic" else 5)
    pose, lower, upper = _pose(joint.pose, factor), joint.lower * travel_factor, joint.upper * travel_factor
    return replace(
        joint,
        pose=pose,
        lower=lower,
        upper=upper,
        damping=damping,
        mimic=_mimic(joint, travel_factor, factors),
        friction=friction,
    )


def _mimic(joint: UrdfJoint, travel_factor: float, factors: dict[str, float]) -> Mimic | None:
    """Returns the mimic of a joint whose travel is scaled by ``stretch``, and that of its leader by its factor in ``factors``."""
    if joint.mimic is None:
        return None
    multiplier = joint.mimic.multiplier * travel_factor / factors[joint.mimic.leader]
    return replace(joint.mimic, multiplier=multiplier, offset=joint.mimic.offset * travel_factor)


def _shape(shape: Shape, factor: float) -> Shape:
    x, y, z = shape.size
    return replace(shape, size=(x * factor, y * factor, z * factor))


def _pose(pose: Pose, factor: float) -> Pose:
    x, y, z = pose.position
    position: Vec3 = (x * factor, y * factor, z * factor)
    return replace(pose, position=position)


@dataclass(frozen=True, slots=True)
class Mimic:
    """A mimic joint: its position is ``multiplier`` times that of its leader, plus ``offset``."""

    leader: str
    """Name of the leader, which is not a mimic joint itself."""
    multiplier: float = 1.0
    offset: float = 0.0
    """Offset, radians or metres."""

    def position(self, leader: float) -> float:
        """Returns the position of the mimic joint for the position of its leader."""
        return self.multiplier * leader + self.offset


def leaders(mimics: Mapping[str, Mimic], moving: Collection[str], where: str) -> dict[str, Mimic]:
    """Resolves chains of mimic joints: returns each mimic joint with the last joint of its chain as leader.

    Args:
        mimics: Mimic joint -> its leader in the file, which may itself be a mimic joint.
        moving: All movable joints.
        where: The file, for messages.

    Raises:
        RobotError: a leader does not exist or is fixed, or the chain is a cycle.
    """
    resolved = {}
    for name, mimic in mimics.items():
        chain = [name]
        while True:
            if mimic.leader not in moving:
                raise RobotError(
                    f"{where}: joint {quoted(chain[-1])} mimics {quoted(mimic.leader)}, which is not a movable joint; "
                    f"movable joints: {', '.join(moving) or 'none'}"
                )
            if mimic.leader in chain:
                raise RobotError(
                    f"{where}: joints {', '.join(map(repr, chain))} mimic each other in a cycle; one of them must not"
                )
            next_mimic = mimics.get(mimic.leader)
            if next_mimic is None:
                break
            chain.append(mimic.leader)
            mimic = Mimic(next_mimic.leader, mimic.multiplier * next_mimic.multiplier, mimic.position(next_mimic.offset))
        resolved[name] = mimic
    return resolved
