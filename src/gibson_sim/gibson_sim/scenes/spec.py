"""What a scene is: what is drawn, what collides, where robots start. Pure values; reading files is in ``scenes.load``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.room_spec import RoomSpec, room_at
from gibson_sim.types import CameraSpec, Pose, Vec3

UNLABELLED = "unlabelled"
"""Name of semantic class 0."""


@dataclass(frozen=True, slots=True)
class CollisionSpec:
    """A static shape in the world that robots and rays hit."""

    name: str
    shape: Shape
    pose: Pose = field(default_factory=Pose)
    """T_world_shape."""


@dataclass(frozen=True, slots=True)
class StartPose:
    """A named place where a robot can start, on the floor."""

    name: str
    pose: Pose


@dataclass(frozen=True, slots=True)
class PointLight:
    """A lamp. It throws no shadows, so it also shines through walls: give it a ``range``."""

    position: Vec3
    """World frame, metres."""
    color: Vec3 = (1.0, 1.0, 1.0)
    """sRGB, 0 to 1."""
    strength: float = 1.0
    """Linear; 1 = a white surface that faces it at 1 m becomes white, and a quarter of that at 2 m."""
    range: float = 0.0
    """Metres; its light fades out towards here and is nothing beyond; 0 = no end."""
    attenuation: Vec3 = (0.0, 0.0, 1.0)
    """Constant, linear and quadratic part: at d metres the strength is divided by ``a + b d + c d^2``."""
    direction: Vec3 = (0.0, 0.0, -1.0)
    """Where a spot points, world frame; need not be a unit vector."""
    inner_angle: float = math.pi
    """Spot: full strength up to this angle from ``direction``, radians."""
    outer_angle: float = math.pi
    """Spot: nothing from this angle on, radians; pi = it shines all around."""


@dataclass(frozen=True, slots=True)
class LightSpec:
    """How surfaces without baked light are lit.

    With a sun and ambient light alone, the sun also brightens surfaces that are turned away from it, a stand-in for the light that a
    real room throws back. Shadows, lamps or an environment make it light as it is: nothing where it does not reach.
    """

    sun_direction: Vec3 = (0.4, 0.3, -0.85)
    """World frame, the way the light travels; need not be a unit vector."""
    sun: float = 0.55
    """Strength of the directional light, linear, 1 = white surfaces facing it become white."""
    ambient: float = 0.5
    """Strength of the light from everywhere, linear; comes on top of the environment, where there is one."""
    background: Vec3 = (0.70, 0.76, 0.82)
    """Colour where nothing is, sRGB, 0 to 1."""
    sun_color: Vec3 = (1.0, 1.0, 1.0)
    """sRGB, 0 to 1."""
    shadows: bool = False
    """The sun throws shadows. Leave it off inside closed rooms: their ceilings would keep all of it out."""
    points: tuple[PointLight, ...] = ()
    environment: str = ""
    """Absolute path of an equirectangular image of the surroundings (.hdr, or PNG or JPEG); empty = none. Its middle column is seen
    when looking along +x, and what is left of it lies towards +y."""
    environment_strength: float = 1.0
    """Factor on the environment's light, linear."""
    environment_yaw: float = 0.0
    """Turns the environment about the world's z axis, counter-clockwise, radians."""
    environment_visible: bool = True
    """Show the environment as the background."""
    backdrop: str = ""
    """Absolute path of an equirectangular image that is the background and lights nothing; empty = none. What is seen through the windows
    of a room, say, whose things the room itself lights."""


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """A scene with its robots. The world frame has z up (REP 103), metres."""

    name: str
    root: Path
    """Folder that all its files lie in."""
    content_hash: str
    """Hex digest of the scene's description and files; equal hash = equal scene."""
    visuals: tuple[VisualSpec, ...]
    """Static: ``link`` is empty."""
    collisions: tuple[CollisionSpec, ...]
    ground_z: float | None = None
    """Height of an endless ground plane for physics, metres; None = no such plane."""
    floor_z: float = 0.0
    """Height of the floor that robots start on, metres."""
    gravity: Vec3 = (0.0, 0.0, -9.81)
    """m/s^2."""
    starts: tuple[StartPose, ...] = ()
    light: LightSpec = field(default_factory=LightSpec)
    robots: tuple[RobotSpec, ...] = ()
    warnings: tuple[str, ...] = ()
    """What could not be loaded and was left out or replaced, one line each."""
    revision: int = 1
    """Counts what was added or removed since load."""
    bodies: tuple[BodySpec, ...] = ()
    """Things that are no robots and can be moved, added and removed."""
    other_floors: tuple[float, ...] = ()
    """Heights of the floors beside ``floor_z``, metres."""
    rooms: tuple[RoomSpec, ...] = ()
    """Rooms that the scene names."""
    floor_estimated: bool = False
    """Whether no file says ``floor_z``: most of what faces up in the lowest metre lies there."""

    @property
    def floors(self) -> tuple[float, ...]:
        """Heights of all floors, from the lowest, metres."""
        return tuple(sorted({self.floor_z, *self.other_floors}))

    def room_at(self, x: float, y: float, floor: int = 0) -> RoomSpec | None:
        """Returns the room at a place, world metres, on a floor, 0 = the lowest; None = the scene names none there."""
        return room_at(self.rooms, x, y, floor)


@dataclass(frozen=True, slots=True)
class DrawnScene:
    """The half of a scene that a renderer needs: what travels as ``gibson_msgs/Scene``."""

    name: str
    revision: int
    content_hash: str
    links: tuple[str, ...]
    """Names of all moving links, in the order of ``SceneState.links``."""
    visuals: tuple[VisualSpec, ...]
    cameras: tuple[CameraSpec, ...]
    """In the order that ``due_cameras`` counts."""
    light: LightSpec

    @property
    def semantic_classes(self) -> tuple[str, ...]:
        """Class names in alphabetical order after ``unlabelled``: the index is the class."""
        return (UNLABELLED, *sorted({v.semantic_class for v in self.visuals} - {"", UNLABELLED}))

    @property
    def instances(self) -> tuple[str, ...]:
        """Names of the things that can be told apart, after ``""``: static visuals, and moving bodies as wholes."""
        return ("", *dict.fromkeys(_instance(v) for v in self.visuals))

    def labels(self) -> tuple[tuple[int, int], ...]:
        """Returns (semantic class, instance) of every visual, as indices into the two lists above."""
        classes = {name: i for i, name in enumerate(self.semantic_classes)}
        instances = {name: i for i, name in enumerate(self.instances)}
        return tuple((classes.get(v.semantic_class, 0), instances[_instance(v)]) for v in self.visuals)


def _instance(visual: VisualSpec) -> str:
    return visual.link.partition("/")[0] if visual.link else visual.name


def drawn_scene(scene: SceneSpec, links: tuple[str, ...]) -> DrawnScene:
    """Returns what a renderer needs of ``scene``, whose moving links are ``links``."""
    return DrawnScene(
        name=scene.name,
        revision=scene.revision,
        content_hash=scene.content_hash,
        links=links,
        visuals=(
            *scene.visuals,
            *(v for robot in scene.robots for v in robot.visuals),
            *(v for body in scene.bodies for v in body.visuals),
        ),
        cameras=tuple(c for robot in scene.robots for c in robot.cameras),
        light=scene.light,
    )
