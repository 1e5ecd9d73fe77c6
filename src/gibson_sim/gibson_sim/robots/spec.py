"""What a robot is: shapes on links, a drive, cameras and a lidar. Pure values; reading a URDF is in ``robots.urdf``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.quoting import quoted
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.robots.manipulator_spec import ManipulatorSpec, NamedPose
from gibson_sim.robots.sensor_specs import SensorSpecs
from gibson_sim.types import CameraSpec, Pose, Rgba, Vec3

ShapeKind = Literal["mesh", "box", "sphere", "cylinder"]


@dataclass(frozen=True, slots=True)
class Shape:
    """A piece of geometry in its own frame, z up, centred (primitives) or as its file has it (meshes)."""

    kind: ShapeKind
    size: Vec3 = (1.0, 1.0, 1.0)
    """mesh: scale factors along x, y, z; box: edge lengths; sphere: (radius, 0, 0); cylinder about z: (radius, length, 0); m."""
    mesh: str = ""
    """Absolute path of the mesh file; empty for primitives."""


PatternKind = Literal["noise", "stripes", "checker", "image"]
PATTERN_KINDS: tuple[PatternKind, ...] = ("noise", "stripes", "checker", "image")


@dataclass(frozen=True, slots=True)
class Pattern:
    """A texture made of a few numbers, laid over a surface in metres, along the axes of its link (or of the world)."""

    kind: PatternKind = "noise"
    seed: int = 0
    """noise: decides every pixel."""
    colors: tuple[Vec3, Vec3] = ((0.2, 0.2, 0.2), (0.8, 0.8, 0.8))
    """sRGB, 0 to 1; image: not used."""
    size: float = 0.5
    """Metres after which it repeats; stripes and checkers have four pairs of colours in it."""
    image: str = ""
    """kind image: absolute path of the file."""

    def __post_init__(self) -> None:
        if self.kind not in PATTERN_KINDS:
            raise ConfigError(f"pattern is {quoted(self.kind)}, must be one of {', '.join(PATTERN_KINDS)}")
        if not (math.isfinite(self.size) and self.size > 0.0):
            raise ConfigError(f"size of a pattern is {quoted(self.size)} m, must be a finite number above 0")
        if (self.kind == "image") != bool(self.image):
            raise ConfigError(
                f"a pattern of kind {quoted(self.kind)} has image {quoted(self.image)}; kind image needs a file, others have none"
            )


@dataclass(frozen=True, slots=True)
class Look:
    """What changes in the materials of a visual. Where it is solid, and thus depth, labels and normals, never changes."""

    hue: float = 0.0
    """Turns all colours, 1 = once around."""
    saturation: float = 1.0
    """Factor: 0 = grey."""
    value: float = 1.0
    """Factor on the light: 0 = black."""
    pattern: Pattern | None = None
    """Replaces the colours of the texture, but not its opacity; None = they stay."""
    metallic: float | None = None
    """Replaces it, 0 to 1, or None."""
    roughness: float | None = None
    """Replaces it, 0 to 1, or None."""

    @property
    def is_tint(self) -> bool:
        """Whether colours change at all, other than by a pattern."""
        return (self.hue, self.saturation, self.value) != (0.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class VisualSpec:
    """A shape to be drawn."""

    name: str
    """Unique in the scene."""
    link: str
    """Link that it is fixed to, as in ``SceneState.links``; empty = the world, so it never moves."""
    shape: Shape
    pose: Pose = field(default_factory=Pose)
    """T_link_visual."""
    color: Rgba | None = None
    """Replaces the materials of the file (sRGB and alpha, each 0 to 1); None = as the file says."""
    semantic_class: str = ""
    """Class name; empty = unlabelled."""
    look: Look | None = None
    """Changes to the materials; None = none."""


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """One robot, where it starts and what it carries."""

    name: str
    """Body name: its links are ``<name>/<link>``."""
    urdf: Path
    base_link: str
    """Root link of the URDF, e.g. ``base_footprint``: the frame of odometry."""
    links: tuple[str, ...]
    """Names of all links, the root first, without the body name."""
    visuals: tuple[VisualSpec, ...]
    fixed_transforms: tuple[tuple[str, str, Pose], ...]
    """(parent link, child link, T_parent_child) of every fixed joint: what goes to /tf_static."""
    moving_joints: tuple[tuple[str, str, str], ...]
    """(joint, parent link, child link) of every other joint, in the order of the URDF."""
    drive: DriveSpec | None
    radius: float
    """Metres: the smallest circle about the base that holds the robot's footprint."""
    height: float
    """Metres above the floor."""
    cameras: tuple[CameraSpec, ...] = ()
    sensors: SensorSpecs = field(default_factory=SensorSpecs)
    """Sensors other than cameras."""
    start: Pose = field(default_factory=Pose)
    """T_world_base at load and after a reset."""
    joints: tuple[tuple[str, float], ...] = ()
    """Names of joints and where they are at load and after a reset, radians or metres; those that are not named are at 0."""
    named_poses: tuple[NamedPose, ...] = ()
    manipulators: tuple[ManipulatorSpec, ...] = ()
    """Arms, in the order of the file."""
    namespace: str = ""
    """Of all its topics; empty = none."""
    frame_prefix: str = ""
    """Stands before the names of its tf frames, e.g. ``left/``; empty = frames as in the URDF."""
    own_tf: bool = False
    """Its transforms are on ``tf`` and ``tf_static`` in its namespace, not on the common ``/tf``."""

    def named_pose(self, name: str) -> NamedPose:
        """Returns the pose of this name, or raises RobotError that lists the known ones."""
        for pose in self.named_poses:
            if pose.name == name:
                return pose
        raise RobotError(
            f"robot {quoted(self.name)} has no pose {quoted(name)}; known: {', '.join(p.name for p in self.named_poses) or 'none'}"
        )

    def manipulator(self, name: str = "") -> ManipulatorSpec:
        """Returns the arm of this name, "" = the first one; raises RobotError that lists the known ones."""
        for arm in self.manipulators:
            if name in ("", arm.name):
                return arm
        known = ", ".join(arm.name for arm in self.manipulators) or "none"
        raise RobotError(f"robot {quoted(self.name)} has no manipulator {quoted(name)}; known: {known}")
