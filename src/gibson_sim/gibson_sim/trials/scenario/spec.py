"""Values of a scenario file. Metres, radians and seconds of simulation time, unless a name has another unit suffix."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Range = tuple[float, float]
"""Smallest and largest value of a uniform distribution."""
SAMPLED = "sampled"
"""Stands for poses that are sampled from the free poses of a scene."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """Sampling of start and goal poses."""

    path_length: Range = (3.0, 30.0)
    """Length of the shortest path from start to goal for the robot, metres."""
    clearance: float = 0.3
    """Least distance of start and goal to the nearest obstacle, metres."""


@dataclass(frozen=True, slots=True)
class SpawnRule:
    """Obstacles of one kind to spawn."""

    object: str
    """Name in the catalogue, or a file, as for ``gibson-sim spawn``."""
    count: int = 1
    """Number of objects in each run."""
    at: str = "path"
    """``path`` = on or beside the shortest path, with a detour left free; ``sampled`` = any free pose; or ``x,y,yaw_deg`` or a named pose."""


@dataclass(frozen=True, slots=True)
class PersonRule:
    """A person: a capsule that walks back and forth along a path, regardless of obstacles."""

    path: tuple[tuple[float, float], ...] = ()
    """Waypoints in the map frame, metres; empty = two free points on opposite sides of the robot's shortest path."""
    speed: float = 0.8
    """Walking speed, m/s."""
    radius: float = 0.25
    """Radius of the capsule, metres."""
    height: float = 1.75
    """Height of the capsule, metres."""


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Static and moving obstacles."""

    spawn: tuple[SpawnRule, ...] = ()
    """Objects that are spawned before the run starts."""
    closed_doors: tuple[str, ...] = ()
    """Names of bodies whose doors are closed, or ``all``."""
    people: tuple[PersonRule, ...] = ()
    """People who walk around."""


@dataclass(frozen=True, slots=True)
class Randomisation:
    """Values that vary from run to run. None = unchanged."""

    looks: str = ""
    """Rules for lights, colours and textures: a file, or a name under ``config/randomisation``; empty = none."""
    slip: Range | None = None
    """Slip of the drive: fraction of the commanded motion that is lost."""
    noise: Range | None = None
    """Factor on the noise of all sensors and of the odometry."""
    latency: Range | None = None
    """Delay of velocity commands, seconds."""
    friction: Range | None = None
    """Factor on the friction of the floor."""
    payload: Range | None = None
    """Mass of a payload on the robot's base, kg."""


@dataclass(frozen=True, slots=True)
class Ready:
    """Conditions under which the stack can receive a goal. All given conditions must hold."""

    topic: str = ""
    """Topic on which a message must have been published."""
    service: str = ""
    """Service that must be available."""
    node: str = ""
    """Lifecycle node that must be active."""
    within: float = 60.0
    """Timeout after the start of the command, seconds of wall time."""


@dataclass(frozen=True, slots=True)
class InitialPose:
    """Initial pose estimate for the stack's localiser, in the map frame."""

    topic: str = "initialpose"
    """Topic of type geometry_msgs/PoseWithCovarianceStamped; empty = none is published."""
    sigma_xy: float = 0.15
    """Standard deviation of the position stated in the message, metres."""
    sigma_yaw_deg: float = 8.0
    """Standard deviation of the heading stated in the message, degrees."""
    error_xy: float = 0.0
    """Standard deviation of the position error that is added, metres; errors are limited to two standard deviations."""
    error_yaw_deg: float = 0.0
    """Standard deviation of the heading error that is added, degrees; limited in the same way."""


@dataclass(frozen=True, slots=True)
class GoalInterface:
    """Interface on which the stack receives its goal, in the map frame."""

    kind: Literal["topic", "action", "service", "task"] = "topic"
    """``topic``: geometry_msgs/PoseStamped. ``action``, ``service``: a type whose goal or request has a field of PoseStamped.
    ``task``: as for tasks, on ``task/goal``."""
    name: str = "goal_pose"
    type: str = ""
    """Type of the action or service, such as ``nav2_msgs/action/NavigateToPose``."""
    field: str = "pose"
    """Field of the action's goal or of the service's request that holds the pose."""


@dataclass(frozen=True, slots=True)
class Status:
    """A topic of std_msgs/String on which the stack reports its status. The latest message that matches counts."""

    topic: str = ""
    """Name of the topic; empty = none: the true pose alone decides."""
    reached: str = "reached"
    """Regular expression that matches the text of a stack that reached its goal."""
    failed: str = "failed"
    """Regular expression that matches the text of a stack that gives up."""


@dataclass(frozen=True, slots=True)
class StackSpec:
    """The software under test."""

    command: tuple[str, ...]
    """Program and arguments, without a shell."""
    environment: dict[str, str] = field(default_factory=dict)
    """Environment variables in addition to those of this process and ``ROS_DOMAIN_ID``."""
    folder: Path = Path()
    """Working folder; relative paths in a scenario are relative to its file."""
    restart: Literal["each", "never"] = "each"
    """``each``: the stack is restarted for each run; ``never``: it keeps running, and the simulation is reset."""
    ready: Ready = Ready()
    initial_pose: InitialPose = InitialPose()
    goal: GoalInterface = GoalInterface()
    status: Status = Status()
    lockstep: tuple[str, ...] = ()
    """Lockstep rules such as ``cmd_vel every 0.05`` or ``cmd_vel after odom``, see docs/lockstep.md; none = runs in real time."""
    allowed_calls: tuple[str, ...] = ()
    """Services, actions and topics with which the stack may change the world or its time, such as ``set_entity_state``; others fail the run."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits at which an undecided run ends."""

    time: float = 120.0
    """Simulation time after the goal was sent, seconds."""
    wall_time: float = 600.0
    """Wall time of the whole run, seconds."""
    silence: float = 10.0
    """Wall time that a lockstep tick waits for the stack, seconds."""


@dataclass(frozen=True, slots=True)
class Region:
    """A polygon on the floor."""

    name: str
    """Name in the report."""
    corners: tuple[tuple[float, float], ...]
    """Corners in the map frame, metres."""


@dataclass(frozen=True, slots=True)
class Reached:
    """Required final pose of the robot."""

    within: float = 0.3
    """Largest distance from the goal, metres."""
    yaw_within_deg: float | None = None
    """Largest heading error, degrees; None = any heading."""


@dataclass(frozen=True, slots=True)
class RateLimit:
    """Minimum message rate on a topic while the robot has a goal, per second of simulation time."""

    topic: str
    """Name of the topic."""
    least: float
    """Minimum rate, 1/s."""


@dataclass(frozen=True, slots=True)
class Verdicts:
    """Criteria that a run must meet; None = not judged."""

    reached: Reached | None = Reached()
    collisions: int | None = 0
    """Largest number of collisions: contacts that begin, with anything but the floor."""
    clearance: float | None = None
    """Least distance between the robot's circle and obstacles of the map, metres."""
    stay_within: tuple[Region, ...] = ()
    """Regions; the robot's centre must always be inside at least one of them."""
    stay_out_of: tuple[Region, ...] = ()
    """Regions that the robot's centre must never enter."""
    path_ratio: float | None = None
    """Largest ratio of driven length to the length of the shortest path."""
    time: float | None = None
    """Largest time from the goal to the end, seconds."""
    max_acceleration: float | None = None
    """Largest root mean square of the rate of change of the commanded linear velocity, m/s^2."""
    rates: tuple[RateLimit, ...] = ()
    """Minimum message rates of topics."""
    alive: bool = True
    """Whether the stack's process must run until the end."""
    predicates: tuple[str, ...] = ()
    """Functions as ``module:function``, called with the bag's folder and the run; each returns whether the run passed, or the reason why not."""


@dataclass(frozen=True, slots=True)
class Recording:
    """Recorded and kept data of each run."""

    images: Literal["none", "compressed", "raw"] = "none"
    """Images of the robot's cameras in the bags. ``none``: nothing is rendered unless the stack subscribes."""
    keep: Literal["failed", "all"] = "failed"
    """Runs whose bags are kept."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario file."""

    name: str
    """Name of the file, without its suffix."""
    path: Path
    scenes: tuple[str, ...]
    """Names or files."""
    stack: StackSpec
    robots: tuple[str, ...] = ("gibson_bot",)
    """Names or files; each drives alone."""
    runs: int = 10
    """Number of runs in each scene with each robot."""
    seed: int = 0
    """Seed of all sampling; equal seeds give equal runs."""
    starts: tuple[str, ...] = (SAMPLED,)
    """``sampled``, or named poses and ``x,y,yaw_deg`` that the runs use in turn."""
    goals: tuple[str, ...] = (SAMPLED,)
    """Goals, given in the same way as starts."""
    sampling: Sampling = Sampling()
    obstacles: Obstacles = Obstacles()
    randomise: Randomisation = Randomisation()
    physics: dict[str, Any] = field(default_factory=dict)
    """Other settings of the physics node, see docs/parameters.md; ``rate`` applies to runs in real time."""
    limits: Limits = Limits()
    verdicts: Verdicts = Verdicts()
    record: Recording = Recording()
