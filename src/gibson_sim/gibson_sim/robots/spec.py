"""``RobotSpec``, the specification of a robot: links, drive, cameras, sensors, arms. Pure values; ``robots.load`` reads them from files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.errors import RobotError
from gibson_sim.quoting import quoted
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.robots.sensor_specs import SensorSpecs
from gibson_sim.types import CameraSpec, Pose


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """A robot: its links, drive, sensors and arms, and its start pose."""

    name: str
    """Body name: its links are ``<name>/<link>``."""
    urdf: Path
    base_link: str
    """Root link of the URDF, e.g. ``base_footprint``: the frame of odometry."""
    links: tuple[str, ...]
    """Names of all links, the root first, without the body name."""
    visuals: tuple[VisualSpec, ...]
    fixed_transforms: tuple[tuple[str, str, Pose], ...]
    """(parent link, child link, T_parent_child) of every fixed joint, for /tf_static."""
    moving_joints: tuple[tuple[str, str, str], ...]
    """(joint, parent link, child link) of every other joint, in the order of the URDF."""
    drive: DriveSpec | None
    radius: float
    """Radius of the smallest circle about the base that contains the robot's footprint, metres."""
    height: float
    """Height above the floor, metres."""
    cameras: tuple[CameraSpec, ...] = ()
    sensors: SensorSpecs = field(default_factory=SensorSpecs)
    """Sensors other than cameras."""
    start: Pose = field(default_factory=Pose)
    """T_world_base at load and after a reset."""
    fixed_base: bool = False
    """Whether the root link is fixed to the world, as for an arm on a table; such a robot has no drive."""
    joints: tuple[tuple[str, float], ...] = ()
    """(Joint name, position) at load and after a reset, radians or metres; missing joints are at 0."""
    named_poses: tuple[NamedPose, ...] = ()
    manipulators: tuple[ManipulatorSpec, ...] = ()
    """Arms, in the order of the file."""
    namespace: str = ""
    """Namespace of all its topics; empty = none."""
    frame_prefix: str = ""
    """Prefix of the names of its tf frames, e.g. ``left/``; empty = frames as in the URDF."""
    own_tf: bool = False
    """Whether its transforms are on ``tf`` and ``tf_static`` in its namespace, not on the common ``/tf``."""

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


@dataclass(frozen=True, slots=True)
class ManipulatorSpec:
    """A chain of joints that moves a tool."""

    name: str
    joints: tuple[str, ...]
    """Joints from the base to the tool; each moves the following ones."""
    tip_link: str
    """Link whose frame is the tool centre point, which inverse kinematics and Cartesian commands move."""
    base_link: str
    """Parent of the first joint."""
    gripper: GripperSpec | None = None


@dataclass(frozen=True, slots=True)
class GripperSpec:
    """A gripper whose fingers open and close together."""

    joints: tuple[str, ...]
    """Joints of the fingers, one for each finger with a motor; fingers that mimic another are left out."""
    open: float
    """Position of every joint when the gripper is open, radians or metres."""
    closed: float
    """Position of every joint when the empty gripper is closed, radians or metres."""
    max_effort: float
    """Effort limit of each joint, N or N m, unless a command gives a lower one."""

    @property
    def links_apart(self) -> float:
        """Sum of the joints' motions between open and closed: the opening of a parallel gripper, metres."""
        return abs(self.open - self.closed) * len(self.joints)


@dataclass(frozen=True, slots=True)
class NamedPose:
    """Named positions of some joints."""

    name: str
    joints: tuple[tuple[str, float], ...]
    """(Joint name, position), radians or metres."""
