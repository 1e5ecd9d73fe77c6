"""Recognises the wheels of a description by their joints and shapes, and pairs left and right wheels. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.extents import MeshPoints, link_points, rigid_links
from gibson_sim.description.shapes import ROUND_KINDS
from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.robots.loading.drive import ALIGNED

_LEVEL = 0.14
"""Maximum sine of the angle between the axis of a wheel and the floor."""
_ROUND = 0.15
"""Maximum deviation of the outline of a wheel from a circle about its axis, as a fraction of its radius."""
_LEAST_LEVER = 0.02
"""Minimum lever arm, metres, and minimum sine of an angle between wheels that can turn or move a base in that direction."""
_OBLIQUE = 0.3
"""Maximum sine of the angle between the axis of an omni wheel and the line to the middle of all."""
_SAME = 0.03
"""Maximum difference of the two wheels of a pair in x and in z, metres."""
_MIN_ROLLERS = 4
"""Minimum number of free joints on a wheel that are its rollers."""
_LIFT = 0.2
"""Maximum height of a wheel above the lowest one, as a fraction of its radius."""


@dataclass(frozen=True, slots=True)
class Wheel:
    """A link that rotates about a level axis."""

    joint: UrdfJoint
    hub: NDArray[np.float64]
    """Centre of the wheel, (3,), in the root frame, metres."""
    axis: NDArray[np.float64]
    """Axis of the joint, unit vector, (3,), in the root frame."""
    radius: float
    """Radius, metres; 0 = none of its shapes can be measured."""
    rolls: bool
    """Whether its collision shape is a sphere, cylinder or capsule, or an unreadable mesh. Other meshes roll on the corners of their convex
    hull, which the engine also enlarges by a millimetre."""
    swivel: UrdfJoint | None
    """Nearest ancestor joint with a vertical axis; None = the wheel cannot be steered."""
    roller: float | None = None
    """Angle from the direction in which positive rotation rolls the wheel to the axis of its lowest roller, radians, counter-clockwise from
    above, within 90 degrees; None = it has no rollers with joints of their own."""

    @property
    def bottom(self) -> float:
        """Lowest point, z in the root frame, metres."""
        return float(self.hub[2]) - self.radius

    @property
    def is_caster(self) -> bool:
        """Whether it swivels freely, or is named a caster."""
        text = f"{self.joint.name} {self.joint.child}".lower()
        free = self.swivel is not None and not steers(self.swivel)
        return free or "caster" in text or "castor" in text

    @property
    def heading(self) -> float:
        """Direction in which positive rotation rolls it, radians from x of the root, counter-clockwise."""
        return math.atan2(-self.axis[0], self.axis[1])


@dataclass(frozen=True, slots=True)
class Pair:
    """Two wheels that mirror each other."""

    left: Wheel
    right: Wheel

    @property
    def x(self) -> float:
        """Position of its axle along x in the root frame, metres."""
        return float(self.left.hub[0] + self.right.hub[0]) / 2

    @property
    def swivels(self) -> bool:
        """Whether both wheels are steered."""
        return self.left.swivel is not None and self.right.swivel is not None


def steers(joint: UrdfJoint) -> bool:
    """Returns whether a joint with a vertical axis is a steering joint, not the swivel of a caster."""
    return joint.kind == "revolute" or "steer" in f"{joint.name} {joint.child}".lower()


def find_wheels(model: UrdfModel, points: MeshPoints | None = None, named: Sequence[str] = ()) -> tuple[list[Wheel], list[Wheel]]:
    """Returns (candidate wheels, which roll along x; others, which roll in another direction).

    Args:
        model: The links.
        points: Reads meshes; None = a wheel that is a mesh has no radius.
        named: Joints of wheels, regardless of their shapes; a wheel that is not round has no radius.
    """
    transforms = model.transforms()
    above = {joint.child: joint for joint in model.joints}
    wheels: list[Wheel] = []
    others: list[Wheel] = []
    rollers = {roller.name for joint in model.joints for roller in _rollers(model, joint)}
    for joint in model.joints:
        if joint.kind != "continuous" or joint.mimic is not None or joint.name in rollers:
            continue
        frame = transforms[joint.child]
        axis = frame[:3, :3] @ np.array(joint.axis)
        if abs(axis[2]) > _LEVEL:
            continue
        wheel = _wheel(model, joint, transforms, _swivel(joint, above, transforms), points)
        if wheel is None and joint.name in named:
            wheel = Wheel(joint, frame[:3, 3], axis, 0.0, _collides(model, joint), _swivel(joint, above, transforms))
        if wheel is None:
            continue
        (wheels if abs(axis[1]) >= ALIGNED else others).append(wheel)
    return wheels, others


def in_all_directions(wheels: Sequence[Wheel]) -> list[Wheel]:
    """Returns the wheels on the floor if they can move a base in all directions because their axes differ; else none.

    Such wheels have free rollers about their rim: three or more, of one size, none of which is steered, all with axes through their middle.
    """
    able = [wheel for wheel in wheels if not wheel.is_caster and wheel.swivel is None and wheel.radius > 0.0]
    lowest = min((wheel.bottom for wheel in able), default=0.0)
    standing = [wheel for wheel in able if wheel.bottom - lowest <= max(_LIFT * wheel.radius, 0.01)]
    if len(standing) < 3 or max(w.radius for w in standing) > (1.0 + _ROUND) * min(w.radius for w in standing):
        return []
    hubs = np.array([wheel.hub[:2] for wheel in standing])
    axes = np.array([wheel.axis[:2] for wheel in standing])
    arms = hubs - hubs.mean(axis=0)
    beside = np.abs(arms[:, 0] * axes[:, 1] - arms[:, 1] * axes[:, 0])
    if (beside > np.maximum(_OBLIQUE * np.hypot(*arms.T), _LEAST_LEVER)).any():
        return []
    # Rows map the velocity of the base (x, y, yaw) to that at which each wheel rolls.
    rows = np.stack([axes[:, 1], -axes[:, 0], -(arms * axes).sum(axis=1)], axis=1)
    return standing if np.linalg.matrix_rank(rows, tol=_LEAST_LEVER) == 3 else []


def find_pairs(wheels: list[Wheel]) -> list[Pair]:
    """Returns the pairs on the floor, from the rear to the front, without casters and unpaired wheels."""
    able = [wheel for wheel in wheels if not wheel.is_caster]
    pairs = _mirror_pairs(able)
    if not pairs:
        return []
    lowest = min(wheel.bottom for pair in pairs for wheel in (pair.left, pair.right))
    standing = [pair for pair in pairs if pair.left.bottom - lowest <= max(_LIFT * pair.left.radius, 0.01)]
    return sorted(standing, key=lambda pair: pair.x)


def _mirror_pairs(wheels: list[Wheel]) -> list[Pair]:
    pairs: list[Pair] = []
    # The outermost first, so that twin wheels on an axle are paired with their mirror images.
    left = sorted(wheels, key=lambda wheel: -wheel.hub[1])
    middle = (max(w.hub[1] for w in wheels) + min(w.hub[1] for w in wheels)) / 2 if wheels else 0.0
    paired: set[str] = set()
    for wheel in left:
        if wheel.hub[1] - middle < 0.01:
            continue
        matches = [
            other
            for other in wheels
            if other.joint.name not in paired
            and np.abs(wheel.hub[[0, 2]] - other.hub[[0, 2]]).max() <= _SAME
            and abs(wheel.hub[1] + other.hub[1] - 2 * middle) <= _SAME
            and abs(wheel.radius - other.radius) <= _ROUND * max(wheel.radius, other.radius)
        ]
        if matches:
            best = min(matches, key=lambda other: float(np.abs(wheel.hub[[0, 2]] - other.hub[[0, 2]]).sum()))
            paired.add(best.joint.name)
            pairs.append(Pair(wheel, best))
    return pairs


def _swivel(joint: UrdfJoint, above: dict[str, UrdfJoint], transforms: dict[str, Mat4]) -> UrdfJoint | None:
    """Returns the nearest ancestor joint with a vertical axis."""
    higher = above.get(joint.parent)
    while higher is not None:
        if higher.kind in ("revolute", "continuous"):
            axis = transforms[higher.child][:3, :3] @ np.array(higher.axis)
            if abs(axis[2]) >= ALIGNED:
                return higher
        higher = above.get(higher.parent)
    return None


def _wheel(
    model: UrdfModel, joint: UrdfJoint, transforms: dict[str, Mat4], swivel: UrdfJoint | None, points: MeshPoints | None
) -> Wheel | None:
    """Returns the wheel of a joint; None = neither its collision shapes nor its visuals are round about its axis."""
    frame = transforms[joint.child]
    hub, axis = frame[:3, 3], frame[:3, :3] @ np.array(joint.axis)
    on_rollers = _on_rollers(model, joint, transforms, swivel, points)
    if on_rollers is not None:
        return on_rollers
    links = [model.link(name) for name in rigid_links(model, joint.child)]
    measured = False
    for kind in ("collisions", "visuals"):
        offset = np.concatenate([link_points(getattr(link, kind), transforms[link.name], points) for link in links]) - hub
        if not len(offset):
            continue
        measured = True
        radius = _round_radius(offset, axis)
        if radius > 0.0:
            # Use the radius in the file if it agrees with the measured one: a cylinder rotated by 1.57 instead of pi/2 measures larger.
            shapes = [item.shape for link in links for item in getattr(link, kind)]
            near = [s.size[0] for s in shapes if s.kind in ROUND_KINDS and abs(s.size[0] - radius) < _ROUND * radius]
            rolls = kind == "collisions" and all(shape.kind in ROUND_KINDS for shape in shapes)
            return Wheel(joint, hub, axis, max(near, default=radius), rolls, swivel)
    return None if measured else Wheel(joint, hub, axis, 0.0, _collides(model, joint), swivel)


def _on_rollers(
    model: UrdfModel, joint: UrdfJoint, transforms: dict[str, Mat4], swivel: UrdfJoint | None, points: MeshPoints | None
) -> Wheel | None:
    """Returns the wheel of a joint if it stands on rollers with joints of their own; None = it does not."""
    rollers = _rollers(model, joint)
    if not rollers:
        return None
    frame = transforms[joint.child]
    hub, axis = frame[:3, 3], frame[:3, :3] @ np.array(joint.axis)
    lowest = min(rollers, key=lambda roller: float(transforms[roller.child][2, 3]))
    along = transforms[lowest.child][:3, :3] @ np.array(lowest.axis)
    ahead, aside = float(axis[1] * along[0] - axis[0] * along[1]), float(axis @ along)
    angle = math.atan(aside / ahead) if abs(ahead) > _LEAST_LEVER else math.pi / 2
    links = [model.link(name) for name in rigid_links(model, lowest.child)]
    for kind in ("collisions", "visuals"):
        spanned = np.concatenate([link_points(getattr(link, kind), transforms[link.name], points) for link in links])
        if len(spanned):
            radius = float(hub[2] - spanned[:, 2].min())
            return Wheel(joint, hub, axis, radius, kind == "collisions", swivel, angle)
    return None


def _rollers(model: UrdfModel, joint: UrdfJoint) -> list[UrdfJoint]:
    """Returns the joints of the rollers of the wheel of a joint; few free joints on it are something else."""
    if joint.kind != "continuous":
        return []
    rim = rigid_links(model, joint.child)
    found = [other for other in model.joints if other.parent in rim and other.kind == "continuous" and other.mimic is None]
    return found if len(found) >= _MIN_ROLLERS else []


def _round_radius(offset: NDArray[np.float64], axis: NDArray[np.float64]) -> float:
    """Returns the radius of points (N, 3) about an axis through the origin, metres; 0 = their outline is not a circle about it."""
    level = np.cross(axis, (0.0, 0.0, 1.0))
    flat = np.stack([offset @ level, offset[:, 2]], axis=-1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    radius = float((high - low).max()) / 2
    outline = np.abs(np.array([*-low, *high]) - radius).max()
    # The corners of a box are outside of its inscribed circle.
    corner = float(np.hypot(flat[:, 0], flat[:, 1]).max())
    return radius if outline <= _ROUND * radius and corner <= (1.0 + _ROUND) * radius else 0.0


def _collides(model: UrdfModel, joint: UrdfJoint) -> bool:
    """Returns whether the links of a joint have a collision shape."""
    return any(model.link(name).collisions for name in rigid_links(model, joint.child))
