"""Settings of the nodes that are clients of a simulation, as in ``config``, and a table of the settings of all nodes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from gibson_sim.config import VIEWS, PhysicsConfig, RenderConfig, outputs_of, size_of
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import check_settings, setting
from gibson_sim.types import OUTPUTS, Output

DRIVES = ("tour", "forward", "square", "spin", "keyboard")
"""Names of built-in drives; any other drive is a file."""
TASK_NAMES = ("point-goal", "push-through", "object-search", "open-door", "open-cabinet-and-fetch", "pick-and-place")
"""Names of all tasks, as in ``tasks.registry``, which takes a second to import."""
TIMEOUT = "Give up if no simulation appears within this wall time; 0 = wait forever"
_TOPIC = re.compile(r"[~/]?/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


@dataclass(frozen=True, slots=True)
class DriveConfig:
    """Settings of the drive node: a client that drives the robot through standard topics."""

    drive: str = setting(
        "tour", "tour, forward, square, spin, keyboard, or a file with lines `linear angular seconds`", names="drive"
    )
    scene: str = setting("", "Scene to plan the tour in; empty = that of the running simulation; only for tour", names="scene")
    robot: str = setting(
        "",
        "Robot whose size sets the clearance of the tour; empty = the one that the simulation was started with; only for tour",
        names="robots",
    )
    length: float = setting(
        0.0, "Length of the drive; 0 = 30 m for a tour, 2 m for forward", unit="m", minimum=0.0, maximum=10_000.0
    )
    linear: float = setting(0.4, "Largest forward speed", unit="m/s", minimum=0.01, maximum=10.0)
    angular: float = setting(1.2, "Largest yaw rate", unit="rad/s", minimum=0.01, maximum=20.0)
    stamped: bool = setting(False, "Send TwistStamped instead of Twist")
    subscribers: int = setting(
        1, "Number of subscribers of the commands to wait for: the simulation, a recorder (10 s at most)", minimum=0, maximum=100
    )
    timeout: float = setting(0.0, TIMEOUT, unit="s", minimum=0.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Settings of the record node."""

    output: str = setting("", "Folder of the bag; it may exist if it is empty")
    topics: str = setting("", "Topics to record, separated by commas; empty = all")
    record_images: str = setting(
        "raw",
        "Form of recorded images: raw; compressed = JPEG for colours, PNG for labels, compressedDepth for depth; none = only those that "
        "`topics` names",
        choices=("raw", "compressed", "none"),
    )
    storage: str = setting("mcap", "Format of the bag's files", choices=("mcap", "sqlite3"))
    compression: str = setting("none", "Compression of the bag's chunks; none with sqlite3", choices=("none", "zstd", "lz4"))
    max_bag_size: int = setting(0, "Size after which the bag is split into another file; 0 = never", unit="bytes", minimum=0)
    max_bag_duration: float = setting(
        0.0, "Simulation time after which the bag is split into another file; 0 = never", unit="s", minimum=0.0
    )
    flush_period: float = setting(
        1.0,
        "Interval between flushes to the operating system, wall time: the most that a killed recorder loses",
        unit="s",
        minimum=0.05,
        maximum=60.0,
    )
    snapshot_seconds: float = setting(
        0.0,
        "Keep only the last seconds (simulation time) in memory, which ~/snapshot writes; 0 = write everything",
        unit="s",
        minimum=0.0,
    )
    snapshot_mb: int = setting(
        1000, "Memory for `snapshot_seconds`; the oldest messages are dropped when it is full", unit="MB", minimum=1
    )
    reserve_mb: int = setting(256, "Free space of the disk below which recording stops with an intact bag", unit="MB", minimum=1)
    duration: float = setting(0.0, "End after this much simulation time; 0 = never", unit="s", minimum=0.0)
    timeout: float = setting(0.0, TIMEOUT, unit="s", minimum=0.0)
    summary_path: str = setting("", "File for a JSON summary of the run; empty = none")

    def __post_init__(self) -> None:
        check_settings(self)
        for topic in self.wanted_topics():
            if not _TOPIC.fullmatch(topic):
                raise ConfigError(
                    f"setting 'topics' has {quoted(topic)}, which is not a topic name: use letters, digits, _ and /, no digit after a /"
                )
        if self.storage == "sqlite3" and self.compression != "none":
            raise ConfigError(f"setting 'compression' is {self.compression!r}, must be 'none' where 'storage' is 'sqlite3'")

    def wanted_topics(self) -> tuple[str, ...]:
        """Returns the names in ``topics``; empty = all."""
        return tuple(part.strip() for part in self.topics.split(",") if part.strip())


@dataclass(frozen=True, slots=True)
class SnapshotConfig:
    """Settings of the snapshot node."""

    output: str = setting(".", "Folder for the PNG files")
    timeout: float = setting(30.0, "Give up when a camera sends nothing for this wall time", unit="s", minimum=0.1)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class RenderBagConfig:
    """Settings of ``gibson-sim render``, which renders a recorded run."""

    bag: str = setting("", "Folder of the recorded bag")
    output: str = setting("", "Folder of the new bag; it may exist if it is empty")
    cameras: str = setting(
        "",
        "Cameras to render: a YAML file with a section `cameras` as in robot.yaml, their links `<body>/<link>`, or views; empty = the bag's own",
    )
    views: str = setting("", VIEWS + "; rendered in addition to the other cameras", names="views")
    view_size: str = setting("640x480", "Default width and height of views", unit="px")
    view_rate: float = setting(30.0, "Images per second of views", unit="Hz", minimum=0.001, maximum=1000.0)
    outputs: str = setting(
        "", f"Outputs of every camera, separated by commas: {', '.join(OUTPUTS)}; empty = those of the cameras"
    )
    rate: float = setting(
        0.0,
        "Images per second of every camera; 0 = the rates of the cameras. At most one per recorded state, unless `interpolate`",
        unit="Hz",
        minimum=0.0,
        maximum=1000.0,
    )
    interpolate: bool = setting(False, "Render exactly at the times of the rates, interpolating between recorded states")
    lights: str = setting(
        "", "Different light: a YAML file with a section `light` as in scene.yaml; empty = the bag's", names="file"
    )
    randomise: str = setting(
        "",
        "Rules that change lights, colours, textures and materials: a file, or a name under config/randomisation; empty = none",
        names="rules",
    )
    randomise_seed: int = setting(0, "Seed of the rules; equal seeds give equal pixels", minimum=0)
    begin: float = setting(0.0, "Start of the rendered part, after the start of the bag", unit="s", minimum=0.0)
    end: float = setting(0.0, "End of the rendered part, after the start of the bag; 0 = its end", unit="s", minimum=0.0)
    copy: str = setting(
        "auto",
        "Topics to copy from the bag, separated by commas; auto = all but images and topics derived from them, none = none",
    )
    compression: str = setting("none", "Compression of the bag's chunks", choices=("none", "zstd", "lz4"))
    reserve_mb: int = setting(256, "Free space of the disk below which rendering stops with an intact bag", unit="MB", minimum=1)
    tracer: str = setting("", "Program that traces the colours: cycles (Blender); empty = our renderer draws them")
    samples: int = setting(64, "Paths per pixel of traced colours; only with `tracer`", minimum=2, maximum=65_536)
    blender_python: str = setting("", "Python interpreter that has bpy; empty = this one; only with `tracer`")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.tracer and (self.lights or self.randomise):
            raise ConfigError("settings 'lights' and 'randomise' do not change traced colours; leave them out, or 'tracer'")
        self.wanted_outputs()
        self.wanted_view_size()
        if self.end and self.end <= self.begin:
            raise ConfigError(f"setting 'end' is {self.end:g} s, must be after 'begin', {self.begin:g} s, or 0")

    def wanted_outputs(self) -> tuple[Output, ...]:
        """Returns the outputs in ``outputs``."""
        return outputs_of("outputs", self.outputs)

    def wanted_view_size(self) -> tuple[int, int]:
        """Returns the width and the height in ``view_size``, pixels."""
        return size_of("view_size", self.view_size)


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """Settings of the replay node, which sends the inputs of a recorded run to a simulation."""

    bag: str = setting("", "Folder of the recorded bag")
    lockstep: bool = setting(False, "Send every input before its step; the simulation must be in lockstep")
    verify: bool = setting(False, "Compare the digests of every tick with those of the bag")
    images: bool = setting(True, "Subscribe to the images whose digests the bag has, so that they are rendered; only for verify")
    step_hz: int = setting(240, "Physics steps per second of the simulation", unit="Hz", minimum=60, maximum=10_000)
    publish_hz: int = setting(60, "Ticks per second of the simulation", unit="Hz", minimum=1, maximum=1000)
    summary_path: str = setting("", "File for a JSON summary of the replay; empty = none")
    timeout: float = setting(60.0, TIMEOUT, unit="s", minimum=0.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class TaskConfig:
    """Settings of the task node, which sets up and evaluates episodes of a task in a running simulation."""

    task: str = setting("point-goal", "Name of the task; `gibson-sim task --list` describes all", choices=TASK_NAMES)
    seed: int = setting(0, "Seed of the first episode; equal seeds give equal episodes", minimum=0)
    episodes: int = setting(1, "Number of episodes, with consecutive seeds", minimum=1, maximum=1_000_000)
    baseline: str = setting(
        "none",
        "Policy that drives the robot; none = another node drives; careful exists only for push-through",
        choices=("scripted", "random", "none", "careful"),
    )
    scene: str = setting("", "Scene that the simulation was started with; empty = that of the task", names="scene")
    robot: str = setting("", "Robot that the simulation was started with; empty = that of the task", names="robots")
    output: str = setting("", "File for all results as JSON; empty = none")
    timeout: float = setting(60.0, TIMEOUT, unit="s", minimum=0.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class TrialConfig:
    """Settings of the trial node, which sends the goal to the stack of a run, and ends the run; ``gibson-sim trial`` starts it."""

    input: str = setting("", "File with the run, the interface of its stack and its limits, written by `gibson-sim trial`")
    output: str = setting("", "File for a report of the run as JSON")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class WebConfig:
    """Settings of the web node, which serves the live page."""

    host: str = setting("127.0.0.1", "Address to serve the page on; any but 127.0.0.1 lets other machines in, with a token")
    port: int = setting(8080, "TCP port of the page; 0 = any that is free", minimum=0, maximum=65535)
    token: str = setting("", "Access token for pages on other machines; empty = generated at the start and printed")
    folder: str = setting(
        "out/web", "Folder of the page's recordings; the page lists what is below it: bags with their plots, reports of trials"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.token and not re.fullmatch(r"[A-Za-z0-9_-]{8,128}", self.token):
            raise ConfigError("setting 'token' must have 8 to 128 letters, digits, - and _")


@dataclass(frozen=True, slots=True)
class FoxgloveConfig:
    """Settings of the foxglove node, which serves topics, services and parameters by the Foxglove WebSocket protocol."""

    host: str = setting(
        "127.0.0.1", "Address to serve on; any but 127.0.0.1 lets other machines in, without a password: the protocol has none"
    )
    port: int = setting(8765, "TCP port; 0 = any that is free", minimum=0, maximum=65535)
    commands: bool = setting(True, "Clients may publish, call services and set parameters; otherwise they are read-only")

    def __post_init__(self) -> None:
        check_settings(self)


NODE_CONFIGS: dict[str, type[Any]] = {
    "physics": PhysicsConfig,
    "render": RenderConfig,
    "drive": DriveConfig,
    "record": RecordConfig,
    "snapshot": SnapshotConfig,
    "replay": ReplayConfig,
    "task": TaskConfig,
    "web": WebConfig,
    "foxglove": FoxgloveConfig,
}
"""Node name -> its settings."""
