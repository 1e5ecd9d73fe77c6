"""Defines the model behind an object's URDF: links of primitives, joints, masses. Plain values and arithmetic; NumPy only.

Frames: the origin of an object is the centre of its underside, x to the front, y to the left, z up; that of doors and windows is in the
hinge (see ``joined``). Metres, kilograms, radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.types import Vec3

F64 = NDArray[np.float64]
ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Primitive:
    """A primitive with mass: a collision shape of a link."""

    kind: Literal["box", "cylinder", "sphere"]
    size: Vec3
    """Edge lengths of a box; (radius, length, 0) of a cylinder about z; (radius, 0, 0) of a sphere; m."""
    middle: Vec3
    """Centre in the frame of the link, m."""
    rpy: Vec3 = ZERO
    """Roll, pitch, yaw about fixed axes, radians."""

    @property
    def volume(self) -> float:
        """Volume, m^3."""
        a, b, c = self.size
        if self.kind == "box":
            return a * b * c
        return math.pi * a * a * b if self.kind == "cylinder" else 4.0 / 3.0 * math.pi * a**3

    @property
    def second_moments(self) -> F64:
        """Second moments about the centre, (3, 3), axes of the link: the mean of x x^T over the volume, m^2."""
        a, b, c = self.size
        if self.kind == "box":
            moments = np.diag([a * a, b * b, c * c]) / 12.0
        elif self.kind == "cylinder":
            moments = np.diag([a * a / 4.0, a * a / 4.0, b * b / 12.0])
        else:
            moments = np.eye(3) * a * a / 5.0
        R = rotation(self.rpy)
        return np.asarray(R @ moments @ R.T)


@dataclass(frozen=True, slots=True)
class ObjectLink:
    """A rigid link."""

    name: str
    mass: float
    """Mass, kg, distributed uniformly over the primitives."""
    primitives: tuple[Primitive, ...]
    friction: float = 0.5
    rolling_friction: float = 0.0
    """Coefficient of rolling friction, m; 0 = rolls without resistance."""
    center: Vec3 | None = None
    """Centre of mass, m; None = that of the primitives. Set for a handle balanced by a spring."""
    visual: bool = True
    """Whether the link has a mesh."""
    mesh: str = ""
    """Name of a mesh shared by several links; empty = the name of the link."""


@dataclass(frozen=True, slots=True)
class ObjectJoint:
    """A joint between two links."""

    name: str
    kind: Literal["revolute", "prismatic", "fixed"]
    parent: str
    child: str
    origin: Vec3
    """Origin of the child in the frame of the parent at position 0, m; their axes are parallel."""
    axis: Vec3 = (0.0, 0.0, 1.0)
    lower: float = 0.0
    upper: float = 0.0
    damping: float = 0.0
    """Damping, N m s/rad or N s/m."""


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """Model of an object."""

    name: str
    semantic_class: str
    size: Vec3
    """Depth (x), width (y), height (z) of the meshes with all joints at 0, m."""
    links: tuple[ObjectLink, ...]
    """Links, the root first."""
    joints: tuple[ObjectJoint, ...] = ()
    built_in: bool = False
    """Whether it is fixed to the world, as doors and windows are."""

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return sum(link.mass for link in self.links)


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties:
    """Mass, centre of mass and inertia of a link."""

    mass: float
    """Mass, kg."""
    center: F64
    """Centre of mass, (3,), m, frame of the link."""
    inertia: F64
    """Inertia about the centre of mass, (3, 3), kg m^2."""


def mass_properties(link: ObjectLink) -> MassProperties:
    """Returns the mass properties of a link; its mass is distributed uniformly over its primitives."""
    total = sum(primitive.volume for primitive in link.primitives)
    center = sum((primitive.volume / total * np.array(primitive.middle) for primitive in link.primitives), np.zeros(3))
    second = np.zeros((3, 3))
    for primitive in link.primitives:
        offset = np.array(primitive.middle) - center
        second += link.mass * primitive.volume / total * (primitive.second_moments + np.outer(offset, offset))
    inertia = np.trace(second) * np.eye(3) - second
    return MassProperties(link.mass, center if link.center is None else np.array(link.center), inertia)


def rotation(rpy: Sequence[float]) -> F64:
    """Returns the rotation Rz(yaw) Ry(pitch) Rx(roll), (3, 3). ``rpy``: radians."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def box(low: Vec3, high: Vec3) -> Primitive:
    """Returns the box between two opposite corners, m."""
    size = tuple(abs(b - a) for a, b in zip(low, high, strict=True))
    middle = tuple((a + b) / 2.0 for a, b in zip(low, high, strict=True))
    return Primitive("box", (size[0], size[1], size[2]), (middle[0], middle[1], middle[2]))


def cylinder(radius: float, low: float, high: float, x: float = 0.0, y: float = 0.0) -> Primitive:
    """Returns a cylinder about a vertical axis between two heights, m."""
    return Primitive("cylinder", (radius, high - low, 0.0), (x, y, (low + high) / 2.0))


def resting_sphere(radius: float) -> Primitive:
    """Returns a sphere that rests on z = 0."""
    return Primitive("sphere", (radius, 0.0, 0.0), (0.0, 0.0, radius))


def ring_wall(bottom: float, top: float, low: float, high: float, thickness: float, sides: int = 8) -> tuple[Primitive, ...]:
    """Returns a ring of boxes: the wall of a bowl or a bin, open at the top.

    Args:
        bottom: outer radius at the height ``low``, metres.
        top: outer radius at the height ``high``, metres.
        low: height of the lower edge, metres.
        high: height of the upper edge, metres.
        thickness: thickness of the wall, metres.
        sides: number of boxes.
    """
    tilt = math.atan2(top - bottom, high - low)
    length = math.hypot(top - bottom, high - low)
    # The ends of a side are on the outline, so its centre is nearer to the axis.
    apothem = ((bottom + top) / 2.0 - thickness / 2.0 * math.cos(tilt)) * math.cos(math.pi / sides)
    width = 2.0 * max(bottom, top) * math.sin(math.pi / sides)
    walls = []
    for k in range(sides):
        yaw = 2.0 * math.pi * (k + 0.5) / sides
        middle = (apothem * math.cos(yaw), apothem * math.sin(yaw), (low + high) / 2.0)
        walls.append(Primitive("box", (thickness, width, length), middle, (0.0, tilt, yaw)))
    return tuple(walls)
