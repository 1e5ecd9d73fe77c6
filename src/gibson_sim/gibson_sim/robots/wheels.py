"""Finds the wheels of a robot in its URDF: what is round, turns about a level axis across the robot and reaches the floor. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4
from gibson_sim.robots.extents import MeshPoints, link_points, rigid_links
from gibson_sim.robots.urdf_model import UrdfJoint, UrdfModel

_STRAIGHT = 0.99
"""Cosine of the largest angle between an axis and where it should point."""
_LEVEL = 0.14
"""Sine of the largest angle between an axis and the floor."""
_ROUND = 0.15
"""Part of its radius by which the outline of a wheel may differ from a circle about its axis."""
_SAME = 0.03
"""Metres by which the two wheels of a pair may differ in x and in z."""
_LIFT = 0.2
"""Part of its radius by which a wheel may hang above the lowest one."""


@dataclass(frozen=True, slots=True)
class Wheel:
    """What turns about a level axis."""

    joint: UrdfJoint
    hub: NDArray[np.float64]
    """(3,), in the root's frame, metres."""
    radius: float
    """Metres; 0 = it has no shape that can be measured."""
    collides: bool
    """Whether it has a collision shape."""
    swivel: UrdfJoint | None
    """The nearest joint above it that turns about an upright axis; None = it cannot be steered."""

    @property
    def bottom(self) -> float:
        """Lowest point, z in the root's frame, metres."""
        return float(self.hub[2]) - self.radius

    @property
    def is_caster(self) -> bool:
        """Whether it swivels freely, or is called a caster."""
        text = f"{self.joint.name} {self.joint.child}".lower()
        free = self.swivel is not None and not steers(self.swivel)
        return free or "caster" in text or "castor" in text


@dataclass(frozen=True, slots=True)
class Pair:
    """Two wheels that mirror each other."""

    left: Wheel
    right: Wheel

    @property
    def x(self) -> float:
        """Of its axle, in the root's frame, metres."""
        return float(self.left.hub[0] + self.right.hub[0]) / 2

    @property
    def swivels(self) -> bool:
        """Whether both wheels are on joints that steer."""
        return self.left.swivel is not None and self.right.swivel is not None


def steers(joint: UrdfJoint) -> bool:
    """Returns whether a joint about an upright axis is one that steers, and not the swivel of a caster."""
    return joint.kind == "revolute" or "steer" in f"{joint.name} {joint.child}".lower()


def find_wheels(model: UrdfModel, points: MeshPoints | None = None) -> tuple[list[Wheel], list[UrdfJoint]]:
    """Returns (what may be a wheel, continuous joints whose axis is level but along x).

    Args:
        model: the links.
        points: reads meshes; None = a wheel that is a mesh has no radius.
    """
    transforms = model.transforms()
    above = {joint.child: joint for joint in model.joints}
    wheels, sideways = [], []
    for joint in model.joints:
        if joint.kind != "continuous" or joint.mimic is not None:
            continue
        frame = transforms[joint.child]
        axis = frame[:3, :3] @ np.array(joint.axis)
        if abs(axis[2]) > _LEVEL:
            continue
        wheel = _wheel(model, joint, transforms, _swivel(joint, above, transforms), points)
        if wheel is None:
            continue
        if abs(axis[1]) >= _STRAIGHT:
            wheels.append(wheel)
        elif abs(axis[0]) >= _STRAIGHT:
            sideways.append(joint)
    return wheels, sideways


def find_pairs(wheels: list[Wheel]) -> list[Pair]:
    """Returns the pairs that stand on the floor, from the rear to the front; casters and what has no mirror image are left out."""
    able = [wheel for wheel in wheels if not wheel.is_caster]
    pairs = _mirrored(able)
    if not pairs:
        return []
    lowest = min(wheel.bottom for pair in pairs for wheel in (pair.left, pair.right))
    standing = [pair for pair in pairs if pair.left.bottom - lowest <= max(_LIFT * pair.left.radius, 0.01)]
    return sorted(standing, key=lambda pair: pair.x)


def _mirrored(wheels: list[Wheel]) -> list[Pair]:
    pairs: list[Pair] = []
    # The widest first: wheels side by side on one axle belong to their own likes.
    left = sorted(wheels, key=lambda wheel: -wheel.hub[1])
    middle = (max(w.hub[1] for w in wheels) + min(w.hub[1] for w in wheels)) / 2 if wheels else 0.0
    taken: set[str] = set()
    for wheel in left:
        if wheel.hub[1] - middle < 0.01:
            continue
        likes = [
            other
            for other in wheels
            if other.joint.name not in taken
            and np.abs(wheel.hub[[0, 2]] - other.hub[[0, 2]]).max() <= _SAME
            and abs(wheel.hub[1] + other.hub[1] - 2 * middle) <= _SAME
            and abs(wheel.radius - other.radius) <= _ROUND * max(wheel.radius, other.radius)
        ]
        if likes:
            best = min(likes, key=lambda other: float(np.abs(wheel.hub[[0, 2]] - other.hub[[0, 2]]).sum()))
            taken.add(best.joint.name)
            pairs.append(Pair(wheel, best))
    return pairs


def _swivel(joint: UrdfJoint, above: dict[str, UrdfJoint], transforms: dict[str, Mat4]) -> UrdfJoint | None:
    higher = above.get(joint.parent)
    while higher is not None:
        if higher.kind in ("revolute", "continuous"):
            axis = transforms[higher.child][:3, :3] @ np.array(higher.axis)
            if abs(axis[2]) >= _STRAIGHT:
                return higher
        higher = above.get(higher.parent)
    return None


def _wheel(
    model: UrdfModel, joint: UrdfJoint, transforms: dict[str, Mat4], swivel: UrdfJoint | None, points: MeshPoints | None
) -> Wheel | None:
    """Returns the joint as a wheel; None = what hangs on it is not round about its axis."""
    frame = transforms[joint.child]
    hub, axis = frame[:3, 3], frame[:3, :3] @ np.array(joint.axis)
    links = [model.link(name) for name in rigid_links(model, joint.child)]
    collides = any(link.collisions for link in links)
    for kind in ("collisions", "visuals"):
        spanned = [link_points(getattr(link, kind), transforms[link.name], points) for link in links]
        offset = np.concatenate(spanned) - hub
        if len(offset):
            break
    else:
        return Wheel(joint, hub, 0.0, collides, swivel)
    level = np.cross(axis, (0.0, 0.0, 1.0))
    flat = np.stack([offset @ level, offset[:, 2]], axis=-1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    radius = float((high - low).max()) / 2
    outline = np.abs(np.array([*-low, *high]) - radius).max()
    if radius <= 0 or outline > _ROUND * radius:
        return None
    # What is written there, where it is what was measured: a cylinder that is turned by 1.57 and not by pi/2 seems larger.
    exact = [item.shape.size[0] for link in links for item in getattr(link, kind) if item.shape.kind in ("sphere", "cylinder")]
    near = [size for size in exact if abs(size - radius) < _ROUND * radius]
    return Wheel(joint, hub, max(near, default=radius), collides, swivel)
