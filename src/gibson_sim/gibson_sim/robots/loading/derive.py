"""Guesses the ``robot.yaml`` of a robot without one: drive, height above the floor, sensors. Pure.

Each guess is reported in one line; if a guess is impossible, a ``RobotError`` names the remedy. ``wheels`` recognises wheels by their joints and
shapes, ``sensor_guesses`` recognises sensors by tags and names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.description.extents import MeshPoints, link_points, rigid_links
from gibson_sim.description.gazebo import MECANUM
from gibson_sim.description.omissions import OmissionKind, kind_of
from gibson_sim.description.rigid_groups import MOVING_TYPES, rigid_groups
from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4, transform_points
from gibson_sim.quoting import quoted
from gibson_sim.robots.loading.base_frame import FOOTPRINT
from gibson_sim.robots.loading.drive import ALIGNED
from gibson_sim.robots.loading.guess import Guess
from gibson_sim.robots.loading.sensor_guesses import guess_sensors
from gibson_sim.robots.loading.wheels import Pair, Wheel, find_pairs, find_wheels, in_all_directions, steers

DESCRIPTION_SUFFIXES = (".urdf", ".xacro")
"""Suffixes of files that describe a robot without a ``robot.yaml``, lower case."""
_FLOOR = 0.005
"""Distance from the floor at which the root counts as on it, metres."""
_LEAST_DROP, _MAX_DROP = 0.001, 0.03
"""Minimum and maximum height of wheels above the floor that is corrected, metres; more is an error in the file."""
_HULL_MARGIN = 0.001
"""Thickness that the engine adds to the convex hulls of meshes, metres."""
_MAX_RAISE = 0.01
"""Maximum distance of a body from the floor by which its two wheels are raised, so that its casters touch the floor, metres."""
_TOUCHES = 0.01
"""Height above the lowest point of the wheels below which a link counts as touching the floor, metres."""
_GRIP = 1.0
"""Coulomb friction of driven wheels."""
_MAX_STEERING_DEG = 30.0
"""Default steering limit of joints without limits, degrees."""
_MECANUM = re.compile(MECANUM.pattern + r"|omni_?wheel", re.IGNORECASE)
"""Pattern of names of four wheels side by side that go sideways."""
_MECANUM_DEG = (45, -45, -45, 45)
"""``roller_deg`` of mecanum wheels that can turn the robot: rear left, rear right, front left, front right."""
_LEAST_ROLLER_DEG = 15.0
"""Minimum angle of a roller that tells a mecanum wheel from an omni wheel, degrees."""
_LEAST_TRACK = 0.02
"""Minimum distance of a left wheel from a right one, metres."""
_LEAST_LEG_JOINTS = 2
"""Minimum number of turning joints of a leg."""
_LEG_TOLERANCE = 0.05
"""Maximum difference of the heights of feet with all joints at 0, metres."""
_HELD = 0.1
"""Height of the feet above the floor for a robot that is held in the air, metres."""
_BY_HAND = "write a robot.yaml with the drive that it has (docs/robots.md)"


@dataclass(frozen=True, slots=True)
class DerivedRobot:
    """A guessed ``robot.yaml``."""

    values: dict[str, Any]
    """Keys and values, without ``urdf``."""
    guesses: tuple[Guess, ...]
    """Guesses, one per value."""


def derive_robot(model: UrdfModel, points: MeshPoints | None = None, *, needs_drive: bool = True) -> DerivedRobot:
    """Returns a guess of the ``robot.yaml`` for a description.

    Args:
        model: The description.
        points: Reads meshes; None = meshes are not measured.
        needs_drive: Whether a robot without wheels is an error. Else it has no drive, and an arm is fixed to the floor; legs are an error in
            any case.

    Raises:
        RobotError: the robot has no wheels, no drive fits the wheels, or it has legs; one line.
    """
    values: dict[str, Any] = {}
    guesses: list[Guess] = []
    candidates, others = find_wheels(model, points, _named_wheels(model))
    sideways = [wheel.joint for wheel in others if abs(wheel.axis[0]) >= ALIGNED]
    if not candidates and not sideways and not _is_moved(model):
        _refuse_legs(model, points)
    try:
        drive, wheels = _derive_drive(model, candidates, others, guesses)
    except RobotError:
        if needs_drive or find_pairs(candidates):
            raise
        drive, wheels = None, []
        wrong = _wrong_axes(model)
        why = f"none: {wrong}" if wrong else "none, no wheels were found that could drive it"
        guesses.append(Guess("drive", why, by_hand=f"description: {wrong}" if wrong else ""))
        _fix_base(model, points, values, guesses)
    if drive is not None and drive["type"] == "planar":
        _base(model, _floor_of_shapes(model, points), values, guesses)
        values["drive"] = drive
    elif drive is not None:
        drop, why = _drop(model, wheels, points)
        _base(model, min(wheel.bottom for wheel in wheels) - drop, values, guesses)
        if drop:
            values["wheel_drop"] = {wheel.joint.name: round(drop, 5) for wheel in wheels}
            guesses.append(Guess("wheel_drop", f"{drop * 1000:.2g} mm, since {why}"))
        _round_wheels(wheels, values, guesses)
        _friction(model, wheels, points, values, guesses, grips=drive["type"] in ("differential", "ackermann"))
        values["drive"] = drive
    guess_sensors(model, values, guesses)
    return DerivedRobot(values, tuple(guesses))


def _named_wheels(model: UrdfModel) -> tuple[str, ...]:
    """Returns the wheel joints of Gazebo's drive plugin."""
    return () if model.gazebo.drive is None else model.gazebo.drive.joints


def _is_moved(model: UrdfModel) -> bool:
    """Returns whether a plugin of Gazebo moves the base itself, in all directions."""
    return model.gazebo.drive is not None and model.gazebo.drive.kind == "planar"


def _derive_drive(
    model: UrdfModel, candidates: list[Wheel], others: list[Wheel], guesses: list[Guess]
) -> tuple[dict[str, Any], list[Wheel]]:
    """Returns (section ``drive``, its wheels, each with a radius)."""
    hint = "" if model.gazebo.drive is None else model.gazebo.drive.kind
    around = [] if hint == "differential" or not others else in_all_directions([*candidates, *others])
    if around:
        return _omni_drive(model, around, guesses)
    named = [wheel for wheel in candidates if wheel.joint.name in _named_wheels(model)]
    # Prefer the wheels of Gazebo's plugin, if they form pairs; others are assumed to be casters.
    wheels = named if find_pairs(named) else candidates
    pairs = find_pairs(wheels)
    if hint == "planar" and (len(pairs) != 2 or any(pair.swivels for pair in pairs)):
        return _planar_drive(model, [*candidates, *others], guesses), []
    if not pairs:
        raise RobotError(_no_drive_reason(model, wheels, [wheel.joint for wheel in others if abs(wheel.axis[0]) >= ALIGNED]))
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
        sign = _mecanum_sign(model, fixed)
        drive = _mecanum_drive(model, fixed, sign) if sign else _skid_steer_drive(fixed)
    radius, how = _radius(model, used)
    measured = [replace(w, radius=w.radius or radius) for p in used for w in (p.left, p.right)]
    drive["wheel_radius"] = round(radius, 5)
    joints = ", ".join(wheel.joint.name for wheel in measured)
    track = float(used[0].left.hub[1] - used[0].right.hub[1])
    reason = " (Gazebo's plugin drives by them)" if wheels is named else ""
    if drive["type"] == "omni":
        reason = f" (mecanum: {sign})"
    elif drive["type"] == "skid_steer":
        reason = reason or " (they do not steer, and nothing says that they are mecanum)"
    guesses.append(Guess("drive", f"{drive['type']}, by the wheels of {joints}{reason}"))
    guesses.append(Guess("drive", f"{radius:.4g} m, {how}; wheels {track:.4g} m apart", "wheel_radius"))
    if drive["type"] == "skid_steer":
        text = "1, real skid steer turns as if its wheels stood 1.5 to 2 times farther apart"
        hand = (
            "drive.separation_factor: the turn that the real wheels roll over the turn that the base makes, measured on the floor"
        )
        guesses.append(Guess("drive", text, "separation_factor", hand))
        _note_steering(model, measured, guesses)
        crossed = "wheels across the corners have the same mesh" if _crossed_meshes(model, measured) else ""
        similar = "their friction is along a diagonal" if model.gazebo.oblique else crossed
        if similar:
            why = f"{similar}, as of mecanum wheels: if they are, drive.type is omni"
            guesses.append(Guess("drive", f"skid_steer; {why}", "type", f"drive.type: {why}"))
    if drive["type"] == "ackermann":
        pins = f"{used[1].left.swivel.name}, {used[1].right.swivel.name}"  # type: ignore[union-attr]
        guesses.append(Guess("drive", f"{pins}, {used[1].x - used[0].x:.4g} m in front", "steering"))
    if drive["type"] == "omni":
        angles = ", ".join(f"{wheel['roller_deg']:g}" for wheel in drive["wheels"])
        how_angled = (
            "as on mecanum wheels that can turn the robot" if fixed[0].left.roller is None else "measured on their rollers"
        )
        text = f"{angles} degrees, {how_angled}"
        guesses.append(Guess("drive", text, "roller_deg", "drive.wheels: roller_deg of each, if it goes the wrong way sideways"))
    return drive, measured


def _note_steering(model: UrdfModel, wheels: Sequence[Wheel], guesses: list[Guess]) -> None:
    """Notes joints above wheels that are named as steering joints and do not steer."""
    above = {joint.child: joint for joint in model.joints}
    for joint in dict.fromkeys(above[w.joint.parent] for w in wheels if w.joint.parent in above):
        if joint.kind != "fixed" and steers(joint):
            why = "its axis is not vertical"
            hand = f"description: joint {quoted(joint.name)} cannot steer, since {why}"
            guesses.append(Guess("drive", f"{joint.name}: does not steer, since {why}", "steering", hand))


def _refuse_legs(model: UrdfModel, points: MeshPoints | None) -> None:
    """Raises RobotError if the robot stands on legs: branches of two or more turning joints that extend below all other links."""
    transforms = model.transforms()
    children: dict[str, list[UrdfJoint]] = {}
    for joint in model.joints:
        children.setdefault(joint.parent, []).append(joint)
    trunk = model.fixed_to_root()
    legs: list[tuple[str, float]] = []
    for first in (joint for name in trunk for joint in children.get(name, ()) if joint.kind in MOVING_TYPES):
        branch = [first]
        for joint in branch:
            branch += children.get(joint.child, ())
        turning = [joint for joint in branch if joint.kind in ("revolute", "continuous") and joint.mimic is None]
        lowest = _lowest(model, [joint.child for joint in branch], transforms, points)
        if len(turning) >= _LEAST_LEG_JOINTS and lowest is not None:
            legs.append((first.name, lowest))
    body = _lowest(model, trunk, transforms, points)
    if len(legs) < 2:
        return
    floor = min(lowest for _, lowest in legs)
    standing = [name for name, lowest in legs if lowest - floor < _LEG_TOLERANCE]
    if len(standing) >= 2 and (body is None or body > floor + _LEG_TOLERANCE):
        raise RobotError(
            f"{model.path}: stands on {len(standing)} legs ({', '.join(standing)}): walking robots are not simulated, since they need a "
            "balance controller. Its joints can be moved while its body is held in the air: write a robot.yaml with urdf, "
            f"fixed_base: true and base_height: {-floor + _HELD:.2g}"
        )


def _fix_base(model: UrdfModel, points: MeshPoints | None, values: dict[str, Any], guesses: list[Guess]) -> None:
    """Fixes the base of a robot with motors but without a drive, such as an arm, to the floor."""
    if not any(joint.has_motor for joint in model.joints):
        return
    values["fixed_base"] = True
    guesses.append(Guess("fixed_base", f"true, an arm without a drive: {model.root} does not move"))
    lowest = _lowest(model, model.fixed_to_root(), model.transforms(), points)
    if lowest is not None and lowest < -_FLOOR:
        values["base_height"] = round(-lowest, 5)
        guesses.append(Guess("base_height", f"{-lowest:.4g} m, so that its base stands on the floor"))


def _lowest(model: UrdfModel, names: Sequence[str], transforms: dict[str, Mat4], points: MeshPoints | None) -> float | None:
    """Returns the minimum z of the collision shapes of links, metres, root frame; None = no collision shapes."""
    spanned = [link_points(model.link(name).collisions, transforms[name], points) for name in names]
    corners = np.concatenate(spanned) if spanned else np.zeros((0, 3))
    return float(corners[:, 2].min()) if len(corners) else None


def _wrong_axes(model: UrdfModel) -> str:
    """Returns an error text if wheels beside each other rotate about the forward direction; empty = no error.

    A joint without ``<axis>`` rotates about its x axis, which is a common mistake.
    """
    transforms = model.transforms()
    wheels_along_x = []
    for joint in model.joints:
        T = transforms[joint.child]
        is_wheel = "wheel" in f"{joint.name} {joint.child}".lower()
        if joint.kind == "continuous" and is_wheel and abs(float((T[:3, :3] @ np.array(joint.axis))[0])) >= ALIGNED:
            wheels_along_x.append((joint.name, T))
    for i, (name, T) in enumerate(wheels_along_x):
        for _, other in wheels_along_x[i + 1 :]:
            apart = np.abs(T[:3, 3] - other[:3, 3])
            if apart[1] > max(apart[0], apart[2], _LEAST_TRACK):
                across = " ".join(f"{round(float(value), 3) + 0.0:g}" for value in T[1, :3])
                return (
                    f"the axis of {quoted(name)} lies along x, the robot's forward direction (as without <axis>), but a wheel turns about y: "
                    f'give it <axis xyz="{across}"/>, and so the other wheels'
                )
    return ""


def _no_drive_reason(model: UrdfModel, wheels: Sequence[Wheel], sideways: Sequence[UrdfJoint]) -> str:
    """Returns the reason why a robot cannot drive, and the remedy."""
    wrong = _wrong_axes(model)
    if wrong:
        return f"{model.path}: {wrong}"
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
        f"a robot.yaml: gibson-sim scene robot --new {model.path.name}"
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


def _skid_steer_drive(pairs: Sequence[Pair]) -> dict[str, Any]:
    rear_to_front = [wheel.joint.name for pair in pairs for wheel in (pair.left, pair.right)]
    return {"type": "skid_steer", "left_joints": rear_to_front[::2], "right_joints": rear_to_front[1::2]}


def _mecanum_sign(model: UrdfModel, pairs: Sequence[Pair]) -> str:
    """Returns what says that the wheels are mecanum wheels; empty = nothing."""
    plugin = model.gazebo.drive
    if plugin is not None and plugin.kind != "differential":
        return f"Gazebo's plugin {plugin.plugin}"
    wheels = [wheel for pair in pairs for wheel in (pair.left, pair.right)]
    if any(wheel.roller is not None and abs(math.degrees(wheel.roller)) > _LEAST_ROLLER_DEG for wheel in wheels):
        return "their rollers have joints"
    meshes = dict.fromkeys(Path(visual.shape.mesh).name for link in model.links for visual in link.visuals if visual.shape.mesh)
    for what, names in (
        ("link", [link.name for link in model.links]), ("joint", [joint.name for joint in model.joints]), ("mesh", meshes),
    ):  # fmt: skip
        found = next((name for name in names if _MECANUM.search(name)), None)
        if found is not None:
            return f"the name of {what} {quoted(found)}"
    missing = next(
        (line for line in model.warnings if kind_of(line) is OmissionKind.MISSING_ASSET and _MECANUM.search(line)), None
    )
    return model.gazebo.mecanum or ("" if missing is None else "the name of a missing mesh")


def _crossed_meshes(model: UrdfModel, wheels: Sequence[Wheel]) -> bool:
    """Returns whether wheels across the corners have the same mesh, and those beside each other have not, as mecanum wheels of two hands."""
    drawn = [
        tuple((visual.shape.mesh, math.prod(visual.shape.size) < 0.0) for name in rigid_links(model, wheel.joint.child)
              for visual in model.link(name).visuals if visual.shape.mesh)
        for wheel in wheels
    ]  # fmt: skip
    return len(drawn) == 4 and all(drawn) and drawn[0] == drawn[3] != drawn[1] == drawn[2]


def _mecanum_drive(model: UrdfModel, pairs: Sequence[Pair], sign: str) -> dict[str, Any]:
    wheels = [wheel for pair in pairs for wheel in (pair.left, pair.right)]
    if len(pairs) != 2:
        raise RobotError(
            f"{model.path}: has {len(wheels)} mecanum wheels ({sign}), of which only four have a known arrangement; {_BY_HAND}"
        )
    angles = [float(angle) for angle in _MECANUM_DEG]
    if all(wheel.roller is not None for wheel in wheels):
        angles = [round(math.degrees(wheel.roller or 0.0), 2) for wheel in wheels]
    return {"type": "omni", "wheels": [{"joint": w.joint.name, "roller_deg": a} for w, a in zip(wheels, angles, strict=True)]}


def _omni_drive(model: UrdfModel, wheels: list[Wheel], guesses: list[Guess]) -> tuple[dict[str, Any], list[Wheel]]:
    """Returns (section ``drive`` of omni wheels whose axes differ, its wheels)."""
    radius = float(np.mean([wheel.radius for wheel in wheels]))
    names = ", ".join(wheel.joint.name for wheel in wheels)
    guesses.append(Guess("drive", f"omni, by the wheels of {names} (their axes point in different directions)"))
    guesses.append(Guess("drive", f"{radius:.4g} m, measured on their shapes", "wheel_radius"))
    turned = [round(math.degrees(wheel.roller or 0.0), 2) for wheel in wheels]
    return {
        "type": "omni", "wheels": [{"joint": w.joint.name, "roller_deg": a} for w, a in zip(wheels, turned, strict=True)],
        "wheel_radius": round(radius, 5),
    }, wheels  # fmt: skip


def _planar_drive(model: UrdfModel, wheels: Sequence[Wheel], guesses: list[Guess]) -> dict[str, Any]:
    """Returns the section ``drive`` of a base that a plugin of Gazebo moves."""
    assert model.gazebo.drive is not None
    free = [wheel.joint.name for wheel in wheels]
    text = f"planar, the base moves in all directions by itself (Gazebo's plugin {model.gazebo.drive.plugin})"
    guesses.append(Guess("drive", text))
    if free:
        guesses.append(Guess("drive", f"{', '.join(free)}: they slide along", "free_wheels"))
    return {"type": "planar", **({"free_wheels": free} if free else {})}


def _floor_of_shapes(model: UrdfModel, points: MeshPoints | None) -> float:
    """Returns the lowest point of the collision shapes, on which a base without driven wheels slides, z in the root frame, metres."""
    lowest = _lowest(model, [link.name for link in model.links], model.transforms(), points)
    if lowest is None:
        raise RobotError(f"{model.path}: has no collision shape to stand on; give its base a <collision>")
    return lowest


def _radius(model: UrdfModel, pairs: Sequence[Pair]) -> tuple[float, str]:
    """Returns (radius of the driven wheels, metres, source of the value)."""
    wheels = [wheel for pair in pairs for wheel in (pair.left, pair.right)]
    bare = [wheel.joint.child for wheel in wheels if not wheel.rolls and wheel.radius == 0.0]
    if bare:
        mesh_warning = next((line for line in model.warnings if quoted(bare[0]) in line and " mesh " in line), "")
        raise RobotError(
            f"{model.path}: its wheels have no shape that can be read, so that they touch no floor: {', '.join(bare)}"
            f"{f' ({mesh_warning})' if mesh_warning else ''}; give them a <collision> with a sphere or a cylinder"
        )
    driven = [wheel.radius for wheel in (pairs[0].left, pairs[0].right)]
    if min(driven) > 0.0:
        return float(np.mean(driven)), "measured on their shapes"
    if model.gazebo.drive is not None and model.gazebo.drive.wheel_radius > 0.0:
        return model.gazebo.drive.wheel_radius, "as Gazebo's plugin is told"
    height = float(pairs[0].left.hub[2])
    if FOOTPRINT in model.root and height > 0:
        return height, "the height of their hubs"
    raise RobotError(
        f"{model.path}: the radius of its wheels cannot be measured, since their shapes are not round; write a robot.yaml with "
        "drive.wheel_radius (docs/robots.md)"
    )


def _round_wheels(wheels: Sequence[Wheel], values: dict[str, Any], guesses: list[Guess]) -> None:
    """Replaces collision shapes of wheels that cannot roll by spheres."""
    radii = {wheel.joint.child: round(wheel.radius, 5) for wheel in wheels if not wheel.rolls}
    if radii:
        values["round_wheels"] = radii
        text = ", ".join(f"{name} {radius:g} m" for name, radius in radii.items())
        guesses.append(
            Guess("round_wheels", f"{text}, spheres instead of their collision shapes, which are meshes, not round, or missing")
        )


def _drop(model: UrdfModel, wheels: Sequence[Wheel], points: MeshPoints | None) -> tuple[float, str]:
    """Returns (distance by which the wheels must be lowered to support the robot, metres, below 0 = raised; reason).

    In many files, wheels on springs are above the floor, or casters that are part of the body are below the wheels, or above the floor.
    """
    transforms = model.transforms()
    turning = {joint.child for joint in model.joints if joint.kind == "continuous" and not joint.has_motor}
    wheel_links = {name for wheel in wheels for name in rigid_links(model, wheel.joint.child)}
    floor = min(wheel.bottom for wheel in wheels)
    body = [name for name in rigid_links(model, model.root) if name not in wheel_links]
    casters = [link for name in turning if name not in wheel_links for link in rigid_links(model, name)]
    gaps = {name: low - floor for name in (*body, *casters) if (low := _lowest(model, [name], transforms, points)) is not None}
    if not gaps:
        return 0.0, ""
    lowest = min(gaps, key=lambda name: gaps[name])
    gap = gaps[lowest]
    if gap < -_MAX_DROP:
        raise RobotError(
            f"{model.path}: link {quoted(lowest)} reaches {-gap:.3g} m lower than the wheels, so that they do not touch the floor; correct the "
            "origins in the file"
        )
    # Slightly lower, so that they carry the load in place of the casters.
    if gap < -_LEAST_DROP:
        return _LEAST_DROP - gap, f"{lowest} reaches {-gap * 1000:.2g} mm lower than the wheels"
    if abs(gap) <= _LEAST_DROP and lowest in body and _bears_alone(model, body, floor + gap, points):
        return (
            _LEAST_DROP + _HULL_MARGIN - gap,
            f"{model.root} and what is fixed to it would bear the robot, and the wheels nothing",
        )
    hangs = 2 * _LEAST_DROP < gap <= _MAX_RAISE and lowest in body
    if len(wheels) == 2 and hangs and _bears_alone(model, body, floor + gap, points):
        above = f"the casters are a part of {model.root}, {gap * 1000:.2g} mm above it"
        return _LEAST_DROP - gap, f"nothing beside the wheels touches the floor: {above}"
    return 0.0, ""


def _bears_alone(model: UrdfModel, names: Sequence[str], floor: float, points: MeshPoints | None) -> bool:
    """Returns whether links would support the robot on a floor at this height without its wheels: its centre of mass is above their support area."""
    transforms = model.transforms()
    spanned = [link_points(model.link(name).collisions, transforms[name], points) for name in names]
    low = np.concatenate(spanned)
    low = low[low[:, 2] < floor + _LEAST_DROP, :2]
    groups = rigid_groups(model)[0]
    center = sum(g.mass * transform_points(transforms[g.name], g.center[None])[0, :2] for g in groups) / sum(
        g.mass for g in groups
    )
    around = np.arctan2(*(low - center).T[::-1])
    # It is inside of their convex hull if no half-plane about it is without points.
    gaps = np.diff(np.sort(around), append=around.min() + 2 * np.pi) if len(around) else np.array([2 * np.pi])
    return bool(gaps.max() < np.pi)


def _friction(
    model: UrdfModel,
    wheels: Sequence[Wheel],
    points: MeshPoints | None,
    values: dict[str, Any],
    guesses: list[Guess],
    *,
    grips: bool,
) -> None:
    """Sets missing frictions: driven wheels grip if they drive by friction (``grips``), and other links on the floor slide, like casters."""
    transforms = model.transforms()
    turning = {wheel.joint.child for wheel in wheels}
    floor = min(wheel.bottom for wheel in wheels)
    frictions = {}
    for link in model.links:
        spanned = link_points(link.collisions, transforms[link.name], points)
        if link.friction is not None or (link.name in turning and not grips):
            continue
        if len(spanned) and float(spanned[:, 2].min()) - floor < _TOUCHES:
            frictions[link.name] = _GRIP if link.name in turning else 0.0
    if frictions:
        values["friction"] = frictions
        guesses.append(
            Guess("friction", f"{', '.join(f'{name} {value:g}' for name, value in frictions.items())} (the file gives none)")
        )


def _base(model: UrdfModel, floor: float, values: dict[str, Any], guesses: list[Guess]) -> None:
    """Chooses the frame of odometry, which is on the floor; ``floor``: lowest point of the wheels, z in the root frame."""
    footprint = [name for name in model.fixed_to_root() if name.split("/")[-1] == FOOTPRINT and name != model.root]
    transforms = model.transforms()
    for name in footprint:
        if abs(float(transforms[name][2, 3]) - floor) <= 2 * _FLOOR and _is_upright(transforms[name]):
            if abs(floor) > _FLOOR or model.root != name:
                values["base_link"] = name
                guesses.append(Guess("base_link", f"{name}, which is on the floor"))
            return
    if abs(floor) <= _FLOOR:
        guesses.append(Guess("base_link", f"{model.root}, the root, which is on the floor"))
        return
    values["base_height"] = round(-floor, 5)
    guesses.append(
        Guess("base_height", f"{-floor:.4g} m, so that the wheels stand on the floor: {model.root} gets a link below it there")
    )


def _is_upright(T_root_link: Mat4) -> bool:
    return bool(np.allclose(T_root_link[:3, :3], np.eye(3), atol=1e-3))
