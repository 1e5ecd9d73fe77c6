"""Hinged doors: those that hang in a scene, how they open, how a robot backs up to pull one open. Pure."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.geometry.rasterise import clip_to_slab
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_matrix, transform_points
from gibson_sim.maps.bodies import body_triangles, link_transforms
from gibson_sim.maps.floor_map import FLOOR_TOLERANCE, FloorMap
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import View
from gibson_sim.tasks.ground import Ground
from gibson_sim.types import Pose

F64 = NDArray[np.float64]
XY = tuple[float, float]
REACH = 0.66
"""Metres from the base to the tool, straight ahead, where a robot takes a handle."""
WIDE = math.radians(86.0)
"""How far a robot pulls a door that has the room: at 90 degrees the simulation lets go by itself, in the middle of the pull."""
PULL_SPEED = 0.12
"""Speed at which it pulls the handle, m/s."""
LEAVE = 0.3
"""Metres that it backs away from the handle of the open door."""
LEAST_SLANT = math.radians(-52.0)
"""A hand that is turned farther to the edge of the leaf would press against it."""
_LEVER, _OFF_LEAF = 0.05, 0.063
"""Metres from the axis of a lever to where it is held, along the leaf towards its hinge, and off the middle of the leaf."""
_SHORT = 0.07
"""Metres from there to the tool: nearer, the palm would press against the lever."""
_TALLEST_CABINET = 1.6
"""Metres: what swings and is lower is no door."""
_UPRIGHT = 0.99
_GRIPS = ("handle", "knob")


@dataclass(frozen=True, slots=True)
class HingedDoor:
    """A door that turns about an upright hinge, and has a handle. Level coordinates are those of the world, metres."""

    body: str
    """Name."""
    leaf: str
    """Whole name of the link that swings, ``<body>/<link>``."""
    handle: str
    """Whole name of the link to hold."""
    closed: Pose
    """T_world_leaf of the closed door."""
    hinge: XY
    radius: float
    """From the hinge to the axis of the handle."""
    bearing: float
    """Direction from the hinge to the handle of the closed door, radians."""
    sense: float
    """1 = it opens counter-clockwise seen from above, -1 = clockwise."""
    stop: float
    """How far it opens, radians."""
    width: float
    """From the hinge to the far edge of the leaf."""
    handle_z: float
    """Height of the handle, world."""

    def at(self, opening: float, radius: float | None = None) -> XY:
        """Returns where a part of the leaf is that is ``radius`` from the hinge (None = the handle), the door open by ``opening`` rad."""
        angle, length = self.bearing + self.sense * opening, self.radius if radius is None else radius
        return self.hinge[0] + length * math.cos(angle), self.hinge[1] + length * math.sin(angle)

    @property
    def outwards(self) -> float:
        """Direction at right angles to the closed leaf to the side on which it opens, radians."""
        return self.bearing + self.sense * math.pi / 2.0

    def towards(self, opening: float, slant: float) -> float:
        """Returns the direction from the handle to a robot that pulls, radians.

        Args:
            opening: of the door, radians.
            slant: radians from the direction at right angles to the leaf towards the side of the hinge.
        """
        return self.outwards + self.sense * (opening + slant)

    def grip(self, opening: float, slant: float) -> XY:
        """Returns where the tool takes the handle; see ``towards``."""
        x, y = self.at(opening, self.radius - _LEVER)
        for angle, length in ((self.towards(opening, 0.0), _OFF_LEAF), (self.towards(opening, slant), _SHORT)):
            x, y = x + length * math.cos(angle), y + length * math.sin(angle)
        return x, y

    def stance(self, opening: float, slant: float, reach: float = REACH) -> XY:
        """Returns where the base stands to take the handle, ``reach`` metres before the tool; it looks at it."""
        (x, y), angle = self.grip(opening, slant), self.towards(opening, slant)
        return x + reach * math.cos(angle), y + reach * math.sin(angle)

    def slant(self, opening: float, tool: XY, base: XY) -> float:
        """Returns the slant under which a base pulls with its tool."""
        angle = math.atan2(base[1] - tool[1], base[0] - tool[0]) - self.towards(opening, 0.0)
        return self.sense * math.remainder(angle, 2.0 * math.pi)

    def off(self, along: float, away: float) -> XY:
        """Returns the place ``along`` metres from the hinge on the closed leaf, and ``away`` from it on the side on which it opens."""
        x, y = self.at(0.0, along)
        return x + away * math.cos(self.outwards), y + away * math.sin(self.outwards)

    def away(self, points: F64) -> F64:
        """Returns (N,): how far points (N, 2) are from the plane of the closed leaf; positive on the side on which it opens."""
        return np.asarray((points - np.array(self.hinge)) @ [math.cos(self.outwards), math.sin(self.outwards)])

    def opening(self, view: View) -> float:
        """Returns how far it is open, radians."""
        a, b = np.array(self.closed.quat_xyzw), np.array(view.links[self.leaf].quat_xyzw)
        return 2.0 * math.acos(min(1.0, abs(float(a @ b))))


def hinged_door(body: BodySpec) -> HingedDoor | None:
    """Returns the door that a body is; None = it is none: no upright hinge on something fixed, no handle, not as high as a door."""
    hinge = next((joint for joint in body.model.joints if joint.parent == body.model.root and joint.kind == "revolute"), None)
    if not body.static or hinge is None or not hinge.is_bounded:
        return None
    handle = _handle(body.model, hinge.child)
    places = link_transforms(replace(body, joints=()))
    axis = places[hinge.child][:3, :3] @ np.array(hinge.axis)
    corners = _corners(body.model, hinge.child, places[hinge.child])
    if handle is None or abs(axis[2]) < _UPRIGHT or np.ptp(corners[:, 2]) < _TALLEST_CABINET:
        return None
    begin, end = places[hinge.child][:2, 3], places[handle][:3, 3]
    along = (end[:2] - begin) / np.linalg.norm(end[:2] - begin)
    return HingedDoor(
        body=body.name,
        leaf=f"{body.name}/{hinge.child}",
        handle=f"{body.name}/{handle}",
        closed=pose_from_matrix(places[hinge.child]),
        hinge=(float(begin[0]), float(begin[1])),
        radius=float(np.linalg.norm(end[:2] - begin)),
        bearing=math.atan2(along[1], along[0]),
        sense=math.copysign(1.0, axis[2]) * (1.0 if hinge.upper >= -hinge.lower else -1.0),
        stop=max(hinge.upper, -hinge.lower),
        width=float(((corners[:, :2] - begin) @ along).max()),
        handle_z=float(end[2]),
    )


def scene_doors(scene: SceneSpec) -> tuple[HingedDoor, ...]:
    """Returns the doors that hang in a scene, in its order."""
    return tuple(door for door in map(hinged_door, scene.bodies) if door is not None)


def _handle(model: UrdfModel, leaf: str) -> str | None:
    """Returns the link of a handle that hangs on a leaf."""
    children = (joint.child for joint in model.joints if joint.parent == leaf)
    return next((link for link in children if any(word in link for word in _GRIPS)), None)


def _corners(model: UrdfModel, link: str, T_world_link: Mat4) -> F64:
    """Returns the corners (N, 3) of the boxes of a link, world; its origin where it has none."""
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    boxes = [c for c in model.link(link).collisions if c.shape.kind == "box"]
    points = [transform_points(T_world_link @ matrix_from_pose(box.pose), signs * np.array(box.shape.size)) for box in boxes]
    return np.concatenate(points) if points else T_world_link[None, :3, 3]


@dataclass(frozen=True, slots=True)
class DoorChange:
    """How a door differs from its model."""

    handle_height: float
    """Metres above the root."""
    damping: float
    """Of the hinge, N m s/rad."""
    friction: float
    """Of the hinge, N m."""
    handle_friction: float
    """Coefficient of the handle's surface."""


def changed_door(urdf: Path, change: DoorChange) -> str:
    """Returns the text of a URDF of a door with another handle height, damping and friction; its meshes are named by ``file://``.

    The handle gets a round plate at its new height, since the one of the leaf stays where it is.

    Args:
        urdf: of the door: a joint at the root, its leaf, a handle on that.
        change: what is different.
    """
    top = copy.deepcopy(ElementTree.parse(urdf).getroot())
    for mesh in top.iter("mesh"):
        mesh.set("filename", (urdf.parent / mesh.get("filename", "")).resolve().as_uri())
    joints = {_end(joint, "child"): joint for joint in top.iter("joint")}
    handle = next(name for name in joints if any(word in name for word in _GRIPS))
    origin = joints[handle].find("origin")
    assert origin is not None, urdf
    x, y, _ = (origin.get("xyz") or "0 0 0").split()
    origin.set("xyz", f"{x} {y} {change.handle_height:.5f}")
    hinge = joints[_end(joints[handle], "parent")]
    for key, value in (("damping", change.damping), ("friction", change.friction)):
        _part(hinge, "dynamics").set(key, f"{value:.5f}")
    link = next(element for element in top.iter("link") if element.get("name") == handle)
    _part(_part(link, "contact"), "lateral_friction").set("value", f"{change.handle_friction:.5f}")
    link.append(ElementTree.fromstring(_PLATE))
    return ElementTree.tostring(top, encoding="unicode")


_PLATE = """<visual><origin rpy="1.570796 0 0"/><geometry><cylinder radius="0.026" length="0.052"/></geometry>
<material name="steel"><color rgba="0.62 0.62 0.62 1"/></material></visual>"""


def _end(joint: ElementTree.Element, tag: str) -> str:
    end = joint.find(tag)
    assert end is not None, joint.get("name")
    return end.get("link", "")


def _part(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Returns a part of an element; a new one where it has none."""
    found = element.find(tag)
    return ElementTree.SubElement(element, tag) if found is None else found


@dataclass(frozen=True, slots=True, eq=False)
class BackingWay:
    """Where a base goes while it pulls a door open."""

    openings: F64
    """(N,), of the door, radians, rising."""
    places: F64
    """(N, 2), of the base, world metres."""
    yaws: F64
    """(N,), radians, without jumps."""

    @property
    def leaving(self) -> F64:
        """Places (3, 2) after that: away from the handle, to have the room to fold the arm."""
        back = -np.array([math.cos(self.yaws[-1]), math.sin(self.yaws[-1])])
        return np.asarray(self.places[-1] + np.linspace(0.1, LEAVE, 3)[:, None] * back)

    def speeds(self, base: tuple[float, float, float], opening: float) -> XY:
        """Returns forward speed, m/s, and yaw rate, rad/s, of a base that follows it.

        Args:
            base: where it is: x, y, yaw.
            opening: how far the door shall be open soon, radians.
        """
        dx, dy = (float(np.interp(opening, self.openings, self.places[:, k])) - base[k] for k in range(2))
        c, s = math.cos(base[2]), math.sin(base[2])
        ahead, left = c * dx + s * dy, c * dy - s * dx
        # Backing up, a base that turns to the right goes to the left.
        heading = float(np.interp(opening, self.openings, self.yaws)) - max(-0.3, min(0.3, 2.0 * left))
        turn = 1.5 * math.remainder(heading - base[2], 2.0 * math.pi)
        return max(-0.25, min(0.2, 1.5 * ahead)), max(-0.5, min(0.5, turn))


def backing_way(door: HingedDoor, slant: float, wide: float, opening: float = 0.0) -> BackingWay:
    """Returns where the base goes while it pulls a door open, if everything obeys at once: it keeps its distance to its hand, and faces it.

    Args:
        door: which.
        slant: under which the robot takes the handle, see ``HingedDoor.towards``.
        wide: how far it pulls, radians, unless its hand would press against the edge of the leaf before.
        opening: of the door when it begins, radians.
    """
    grip = np.array(door.grip(opening, slant)) - np.array(door.hinge)
    radius, first = float(np.hypot(*grip)), math.atan2(grip[1], grip[0]) - door.sense * opening
    (x, y), yaw = door.stance(opening, slant), door.towards(opening, slant) + math.pi
    way = [(opening, x, y, yaw)]
    while opening < wide:
        opening += 0.1 * PULL_SPEED / radius
        at = first + door.sense * opening
        hand = door.hinge[0] + radius * math.cos(at), door.hinge[1] + radius * math.sin(at)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = hand[0] - x, hand[1] - y
        linear = 1.5 * (math.hypot(dx, dy) - REACH)
        angular = math.atan2(c * dy - s * dx, c * dx + s * dy)
        x, y, yaw = x + 0.1 * linear * c, y + 0.1 * linear * s, yaw + 0.1 * angular
        if door.slant(opening, hand, (x, y)) < LEAST_SLANT:
            break
        way.append((opening, x, y, yaw))
    rows = np.array(way)
    return BackingWay(rows[:, 0], rows[:, 1:3], rows[:, 3])


Bools = NDArray[np.bool_]
LEAST = math.radians(75.0)
"""A door that has no room to open so wide is left alone."""
AWAY = (0.9, 2.4)
"""Metres of start and goal from the plane of the closed door."""
_SLANTS = tuple(math.radians(angle) for angle in (45.0, 40.0, 35.0, 30.0, 25.0, 20.0))
_FARTHEST = 3.2
"""Metres of them from the middle of the doorway."""
_BESIDE = 0.05
"""Metres that a base keeps free beside it while it pulls."""
_WALL = 0.14
"""Metres from the plane of a closed door: so near to it the leaf swings within the doorway."""
_THICK = 0.03
"""Half the thickness of a leaf, with a little to spare, metres."""
_SNAP = 0.35
"""Metres to the nearest place of a robot at which it counts as there."""
_STEP = math.radians(2.0)


@dataclass(frozen=True)
class Doorway:
    """A door that can be opened, and gone through in no other way."""

    door: HingedDoor
    ground: Ground
    """With all bodies of the scene as obstacles, but for this door."""
    slant: float
    """Under which the handle is taken, see ``HingedDoor.towards``."""
    wide: float
    """How far it is pulled open, radians."""
    near: Bools
    """(H, W): where a robot may start, on the side on which it opens."""
    far: Bools
    """(H, W): where it may have to go, on the other one."""


def with_bodies(ground: Ground, without: Collection[str]) -> Ground:
    """Returns the ground with the bodies of its scene as obstacles, where they stand at load, but for those named."""
    bodies = tuple(body for body in ground.scene.bodies if body.name not in without)
    if not bodies:
        return ground
    vertices, triangles = body_triangles(replace(ground.scene, bodies=bodies))
    floor = ground.floor
    parts = clip_to_slab(vertices[triangles], floor.floor_z, floor.floor_z + ground.robot.height)
    return replace(ground, floor=ground.floor_with(parts))


def doorway(ground: Ground, door: HingedDoor, without: Collection[str] = ()) -> Doorway | None:
    """Returns the doorway of a door; None = a robot has no room there, or can go another way.

    Args:
        ground: where.
        door: hung where it shall be.
        without: names of bodies of the scene that are not there.
    """
    if abs(door.closed.position[2] - ground.floor.floor_z) > FLOOR_TOLERANCE:
        return None
    there = with_bodies(ground, without)
    rooms = {slant: _room(there, door, slant) for slant in _SLANTS}
    slant = max(rooms, key=lambda angle: rooms[angle])
    wide = rooms[slant]
    if wide < LEAST:
        return None
    shut, opened = (there.parts([leaf_outline(door, opening)]) for opening in (0.0, wide))
    before, behind = door.stance(0.0, slant), door.off(door.width / 2.0, -AWAY[0])
    near, far = (_label(shut, there.floor, place) for place in (before, behind))
    if not near or not far or near == far or _label(opened, there.floor, before) != _label(opened, there.floor, behind):
        return None
    centers = there.floor.centers(np.indices(there.floor.shape).transpose(1, 2, 0)).reshape(-1, 2)
    away = door.away(centers).reshape(there.floor.shape)
    close = np.linalg.norm(centers - np.array(door.off(door.width / 2.0, 0.0)), axis=1).reshape(away.shape) < _FARTHEST
    regions = [
        np.asarray((shut == label) & close & (side * away > AWAY[0]) & (side * away < AWAY[1]))
        for label, side in ((near, 1.0), (far, -1.0))
    ]
    return Doorway(door, there, slant, wide, regions[0], regions[1]) if all(region.any() for region in regions) else None


def leaf_outline(door: HingedDoor, opening: float) -> F64:
    """Returns the corners (4, 2) of the leaf from above, world metres, open by ``opening`` radians; without its handles."""
    end = np.array(door.at(opening, door.width))
    across = _THICK * np.array([-math.sin(door.bearing + door.sense * opening), math.cos(door.bearing + door.sense * opening)])
    hinge = np.array(door.hinge)
    return np.stack([hinge - across, end - across, end + across, hinge + across])


def _room(ground: Ground, door: HingedDoor, slant: float) -> float:
    """Returns how far a robot can pull a door open before it or the leaf touches something, radians."""
    way = backing_way(door, slant, min(WIDE, door.stop - _STEP))
    clear = ground.floor.clearance(np.concatenate([way.places, way.leaving])) >= ground.robot.radius + _BESIDE
    last = len(way.openings) - 1
    most = float(way.openings[last if clear.all() else min(last, max(0, int(clear.argmin()) - 1))])
    radii = np.arange(0.15, door.width, ground.floor.resolution / 2.0)
    for opening in np.arange(0.0, most, _STEP):
        points = np.array([door.at(float(opening), float(radius)) for radius in radii])
        cells = ground.floor.cells(points[door.away(points) > _WALL])
        if ground.floor.occupied[cells[:, 0], cells[:, 1]].any():
            return max(0.0, float(opening) - 2.0 * _STEP)
    return most


def _label(labels: NDArray[np.int32], floor: FloorMap, place: XY) -> int:
    """Returns the part of the floor nearest to a place, 0 = none is near."""
    cells = np.argwhere(labels)
    distances = np.linalg.norm(floor.centers(cells) - np.array(place), axis=1)
    if not len(cells) or distances.min() > _SNAP:
        return 0
    return int(labels[tuple(cells[int(distances.argmin())])])
