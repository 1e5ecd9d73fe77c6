"""Guesses the ``robot.yaml`` of a robot that has none: its drive, its height above the floor, a lidar and a camera. Pure.

Each guess has a line of its own; what cannot be guessed is a ``RobotError`` that says what to do. ``find_wheels`` and ``find_pairs`` recognise
wheels by their joints and shapes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.extents import MeshPoints, link_points, rigid_links
from gibson_sim.description.rigid_groups import MOVING_TYPES
from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.quoting import quoted
from gibson_sim.robots.loading.base_frame import FOOTPRINT
from gibson_sim.robots.loading.drive import ALIGNED

DESCRIPTION_SUFFIXES = (".urdf", ".xacro")
"""Suffixes of files that describe a robot without a ``robot.yaml``, lower case."""
_LEVEL = 0.14
"""Sine of the largest angle between the axis of a wheel and the floor."""
_ROUND = 0.15
"""Greatest deviation of the outline of a wheel from a circle about its axis, as a fraction of its radius."""
_SAME = 0.03
"""Greatest difference of the two wheels of a pair in x and in z, metres."""
_LIFT = 0.2
"""Greatest height of a wheel above the lowest one, as a fraction of its radius."""
_FLOOR = 0.005
"""Distance from the floor at which the root counts as on it, metres."""
_LEAST_DROP, _MAX_DROP = 0.001, 0.03
"""Least and greatest height of wheels above the floor that is corrected, metres; more is an error in the file."""
_TOUCHES = 0.01
"""Height above the lowest point of the wheels below which a link counts as touching the floor, metres."""
_GRIP = 1.0
"""Friction of driven wheels."""
_MAX_STEERING_DEG = 30.0
"""Limit for steering joints that have none."""
_LIDAR = re.compile(r"scan|laser|lidar|hokuyo|velodyne|ouster", re.IGNORECASE)
_CAMERA = re.compile(r"camera\d*(_(rgb|color|front|link|frame))*$", re.IGNORECASE)
_MOUNT = re.compile(r"mount|bracket|tower|plate|support|screw|holder", re.IGNORECASE)
_NO_COLOR = re.compile(r"depth|infra|ir_|_ir\b|right|fisheye", re.IGNORECASE)
_MECANUM = re.compile(r"mecanum|mechanum", re.IGNORECASE)
_BY_HAND = "write a robot.yaml with the drive that it has (docs/robots.md)"


@dataclass(frozen=True, slots=True)
class DerivedRobot:
    """A guessed ``robot.yaml``."""

    values: dict[str, Any]
    """Its keys and values, without ``urdf``."""
    notes: tuple[str, ...]
    """One line for each guess."""


def derive_robot(model: UrdfModel, points: MeshPoints | None = None, *, needs_drive: bool = True) -> DerivedRobot:
    """Returns a guess of the ``robot.yaml`` for a description.

    Args:
        model: The description.
        points: Reads meshes; None = meshes are not measured.
        needs_drive: Whether a robot without wheels is an error, or has no drive.

    Raises:
        RobotError: there are no wheels, or no drive fits them; one line.
    """
    values: dict[str, Any] = {}
    notes: list[str] = []
    try:
        drive, wheels = _derive_drive(model, points, notes)
    except RobotError:
        if needs_drive:
            raise
        drive, wheels = None, []
        notes.append("drive: none, no wheels were found that could drive it")
    if drive is not None:
        drop = _drop(model, wheels, points)
        _base(model, min(wheel.bottom for wheel in wheels) - drop, values, notes)
        if drop:
            values["wheel_drop"] = {wheel.joint.name: round(drop, 5) for wheel in wheels}
            notes.append(f"wheel_drop: {drop * 1000:.2g} mm, since casters or the base reach that much lower than the wheels")
        if drive["type"] in ("differential", "ackermann"):
            _friction(model, wheels, points, values, notes)
        values["drive"] = drive
    _sensors(model, values, notes)
    return DerivedRobot(values, tuple(notes))


def _derive_drive(model: UrdfModel, points: MeshPoints | None, notes: list[str]) -> tuple[dict[str, Any], list[Wheel]]:
    wheels, sideways = find_wheels(model, points)
    pairs = find_pairs(wheels)
    if not pairs:
        raise RobotError(_no_drive_reason(model, wheels, sideways))
    fixed = [pair for pair in pairs if not (pair.left.swivel or pair.right.swivel)]
    steered = [pair for pair in pairs if pair.swivels]
    lone = [
        w
        for w in wheels
        if w.swivel is not None and steers(w.swivel) and not w.is_caster and all(w not in (p.left, p.right) for p in steered)
    ]
    if lone or not fixed:
        names = ", ".join(quoted(w.swivel.name) for w in wheels if w.swivel is not None and not w.is_caster)
        raise RobotError(
            f"{model.path}: no drive fits wheels that are steered by {names}: a car is driven by two wheels that do not steer, and steered "
            f"by two in front of them; {_BY_HAND}"
        )
    if steered:
        driven, front = fixed[0], steered[-1]
        if front.x <= driven.x:
            raise RobotError(
                f"{model.path}: its steered wheels ({front.left.joint.name}, {front.right.joint.name}) are behind those that drive, which is not "
                "simulated; a car is steered in front"
            )
        drive = _ackermann(driven, front)
        used = [driven, front]
    elif len(fixed) == 1:
        used, (pair,) = fixed, fixed
        drive = {"type": "differential", "left_joint": pair.left.joint.name, "right_joint": pair.right.joint.name}
    else:
        used = fixed
        drive = _multi_axle_drive(model, fixed)
    radius = _radius(model, used)
    measured = [Wheel(w.joint, w.hub, w.radius or radius, w.collides, w.swivel) for p in used for w in (p.left, p.right)]
    drive["wheel_radius"] = round(radius, 5)
    named = ", ".join(wheel.joint.name for wheel in measured)
    track = float(used[0].left.hub[1] - used[0].right.hub[1])
    notes.append(f"drive: {drive['type']}, by the wheels of {named}")
    notes.append(f"wheel_radius: {radius:.4g} m, wheels {track:.4g} m apart")
    if drive["type"] == "skid_steer":
        notes.append("separation_factor: 1, real skid steer turns as if its wheels stood 1.5 to 2 times farther apart")
    if drive["type"] == "ackermann":
        notes.append(f"steering: {used[1].left.swivel.name}, {used[1].right.swivel.name}, {used[1].x - used[0].x:.4g} m in front")  # type: ignore[union-attr]
    return drive, measured


def _no_drive_reason(model: UrdfModel, wheels: Sequence[Wheel], sideways: Sequence[UrdfJoint]) -> str:
    """Returns why a robot cannot drive, and what to do."""
    if sideways and not wheels:
        names = ", ".join(joint.name for joint in sideways[:4])
        return (
            f"{model.path}: its wheels ({names}) turn about the x axis of {quoted(model.root)}, so that it drives along y; x must be "
            "forward (REP 103): turn the root link"
        )
    if wheels:
        names = ", ".join(wheel.joint.name for wheel in wheels[:4])
        return f"{model.path}: no two of its wheels ({names}) mirror each other, left and right, as a drive needs; {_BY_HAND}"
    legs = sum(joint.kind in MOVING_TYPES and joint.kind != "prismatic" for joint in model.joints)
    what = f"it has {legs} joints that turn, as legs or arms have, and none with a wheel" if legs else "nothing in it turns"
    return (
        f"{model.path}: has no wheels to drive by (continuous joints whose axis lies along y, with something round on them): {what}. "
        "Robots with legs are not simulated; an arm or a thing can be spawned into a scene as a body, or be a robot that cannot drive, with "
        f"a robot.yaml: gibson-sim scene robot {model.path.name} --write robot.yaml"
    )


def _ackermann(driven: Pair, front: Pair) -> dict[str, Any]:
    pins = [wheel.swivel for wheel in (front.left, front.right) if wheel.swivel is not None]
    drive: dict[str, Any] = {
        "type": "ackermann", "left_joint": driven.left.joint.name, "right_joint": driven.right.joint.name,
        "left_steering_joint": pins[0].name, "right_steering_joint": pins[1].name,
    }  # fmt: skip
    if not any(pin.is_bounded for pin in pins):
        drive["max_steering_deg"] = _MAX_STEERING_DEG
    return drive


def _multi_axle_drive(model: UrdfModel, pairs: Sequence[Pair]) -> dict[str, Any]:
    rear_to_front = [wheel.joint.name for pair in pairs for wheel in (pair.left, pair.right)]
    meshes = (visual.shape.mesh for link in model.links for visual in link.visuals)
    texts = (*(link.name for link in model.links), *(joint.name for joint in model.joints), *(Path(mesh).name for mesh in meshes))
    if len(pairs) == 2 and any(_MECANUM.search(text) for text in texts):
        angles = (45, -45, -45, 45)  # rear left, rear right, front left, front right
        wheels = [{"joint": name, "roller_deg": angle} for name, angle in zip(rear_to_front, angles, strict=True)]
        return {"type": "omni", "wheels": wheels}
    return {"type": "skid_steer", "left_joints": rear_to_front[::2], "right_joints": rear_to_front[1::2]}


def _radius(model: UrdfModel, pairs: Sequence[Pair]) -> float:
    """Returns the radius of the driven wheels, metres."""
    wheels = [wheel for pair in pairs for wheel in (pair.left, pair.right)]
    bare = [wheel.joint.child for wheel in wheels if not wheel.collides]
    if bare:
        raise RobotError(
            f"{model.path}: its wheels have no collision shape that can be read, so that they touch no floor: {', '.join(bare)}; "
            "give them a <collision> with a sphere or a cylinder"
        )
    driven = [wheel.radius for wheel in (pairs[0].left, pairs[0].right)]
    if min(driven) > 0.0:
        return float(np.mean(driven))
    height = float(pairs[0].left.hub[2])
    if FOOTPRINT in model.root and height > 0:
        return height
    raise RobotError(
        f"{model.path}: the radius of its wheels cannot be measured; write a robot.yaml with drive.wheel_radius: "
        f"gibson-sim scene robot {model.path.name} --write robot.yaml"
    )


def _drop(model: UrdfModel, wheels: Sequence[Wheel], points: MeshPoints | None) -> float:
    """Returns the height of wheels above the floor, metres, as those on springs have in many files; 0 = they touch it."""
    transforms = model.transforms()
    turning = {joint.child for joint in model.joints if joint.kind == "continuous" and not joint.has_motor}
    own = {name for wheel in wheels for name in rigid_links(model, wheel.joint.child)}
    roots = [model.root, *(name for name in turning if name not in own)]
    below = [(0.0, "")]
    for name in dict.fromkeys(link for root in roots for link in rigid_links(model, root)):
        spanned = link_points(model.link(name).collisions, transforms[name], points)
        if len(spanned) and name not in own:
            below.append((min(wheel.bottom for wheel in wheels) - float(spanned[:, 2].min()), name))
    drop, lowest = max(below)
    if drop > _MAX_DROP:
        raise RobotError(
            f"{model.path}: link {quoted(lowest)} reaches {drop:.3g} m lower than the wheels, so that they do not touch the floor; correct the "
            "origins in the file"
        )
    # A little lower, so that they carry the load that the casters otherwise would.
    return drop + _LEAST_DROP if drop > _LEAST_DROP else 0.0


def _friction(
    model: UrdfModel, wheels: Sequence[Wheel], points: MeshPoints | None, values: dict[str, Any], notes: list[str]
) -> None:
    """Sets frictions that the file does not give: wheels grip, and other links on the floor slide, as casters that roll."""
    transforms = model.transforms()
    turning = {wheel.joint.child for wheel in wheels}
    floor = min(wheel.bottom for wheel in wheels)
    found = {}
    for link in model.links:
        spanned = link_points(link.collisions, transforms[link.name], points)
        if link.friction is None and len(spanned) and float(spanned[:, 2].min()) - floor < _TOUCHES:
            found[link.name] = _GRIP if link.name in turning else 0.0
    if found:
        values["friction"] = found
        notes.append(f"friction: {', '.join(f'{name} {value:g}' for name, value in found.items())} (the file gives none)")


def _base(model: UrdfModel, floor: float, values: dict[str, Any], notes: list[str]) -> None:
    """Chooses the frame of odometry, which is on the floor; ``floor`` is the lowest point of the wheels, z in the root's frame."""
    footprint = [name for name in model.fixed_to_root() if name.split("/")[-1] == FOOTPRINT and name != model.root]
    transforms = model.transforms()
    for name in footprint:
        if abs(float(transforms[name][2, 3]) - floor) <= 2 * _FLOOR and _is_upright(transforms[name]):
            if abs(floor) > _FLOOR or model.root != name:
                values["base_link"] = name
                notes.append(f"base_link: {name}, which is on the floor")
            return
    if abs(floor) <= _FLOOR:
        notes.append(f"base_link: {model.root}, the root, which is on the floor")
        return
    values["base_height"] = round(-floor, 5)
    notes.append(f"base_height: {-floor:.4g} m, so that the wheels stand on the floor: {model.root} gets a link below it there")


def _is_upright(T_root_link: Mat4) -> bool:
    return bool(np.allclose(T_root_link[:3, :3], np.eye(3), atol=1e-3))


def _sensors(model: UrdfModel, values: dict[str, Any], notes: list[str]) -> None:
    """Adds a lidar and a camera on links with such names."""
    transforms = model.transforms()
    lidar = _link_named(model, _LIDAR, lambda name: abs(float(transforms[name][2, 2])) > 0.99)
    if lidar:
        values["lidar"] = {"link": lidar}
        notes.append(f"lidar: at {lidar}, 360 degrees, 0.12 to 12 m (there is a link of that name)")
    cameras = [
        name
        for name in (link.name for link in model.links)
        if "optical" in name
        and not _LIDAR.search(name)
        and not _NO_COLOR.search(name)
        and abs(float(transforms[name][2, 2])) < 0.9
    ]
    camera = cameras[0] if cameras else _link_named(model, _CAMERA, lambda name: float(transforms[name][0, 0]) > 0.5)
    if camera:
        values["cameras"] = [{"name": "camera", "link": camera}]
        notes.append(f"camera: at {camera}, 640 x 480, 60 degrees high (there is a link of that name)")


def _link_named(model: UrdfModel, pattern: re.Pattern[str], fits: Callable[[str], bool]) -> str:
    """Returns the last link with a matching name on the chain of fixed joints from the first; empty = none."""
    parents: Mapping[str, str] = {joint.child: joint.parent for joint in model.joints if joint.kind == "fixed"}
    names = [link.name for link in model.links if pattern.search(link.name) and not _MOUNT.search(link.name) and fits(link.name)]
    if not names:
        return ""
    found = names[0]
    for name in names[1:]:
        if parents.get(name) == found:
            found = name
    return found


@dataclass(frozen=True, slots=True)
class Wheel:
    """A link that turns about a level axis."""

    joint: UrdfJoint
    hub: NDArray[np.float64]
    """Its centre, (3,), in the root's frame, metres."""
    radius: float
    """Metres; 0 = no shape of it can be measured."""
    collides: bool
    """Whether it has a collision shape."""
    swivel: UrdfJoint | None
    """The nearest joint above it with a vertical axis; None = it cannot be steered."""

    @property
    def bottom(self) -> float:
        """Lowest point, z in the root's frame, metres."""
        return float(self.hub[2]) - self.radius

    @property
    def is_caster(self) -> bool:
        """Whether it swivels freely, or has a caster's name."""
        text = f"{self.joint.name} {self.joint.child}".lower()
        free = self.swivel is not None and not steers(self.swivel)
        return free or "caster" in text or "castor" in text


@dataclass(frozen=True, slots=True)
class Pair:
    """Two wheels that are mirror images of each other."""

    left: Wheel
    right: Wheel

    @property
    def x(self) -> float:
        """Position of its axle along x in the root's frame, metres."""
        return float(self.left.hub[0] + self.right.hub[0]) / 2

    @property
    def swivels(self) -> bool:
        """Whether both wheels are on joints that steer."""
        return self.left.swivel is not None and self.right.swivel is not None


def steers(joint: UrdfJoint) -> bool:
    """Returns whether a joint with a vertical axis steers, and is not the swivel of a caster."""
    return joint.kind == "revolute" or "steer" in f"{joint.name} {joint.child}".lower()


def find_wheels(model: UrdfModel, points: MeshPoints | None = None) -> tuple[list[Wheel], list[UrdfJoint]]:
    """Returns (possible wheels, continuous joints of round links whose axis is along x).

    Args:
        model: The links.
        points: Reads meshes; None = a wheel that is a mesh has no radius.
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
        if abs(axis[1]) >= ALIGNED:
            wheels.append(wheel)
        elif abs(axis[0]) >= ALIGNED:
            sideways.append(joint)
    return wheels, sideways


def find_pairs(wheels: list[Wheel]) -> list[Pair]:
    """Returns the pairs that stand on the floor, from the rear to the front, without casters and wheels that have no mirror image."""
    able = [wheel for wheel in wheels if not wheel.is_caster]
    pairs = _mirrored(able)
    if not pairs:
        return []
    lowest = min(wheel.bottom for pair in pairs for wheel in (pair.left, pair.right))
    standing = [pair for pair in pairs if pair.left.bottom - lowest <= max(_LIFT * pair.left.radius, 0.01)]
    return sorted(standing, key=lambda pair: pair.x)


def _mirrored(wheels: list[Wheel]) -> list[Pair]:
    pairs: list[Pair] = []
    # The outermost first, so that twin wheels on an axle are paired with their mirror images.
    left = sorted(wheels, key=lambda wheel: -wheel.hub[1])
    middle = (max(w.hub[1] for w in wheels) + min(w.hub[1] for w in wheels)) / 2 if wheels else 0.0
    taken: set[str] = set()
    for wheel in left:
        if wheel.hub[1] - middle < 0.01:
            continue
        matches = [
            other
            for other in wheels
            if other.joint.name not in taken
            and np.abs(wheel.hub[[0, 2]] - other.hub[[0, 2]]).max() <= _SAME
            and abs(wheel.hub[1] + other.hub[1] - 2 * middle) <= _SAME
            and abs(wheel.radius - other.radius) <= _ROUND * max(wheel.radius, other.radius)
        ]
        if matches:
            best = min(matches, key=lambda other: float(np.abs(wheel.hub[[0, 2]] - other.hub[[0, 2]]).sum()))
            taken.add(best.joint.name)
            pairs.append(Pair(wheel, best))
    return pairs


def _swivel(joint: UrdfJoint, above: dict[str, UrdfJoint], transforms: dict[str, Mat4]) -> UrdfJoint | None:
    """Returns the nearest joint above another one with a vertical axis."""
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
    """Returns the wheel on a joint; None = the links on it are not round about its axis."""
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
    # The radius in the file, if it agrees with the measured one: a cylinder rotated by 1.57 instead of pi/2 measures larger.
    exact = [item.shape.size[0] for link in links for item in getattr(link, kind) if item.shape.kind in ("sphere", "cylinder")]
    near = [size for size in exact if abs(size - radius) < _ROUND * radius]
    return Wheel(joint, hub, max(near, default=radius), collides, swivel)
