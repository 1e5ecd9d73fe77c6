"""Hinged doors: finds them in a scene, modifies their hinge and handle, and plans how a robot pulls one open and drives through. Pure.

A robot grasps the handle and backs up along a ``BackingPath`` while its gripper follows the handle about the hinge. The slant is the angle
between the direction of pulling and the normal of the leaf. ``doorway`` finds a slant for which there is room.
"""

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
from gibson_sim.tasks.episode import Observation
from gibson_sim.tasks.ground import Ground
from gibson_sim.types import Pose

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
XY = tuple[float, float]

HOLD_DISTANCE = 0.66
"""Distance from the base to the tool, straight ahead, while a robot holds a handle, metres."""
PULL_SPEED = 0.12
"""Speed of the handle while it is pulled, m/s."""
LEAVE = 0.3
"""Distance by which the robot then backs away from the handle, metres."""
WIDE = math.radians(86.0)
"""Largest opening to which a robot pulls a door: at 90 degrees the simulation releases the handle during the pull."""
LEAST = math.radians(75.0)
"""Minimum opening: doors without room to open so wide are not used."""
AWAY = (0.9, 2.4)
"""Minimum and maximum distance of start and goal from the plane of the closed door, metres."""
LEAST_SLANT = math.radians(-52.0)
"""Minimum slant: at smaller slants the gripper would press against the edge of the leaf."""
_SLANTS = tuple(math.radians(angle) for angle in (45.0, 40.0, 35.0, 30.0, 25.0, 20.0))
"""Candidate slants."""
_LEVER, _OFF_LEAF = 0.05, 0.063
"""Grasp point on a lever: distance from its axis along the leaf towards the hinge, and from the mid-plane of the leaf, metres."""
_SHORT = 0.07
"""Distance from the grasp point to the tool, metres: nearer, the palm would press against the lever."""
_FARTHEST = 3.2
"""Maximum distance of start and goal from the centre of the doorway, metres."""
_BESIDE = 0.05
"""Clearance of the base while it pulls, metres."""
_WALL = 0.14
"""Distance from the plane of the closed door within which the leaf is inside the doorway, metres."""
_THICK = 0.03
"""Half the thickness of a leaf, with a margin, metres."""
_SNAP = 0.35
"""Maximum distance from a position to its region, metres."""
_STEP = math.radians(2.0)
"""Increment of the opening in the search for obstacles, radians."""
_TALLEST_CABINET = 1.6
"""Minimum height of a door leaf, metres: lower leaves belong to cabinets."""
_UPRIGHT = 0.99
"""Minimum absolute z of the unit axis of a vertical hinge."""
_GRIPS = ("handle", "knob")
"""Words in the names of handle links."""


@dataclass(frozen=True, slots=True)
class HingedDoor:
    """A door with a vertical hinge and a handle. Coordinates are x, y of the world frame, metres."""

    body: str
    """Name of the body."""
    leaf: str
    """Full name of the door leaf's link, ``<body>/<link>``."""
    handle: str
    """Full name of the handle's link."""
    closed: Pose
    """T_world_leaf of the closed door."""
    hinge: XY
    """Position of the hinge axis, metres."""
    radius: float
    """Distance from the hinge to the axis of the handle, metres."""
    bearing: float
    """Direction from the hinge to the handle of the closed door, radians."""
    sense: float
    """Direction of opening in top view: 1 = counter-clockwise, -1 = clockwise."""
    stop: float
    """Maximum opening, radians."""
    width: float
    """Distance from the hinge to the far edge of the leaf, metres."""
    handle_z: float
    """Height of the handle, world frame, metres."""

    def at(self, opening: float, radius: float | None = None) -> XY:
        """Returns the point of the leaf at ``radius`` metres from the hinge (None = the handle) for an opening in radians."""
        angle, length = self.bearing + self.sense * opening, self.radius if radius is None else radius
        return self.hinge[0] + length * math.cos(angle), self.hinge[1] + length * math.sin(angle)

    @property
    def outwards(self) -> float:
        """Direction of the normal of the closed leaf, on the side to which it opens, radians."""
        return self.bearing + self.sense * math.pi / 2.0

    def towards(self, opening: float, slant: float) -> float:
        """Returns the direction from the handle to the pulling robot, radians.

        Args:
            opening: opening of the door, radians.
            slant: angle from the normal of the leaf towards the hinge, radians.
        """
        return self.outwards + self.sense * (opening + slant)

    def grip(self, opening: float, slant: float) -> XY:
        """Returns the position of the tool that grasps the handle; see ``towards``."""
        x, y = self.at(opening, self.radius - _LEVER)
        for angle, length in ((self.towards(opening, 0.0), _OFF_LEAF), (self.towards(opening, slant), _SHORT)):
            x, y = x + length * math.cos(angle), y + length * math.sin(angle)
        return x, y

    def stance(self, opening: float, slant: float, distance: float = HOLD_DISTANCE) -> XY:
        """Returns the position of the base for grasping the handle, ``distance`` metres from the tool, which it faces."""
        (x, y), angle = self.grip(opening, slant), self.towards(opening, slant)
        return x + distance * math.cos(angle), y + distance * math.sin(angle)

    def slant(self, opening: float, tool: XY, base: XY) -> float:
        """Returns the slant of pulling with the base at ``base`` and the tool at ``tool``, radians."""
        angle = math.atan2(base[1] - tool[1], base[0] - tool[0]) - self.towards(opening, 0.0)
        return self.sense * math.remainder(angle, 2.0 * math.pi)

    def off(self, along: float, away: float) -> XY:
        """Returns the point ``along`` metres from the hinge along the closed leaf and ``away`` metres from it, on the side to which it opens."""
        x, y = self.at(0.0, along)
        return x + away * math.cos(self.outwards), y + away * math.sin(self.outwards)

    def away(self, points: F64) -> F64:
        """Returns the signed distances, (N,), of points (N, 2) from the plane of the closed leaf, metres; positive on the side of opening."""
        return np.asarray((points - np.array(self.hinge)) @ [math.cos(self.outwards), math.sin(self.outwards)])

    def opening(self, obs: Observation) -> float:
        """Returns the opening in an observation, radians."""
        a, b = np.array(self.closed.quat_xyzw), np.array(obs.links[self.leaf].quat_xyzw)
        return 2.0 * math.acos(min(1.0, abs(float(a @ b))))


def hinged_door(body: BodySpec) -> HingedDoor | None:
    """Returns the door of a body; None = not a door: movable, too low, without vertical hinge or without handle."""
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
    """Returns the doors of a scene, in the order of its bodies."""
    return tuple(door for door in map(hinged_door, scene.bodies) if door is not None)


def leaf_outline(door: HingedDoor, opening: float) -> F64:
    """Returns the corners (4, 2) of the leaf in top view, without handles, for an opening in radians; world frame, metres."""
    end = np.array(door.at(opening, door.width))
    across = _THICK * np.array([-math.sin(door.bearing + door.sense * opening), math.cos(door.bearing + door.sense * opening)])
    hinge = np.array(door.hinge)
    return np.stack([hinge - across, end - across, end + across, hinge + across])


def _handle(model: UrdfModel, leaf: str) -> str | None:
    """Returns the name of the handle link on a leaf; None = no handle."""
    children = (joint.child for joint in model.joints if joint.parent == leaf)
    return next((link for link in children if any(word in link for word in _GRIPS)), None)


def _corners(model: UrdfModel, link: str, T_world_link: Mat4) -> F64:
    """Returns the corners (N, 3) of the collision boxes of a link, world frame, metres; its origin if it has no boxes."""
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    boxes = [c for c in model.link(link).collisions if c.shape.kind == "box"]
    points = [transform_points(T_world_link @ matrix_from_pose(box.pose), signs * np.array(box.shape.size)) for box in boxes]
    return np.concatenate(points) if points else T_world_link[None, :3, 3]


_PLATE = """<visual><origin rpy="1.570796 0 0"/><geometry><cylinder radius="0.026" length="0.052"/></geometry>
<material name="steel"><color rgba="0.62 0.62 0.62 1"/></material></visual>"""


@dataclass(frozen=True, slots=True)
class DoorChange:
    """Values that replace those of a door model."""

    handle_height: float
    """Height above the root link, metres."""
    damping: float
    """Damping of the hinge, N m s/rad."""
    friction: float
    """Dry friction of the hinge, N m."""
    handle_friction: float
    """Friction coefficient of the handle's surface."""


def changed_door(urdf: Path, change: DoorChange) -> str:
    """Returns the URDF text of a door with another handle height, damping and friction; meshes are ``file://`` URIs.

    Adds a round plate to the handle at its new height, since the plate in the leaf's mesh remains at the old height.

    Args:
        urdf: URDF file of a door with a hinge joint at the root, a leaf, and a handle on the leaf.
        change: the new values.
    """
    top = copy.deepcopy(ElementTree.parse(urdf).getroot())
    for mesh in top.iter("mesh"):
        mesh.set("filename", (urdf.parent / mesh.get("filename", "")).resolve().as_uri())
    joints = {_linked(joint, "child"): joint for joint in top.iter("joint")}
    handle = next(name for name in joints if any(word in name for word in _GRIPS))
    origin = joints[handle].find("origin")
    assert origin is not None, urdf
    x, y, _ = (origin.get("xyz") or "0 0 0").split()
    origin.set("xyz", f"{x} {y} {change.handle_height:.5f}")
    hinge = joints[_linked(joints[handle], "parent")]
    for key, value in (("damping", change.damping), ("friction", change.friction)):
        _child(hinge, "dynamics").set(key, f"{value:.5f}")
    link = next(element for element in top.iter("link") if element.get("name") == handle)
    _child(_child(link, "contact"), "lateral_friction").set("value", f"{change.handle_friction:.5f}")
    link.append(ElementTree.fromstring(_PLATE))
    return ElementTree.tostring(top, encoding="unicode")


def _linked(joint: ElementTree.Element, tag: str) -> str:
    """Returns the name of the parent or child link of a joint."""
    end = joint.find(tag)
    assert end is not None, joint.get("name")
    return end.get("link", "")


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Returns the child element ``tag``; creates it if it is missing."""
    child = element.find(tag)
    return ElementTree.SubElement(element, tag) if child is None else child


@dataclass(frozen=True, slots=True, eq=False)
class BackingPath:
    """Path of a base that pulls a door open, as a function of the opening."""

    openings: F64
    """(N,), openings of the door, radians, increasing."""
    places: F64
    """(N, 2), positions of the base, world frame, metres."""
    yaws: F64
    """(N,), headings of the base, radians, continuous."""

    @property
    def leaving(self) -> F64:
        """Positions (3, 2) after the pull: away from the handle, with room to fold the arm."""
        back = -np.array([math.cos(self.yaws[-1]), math.sin(self.yaws[-1])])
        return np.asarray(self.places[-1] + np.linspace(0.1, LEAVE, 3)[:, None] * back)

    def speeds(self, base: tuple[float, float, float], opening: float) -> XY:
        """Returns forward speed, m/s, and yaw rate, rad/s, of a base that follows the path.

        Args:
            base: current x, y, yaw of the base, metres and radians.
            opening: next opening of the door, radians.
        """
        dx, dy = (float(np.interp(opening, self.openings, self.places[:, k])) - base[k] for k in range(2))
        c, s = math.cos(base[2]), math.sin(base[2])
        ahead, left = c * dx + s * dy, c * dy - s * dx
        # A base that turns right while backing up moves left.
        heading = float(np.interp(opening, self.openings, self.yaws)) - max(-0.3, min(0.3, 2.0 * left))
        yaw_rate = 1.5 * math.remainder(heading - base[2], 2.0 * math.pi)
        return max(-0.25, min(0.2, 1.5 * ahead)), max(-0.5, min(0.5, yaw_rate))


def backing_path(door: HingedDoor, slant: float, wide: float, opening: float = 0.0) -> BackingPath:
    """Returns the path of a base that pulls a door open without lag: it keeps a constant distance to the gripper, and faces it.

    Args:
        door: the door.
        slant: slant at which the robot grasps the handle, see ``HingedDoor.towards``.
        wide: opening at the end, radians; smaller if the gripper would press against the edge of the leaf.
        opening: opening of the door at the start, radians.
    """
    grip = np.array(door.grip(opening, slant)) - np.array(door.hinge)
    radius, first = float(np.hypot(*grip)), math.atan2(grip[1], grip[0]) - door.sense * opening
    (x, y), yaw = door.stance(opening, slant), door.towards(opening, slant) + math.pi
    path = [(opening, x, y, yaw)]
    while opening < wide:
        opening += 0.1 * PULL_SPEED / radius
        bearing = first + door.sense * opening
        hand = door.hinge[0] + radius * math.cos(bearing), door.hinge[1] + radius * math.sin(bearing)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = hand[0] - x, hand[1] - y
        linear = 1.5 * (math.hypot(dx, dy) - HOLD_DISTANCE)
        angular = math.atan2(c * dy - s * dx, c * dx + s * dy)
        x, y, yaw = x + 0.1 * linear * c, y + 0.1 * linear * s, yaw + 0.1 * angular
        if door.slant(opening, hand, (x, y)) < LEAST_SLANT:
            break
        path.append((opening, x, y, yaw))
    rows = np.array(path)
    return BackingPath(rows[:, 0], rows[:, 1:3], rows[:, 3])


@dataclass(frozen=True)
class Doorway:
    """A door that a robot can pull open, and that is the only connection of two regions."""

    door: HingedDoor
    ground: Ground
    """The ground with all bodies of the scene as obstacles, except this door."""
    slant: float
    """Slant at which the handle is grasped, see ``HingedDoor.towards``."""
    wide: float
    """Opening to which the door is pulled, radians."""
    near: Bools
    """(H, W), mask of start positions, on the side to which the door opens."""
    far: Bools
    """(H, W), mask of goal positions, on the other side."""


def with_bodies(ground: Ground, without: Collection[str]) -> Ground:
    """Returns the ground with the bodies of its scene as obstacles at their initial poses, except those named."""
    bodies = tuple(body for body in ground.scene.bodies if body.name not in without)
    if not bodies:
        return ground
    vertices, triangles = body_triangles(replace(ground.scene, bodies=bodies))
    floor = ground.floor
    parts = clip_to_slab(vertices[triangles], floor.floor_z, floor.floor_z + ground.robot.height)
    return replace(ground, floor=ground.floor.with_obstacles(parts))


def doorway(ground: Ground, door: HingedDoor, without: Collection[str] = ()) -> Doorway | None:
    """Returns the doorway of a door; None = a robot has no room to pull it open, or there is another path.

    Args:
        ground: the floor and the robot.
        door: the door.
        without: names of bodies of the scene that are removed.
    """
    if abs(door.closed.position[2] - ground.floor.floor_z) > FLOOR_TOLERANCE:
        return None
    furnished = with_bodies(ground, without)
    openings = {slant: _widest_opening(furnished, door, slant) for slant in _SLANTS}
    slant = max(openings, key=lambda angle: openings[angle])
    wide = openings[slant]
    if wide < LEAST:
        return None
    floor = furnished.floor
    closed, opened = (furnished.space.with_obstacles([leaf_outline(door, opening)]).regions() for opening in (0.0, wide))
    front, back = door.stance(0.0, slant), door.off(door.width / 2.0, -AWAY[0])
    near, far = (_region_at(closed, floor, position) for position in (front, back))
    if not near or not far or near == far or _region_at(opened, floor, front) != _region_at(opened, floor, back):
        return None
    centers = floor.centers(np.indices(floor.shape).transpose(1, 2, 0)).reshape(-1, 2)
    distance = door.away(centers).reshape(floor.shape)
    close = np.linalg.norm(centers - np.array(door.off(door.width / 2.0, 0.0)), axis=1).reshape(distance.shape) < _FARTHEST
    regions = [
        np.asarray((closed == label) & close & (side * distance > AWAY[0]) & (side * distance < AWAY[1]))
        for label, side in ((near, 1.0), (far, -1.0))
    ]
    return Doorway(door, furnished, slant, wide, regions[0], regions[1]) if all(region.any() for region in regions) else None


def _widest_opening(ground: Ground, door: HingedDoor, slant: float) -> float:
    """Returns the largest opening to which a robot can pull a door without contact of the robot or the leaf with an obstacle, radians."""
    path = backing_path(door, slant, min(WIDE, door.stop - _STEP))
    clear = ground.floor.clearance(np.concatenate([path.places, path.leaving])) >= ground.robot.radius + _BESIDE
    last = len(path.openings) - 1
    widest = float(path.openings[last if clear.all() else min(last, max(0, int(clear.argmin()) - 1))])
    radii = np.arange(0.15, door.width, ground.floor.resolution / 2.0)
    for opening in np.arange(0.0, widest, _STEP):
        points = np.array([door.at(float(opening), float(radius)) for radius in radii])
        cells = ground.floor.cells(points[door.away(points) > _WALL])
        if ground.floor.occupied[cells[:, 0], cells[:, 1]].any():
            return max(0.0, float(opening) - 2.0 * _STEP)
    return widest


def _region_at(labels: NDArray[np.int32], floor: FloorMap, position: XY) -> int:
    """Returns the label of the region nearest to a position; 0 = no region within ``_SNAP``."""
    cells = np.argwhere(labels)
    distances = np.linalg.norm(floor.centers(cells) - np.array(position), axis=1)
    if not len(cells) or distances.min() > _SNAP:
        return 0
    return int(labels[tuple(cells[int(distances.argmin())])])
