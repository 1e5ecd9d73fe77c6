"""Scenes as values: visuals, collision shapes, bodies, light, start poses and robots. ``scenes.load`` reads files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.room_spec import RoomSpec, room_at
from gibson_sim.types import CameraSpec, Pose, Vec3

UNLABELLED = "unlabelled"
"""Name of semantic class 0."""
SPLAT_SCALES = (1e-4, 1e4)
"""Minimum and maximum scale of splats, metres per unit of their file."""


@dataclass(frozen=True, slots=True)
class CollisionSpec:
    """A static shape in the world that robots and rays collide with."""

    name: str
    shape: Shape
    pose: Pose = field(default_factory=Pose)
    """T_world_shape."""
    friction: float = 1.0
    """Coulomb friction, 0 to 1; the engine multiplies it with that of the robot or body."""


@dataclass(frozen=True, slots=True)
class StartPose:
    """A named pose on the floor where a robot can start."""

    name: str
    pose: Pose
    """T_world_base."""


@dataclass(frozen=True, slots=True)
class PointLight:
    """A point or spot light. It casts no shadows, so it lights through walls: give it a ``range``."""

    position: Vec3
    """World frame, metres."""
    color: Vec3 = (1.0, 1.0, 1.0)
    """Colour, sRGB, 0 to 1."""
    strength: float = 1.0
    """Linear; 1 = a white surface that faces the lamp becomes white at 1 m, and a quarter of that at 2 m."""
    range: float = 0.0
    """Distance at which the light has faded to zero, metres; 0 = no limit."""
    attenuation: Vec3 = (0.0, 0.0, 1.0)
    """Constant, linear and quadratic coefficients: the strength at d metres is divided by ``a + b d + c d^2``."""
    direction: Vec3 = (0.0, 0.0, -1.0)
    """Direction of a spot light, world frame; need not be a unit vector."""
    inner_angle: float = math.pi
    """Angle from ``direction`` up to which a spot light has full strength, radians."""
    outer_angle: float = math.pi
    """Angle from ``direction`` beyond which a spot light gives no light, radians; pi = a point light."""

    def __post_init__(self) -> None:
        what = "point light"
        _check_numbers(what, "position", self.position)
        _check_numbers(what, "color", self.color, 0.0, 1.0)
        _check_number(what, "strength", self.strength, 0.0)
        _check_number(what, "range", self.range, 0.0)
        _check_numbers(what, "attenuation", self.attenuation, 0.0)
        if not any(self.attenuation):
            raise ConfigError(f"{what}: attenuation is {quoted(self.attenuation)}, one of the three must be above 0")
        _check_direction(what, "direction", self.direction)
        _check_number(what, "outer_angle", self.outer_angle, 0.0, math.pi)
        _check_number(what, "inner_angle", self.inner_angle, 0.0, math.pi)
        if self.inner_angle > self.outer_angle:
            raise ConfigError(
                f"{what}: inner_angle is {self.inner_angle:g} rad, must be at most outer_angle, which is {self.outer_angle:g} rad"
            )


@dataclass(frozen=True, slots=True)
class LightSpec:
    """The light on surfaces without baked light: all surfaces of ``flat``, but in the baked homes only robots and movable bodies.

    With a sun and ambient light alone, the sun also brightens surfaces that face away from it, in place of the light that a real room
    reflects. With shadows, lamps or an environment it lights only the surfaces that it reaches.
    """

    sun_direction: Vec3 = (0.4, 0.3, -0.85)
    """Direction in which the sunlight travels, world frame; need not be a unit vector."""
    sun: float = 0.55
    """Strength of the directional light, linear; 1 = white surfaces that face it become white."""
    ambient: float = 0.5
    """Strength of the ambient light, linear; added to that of the environment."""
    background: Vec3 = (0.70, 0.76, 0.82)
    """Colour of the background, sRGB, 0 to 1."""
    sun_color: Vec3 = (1.0, 1.0, 1.0)
    """Colour of the sunlight, sRGB, 0 to 1."""
    shadows: bool = False
    """Whether the sun casts shadows. Keep it off in closed rooms, whose ceilings would block the sun."""
    points: tuple[PointLight, ...] = ()
    environment: str = ""
    """Absolute path of an equirectangular image of the surroundings (.hdr, PNG or JPEG); empty = none. Its middle column lies in
    direction +x of the world, and the columns left of it towards +y."""
    environment_strength: float = 1.0
    """Factor on the light of the environment and on light maps, linear."""
    environment_yaw: float = 0.0
    """Rotation of the environment about the world's z axis, counter-clockwise, radians."""
    environment_visible: bool = True
    """Whether the environment is the background."""
    backdrop: str = ""
    """Absolute path of an equirectangular background image that emits no light, such as the view from the windows of a lit room;
    empty = none."""

    def __post_init__(self) -> None:
        what = "light"
        _check_direction(what, "sun_direction", self.sun_direction)
        for name in ("sun", "ambient", "environment_strength"):
            _check_number(what, name, getattr(self, name), 0.0)
        for name in ("background", "sun_color"):
            _check_numbers(what, name, getattr(self, name), 0.0, 1.0)
        _check_number(what, "environment_yaw", self.environment_yaw)
        for number, point in enumerate(self.points):
            if not isinstance(point, PointLight):
                raise ConfigError(f"{what}: points[{number}] is {quoted(point)}, must be a PointLight")


@dataclass(frozen=True, slots=True)
class SplatsSpec:
    """Gaussian splats that are drawn over the visuals of the scene. They change only colours: all other outputs are those of the visuals."""

    file: str
    """Absolute path of a PLY or SPZ file."""
    pose: Pose = field(default_factory=Pose)
    """T_world_file, without the scale."""
    scale: float = 1.0
    """Scale, metres per unit of the file."""

    def __post_init__(self) -> None:
        _check_number("splats", "scale", self.scale, *SPLAT_SCALES)


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """A scene with its robots. The world frame has z up (REP 103), metres."""

    name: str
    root: Path
    """Folder of the scene's files."""
    content_hash: str
    """Hex digest of the scene's description and files; equal hash = equal scene."""
    visuals: tuple[VisualSpec, ...]
    """Static visuals: ``link`` is empty."""
    collisions: tuple[CollisionSpec, ...]
    ground_z: float | None = None
    """Height of an infinite ground plane for physics, metres; None = no ground plane."""
    floor_z: float = 0.0
    """Height of the floor that robots start on, metres."""
    gravity: Vec3 = (0.0, 0.0, -9.81)
    """Gravity, m/s^2."""
    starts: tuple[StartPose, ...] = ()
    light: LightSpec = field(default_factory=LightSpec)
    robots: tuple[RobotSpec, ...] = ()
    warnings: tuple[str, ...] = ()
    """Elements that could not be loaded and were left out or replaced, one line each."""
    revision: int = 1
    """1 at load, plus the number of additions and removals since."""
    bodies: tuple[BodySpec, ...] = ()
    """Bodies other than robots, which can be added and removed."""
    other_floors: tuple[float, ...] = ()
    """Heights of the floors other than ``floor_z``, metres."""
    rooms: tuple[RoomSpec, ...] = ()
    """Rooms that the scene names."""
    floor_estimated: bool = False
    """Whether ``floor_z`` is an estimate: the height with the most up-facing area in the lowest metre."""
    splats: SplatsSpec | None = None
    """Splats that are drawn over the visuals; None = no splats."""
    ground_friction: float = 1.0
    """Coulomb friction of the ground plane, as that of a ``CollisionSpec``."""

    @property
    def floors(self) -> tuple[float, ...]:
        """Heights of all floors, from the lowest, metres."""
        return tuple(sorted({self.floor_z, *self.other_floors}))

    @property
    def is_only_ground(self) -> bool:
        """Whether the scene has nothing but the ground: no visual, no collision shape and no body; robots do not count."""
        return not (self.visuals or self.collisions or self.bodies)

    def room_at(self, x: float, y: float, floor: int = 0) -> RoomSpec | None:
        """Returns the room at a point, world metres, on a floor, 0 = the lowest; None = no room there."""
        return room_at(self.rooms, x, y, floor)


@dataclass(frozen=True, slots=True)
class DrawnScene:
    """The half of a scene that a renderer needs, published as ``gibson_msgs/Scene``."""

    name: str
    revision: int
    content_hash: str
    links: tuple[str, ...]
    """Names of all moving links, in the order of ``SceneState.links``."""
    visuals: tuple[VisualSpec, ...]
    cameras: tuple[CameraSpec, ...]
    """Cameras, in the order of ``due_cameras``."""
    light: LightSpec
    splats: SplatsSpec | None = None
    """Splats that are drawn over the static visuals; None = no splats."""

    @property
    def semantic_classes(self) -> tuple[str, ...]:
        """Class names in alphabetical order after ``unlabelled``: the index is the class ID."""
        return (UNLABELLED, *sorted({v.semantic_class for v in self.visuals} - {"", UNLABELLED}))

    @property
    def instances(self) -> tuple[str, ...]:
        """Names of all instances after ``""``: each static visual, and each moving body as a whole."""
        return ("", *dict.fromkeys(_instance(v) for v in self.visuals))

    def labels(self) -> tuple[tuple[int, int], ...]:
        """Returns (semantic class, instance) of every visual, as indices into ``semantic_classes`` and ``instances``."""
        classes = {name: i for i, name in enumerate(self.semantic_classes)}
        instances = {name: i for i, name in enumerate(self.instances)}
        return tuple((classes.get(v.semantic_class, 0), instances[_instance(v)]) for v in self.visuals)


def _instance(visual: VisualSpec) -> str:
    """Returns the name of the instance that a visual belongs to."""
    return visual.link.partition("/")[0] if visual.link else visual.name


def drawn_scene(scene: SceneSpec, links: tuple[str, ...]) -> DrawnScene:
    """Returns the half of a scene that a renderer needs; ``links``: names of its moving links, in the order of ``SceneState.links``."""
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
        splats=scene.splats,
    )


def _check_number(what: str, name: str, value: object, low: float = -math.inf, high: float = math.inf) -> None:
    if not _is_number(value, low, high):
        raise ConfigError(f"{what}: {name} is {quoted(value)}, must be a finite number{_limits(low, high)}")


def _check_numbers(what: str, name: str, values: Vec3, low: float = -math.inf, high: float = math.inf) -> None:
    try:
        valid = len(values) == 3 and all(_is_number(value, low, high) for value in values)
    except TypeError:
        valid = False
    if not valid:
        raise ConfigError(f"{what}: {name} is {quoted(values)}, must be three finite numbers{_limits(low, high)}")


def _check_direction(what: str, name: str, value: Vec3) -> None:
    _check_numbers(what, name, value)
    if not any(value):
        raise ConfigError(f"{what}: {name} is {quoted(value)}, must not be zero")


def _is_number(value: object, low: float, high: float) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and low <= float(value) <= high and math.isfinite(float(value))


def _limits(low: float, high: float) -> str:
    if math.isfinite(high):
        return f" from {low:g} to {high:g}"
    return f", {low:g} or more" if math.isfinite(low) else ""
