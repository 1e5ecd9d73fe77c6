"""What a scenario file says, as values. Metres, radians and seconds of simulation time, except where a name tells another unit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Range = tuple[float, float]
"""Smallest and largest value of a uniform distribution."""
SAMPLED = "sampled"
"""Stands for poses that are drawn from the free poses of a scene."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How start and goal poses are drawn."""

    path_length: Range = (3.0, 30.0)
    """Length of the shortest path from start to goal for the robot, metres."""
    clearance: float = 0.3
    """Least distance of start and goal to the nearest obstacle, metres."""


@dataclass(frozen=True, slots=True)
class SpawnRule:
    """Things of one kind that stand in the way."""

    object: str
    """Name in the catalogue, or a file, as for ``gibson-sim spawn``."""
    count: int = 1
    """How many of them in each run."""
    at: str = "path"
    """``path`` = beside or on the shortest path, leaving a way round; ``sampled`` = anywhere free; or ``x,y,yaw_deg`` or a named pose."""


@dataclass(frozen=True, slots=True)
class PersonRule:
    """A person: a capsule that walks to and fro on a path, whatever is in its way."""

    path: tuple[tuple[float, float], ...] = ()
    """Points in the map frame, metres; empty = two free points on both sides of the robot's shortest path."""
    speed: float = 0.8
    """m/s."""
    radius: float = 0.25
    """Metres."""
    height: float = 1.75
    """Metres."""


@dataclass(frozen=True, slots=True)
class Obstacles:
    """What stands or walks in the way."""

    spawn: tuple[SpawnRule, ...] = ()
    """Things that are spawned before the run begins."""
    closed_doors: tuple[str, ...] = ()
    """Names of bodies with a door, or ``all``."""
    people: tuple[PersonRule, ...] = ()
    """People who walk about."""


@dataclass(frozen=True, slots=True)
class Randomisation:
    """What differs from run to run. None = as it is."""

    looks: str = ""
    """Rules of lights, colours and textures: a file, or a name under ``config/randomisation``; empty = none."""
    slip: Range | None = None
    """Of the drive: fraction of the commanded motion that is lost."""
    noise: Range | None = None
    """Factor of the noise of all sensors and of the odometry."""
    latency: Range | None = None
    """Delay of velocity commands, seconds."""
    friction: Range | None = None
    """Factor of the friction of the floor."""
    payload: Range | None = None
    """Mass on the robot's base, kg."""


@dataclass(frozen=True, slots=True)
class Ready:
    """What tells that the stack can be given a goal. All that is given must hold."""

    topic: str = ""
    """A message was published on it."""
    service: str = ""
    """It is there."""
    node: str = ""
    """A lifecycle node that is active."""
    within: float = 60.0
    """Seconds of wall time after the start of the command."""


@dataclass(frozen=True, slots=True)
class InitialPose:
    """The first estimate of the pose for the stack's localiser, in the map frame."""

    topic: str = "initialpose"
    """geometry_msgs/PoseWithCovarianceStamped; empty = none is given."""
    sigma_xy: float = 0.15
    """Standard deviation that the message states, metres."""
    sigma_yaw_deg: float = 8.0
    """The same of the heading, degrees."""
    error_xy: float = 0.0
    """Standard deviation of the error that is added, metres, at most two of them."""
    error_yaw_deg: float = 0.0
    """The same of the heading, degrees."""


@dataclass(frozen=True, slots=True)
class GoalInterface:
    """How the stack is given its goal, in the map frame."""

    kind: Literal["topic", "action", "service", "task"] = "topic"
    """``topic``: geometry_msgs/PoseStamped. ``action``, ``service``: a type whose goal or request has a field of PoseStamped.
    ``task``: as for tasks, on ``task/goal``."""
    name: str = "goal_pose"
    type: str = ""
    """Of the action or service, such as ``nav2_msgs/action/NavigateToPose``."""
    field: str = "pose"
    """Of the action's goal or the service's request."""


@dataclass(frozen=True, slots=True)
class Status:
    """A topic of std_msgs/String on which the stack tells how it fares. The latest message that matches counts."""

    topic: str = ""
    """Empty = none; then the true pose alone decides."""
    reached: str = "reached"
    """Regular expression, searched for in the text."""
    failed: str = "failed"
    """The same for a stack that gives up."""


@dataclass(frozen=True, slots=True)
class StackSpec:
    """The software under test."""

    command: tuple[str, ...]
    """Program and arguments, without a shell."""
    environment: dict[str, str] = field(default_factory=dict)
    """Variables besides those of this process and ``ROS_DOMAIN_ID``."""
    folder: Path = Path()
    """Working folder; relative paths in a scenario are those from its file."""
    restart: Literal["each", "never"] = "each"
    """Whether the stack starts anew for each run, or is kept, and the simulation is reset."""
    ready: Ready = Ready()
    initial_pose: InitialPose = InitialPose()
    goal: GoalInterface = GoalInterface()
    status: Status = Status()
    lockstep: tuple[str, ...] = ()
    """Rules such as ``cmd_vel every 0.05`` or ``cmd_vel after odom``, see docs/lockstep.md; none = the run is in real time."""


@dataclass(frozen=True, slots=True)
class Limits:
    """When a run ends although nothing was decided."""

    time: float = 120.0
    """Seconds of simulation time after the goal was given."""
    wall_time: float = 600.0
    """Seconds, of the whole run."""
    silence: float = 10.0
    """Seconds of wall time that a tick of lockstep waits for the stack."""


@dataclass(frozen=True, slots=True)
class Region:
    """A polygon on the floor."""

    name: str
    """For the report."""
    corners: tuple[tuple[float, float], ...]
    """Map frame, metres."""


@dataclass(frozen=True, slots=True)
class Reached:
    """Where the robot must stand at the end."""

    within: float = 0.3
    """Metres."""
    yaw_within_deg: float | None = None
    """Degrees; None = any heading."""


@dataclass(frozen=True, slots=True)
class RateLimit:
    """Messages a second of simulation time on a topic, while the robot has a goal."""

    topic: str
    """Name of the topic."""
    least: float
    """1/s."""


@dataclass(frozen=True, slots=True)
class Verdicts:
    """What a run must fulfil; None = is not judged."""

    reached: Reached | None = Reached()
    collisions: int | None = 0
    """How often the robot may begin to touch something other than the floor."""
    clearance: float | None = None
    """Least distance between the robot's circle and obstacles of the map, metres."""
    stay_within: tuple[Region, ...] = ()
    """Regions in one of which the centre of the robot must always be."""
    stay_out_of: tuple[Region, ...] = ()
    """Regions in which it must never be."""
    path_ratio: float | None = None
    """Length driven over the length of the shortest path."""
    time: float | None = None
    """Seconds from the goal to the end."""
    max_acceleration: float | None = None
    """Root mean square of the change of the commanded linear velocity, m/s^2."""
    rates: tuple[RateLimit, ...] = ()
    """Least rates of topics."""
    alive: bool = True
    """The stack's process must run until the end."""
    predicates: tuple[str, ...] = ()
    """``module:function`` each, called with the folder of the bag and the run; returns whether it passed, or a text that says why not."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What is kept of each run."""

    images: Literal["none", "compressed", "raw"] = "none"
    """Images of the robot's cameras in the bags. ``none``: nothing is rendered unless the stack subscribes."""
    keep: Literal["failed", "all"] = "failed"
    """Bags that are kept."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole trial."""

    name: str
    """Of the file, without its suffix."""
    path: Path
    scenes: tuple[str, ...]
    """Names or files."""
    stack: StackSpec
    robots: tuple[str, ...] = ("gibson_bot",)
    """Names or files; each drives alone."""
    runs: int = 10
    """In each scene with each robot."""
    seed: int = 0
    """Of all that is drawn; equal seeds give equal runs."""
    starts: tuple[str, ...] = (SAMPLED,)
    """``sampled``, or named poses and ``x,y,yaw_deg`` that the runs take in turn."""
    goals: tuple[str, ...] = (SAMPLED,)
    """The same for goals."""
    sampling: Sampling = Sampling()
    obstacles: Obstacles = Obstacles()
    randomise: Randomisation = Randomisation()
    physics: dict[str, Any] = field(default_factory=dict)
    """Other settings of the physics node, see docs/parameters.md; ``rate`` counts where a run is in real time."""
    limits: Limits = Limits()
    verdicts: Verdicts = Verdicts()
    record: Recording = Recording()
