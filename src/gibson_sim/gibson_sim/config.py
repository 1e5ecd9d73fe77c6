"""Settings of the physics and the render node, with units, limits and descriptions; ``client_config`` has those of the other nodes.

ROS parameters (``ros/nodes/params.py``), command-line options (``cli``) and Python fill the same dataclasses, and ``gibson-sim params
--markdown`` prints them as tables. The error message for an invalid value is the same for all three.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import exists
from gibson_sim.settings import check_settings, make_settings, nearest, setting
from gibson_sim.types import FILLS, OUTPUTS, Output

DETAIL_PX = 1.0
"""Default of the maximum screen-space error of levels of detail, pixels."""
VIEWS = (
    "Cameras that are not mounted on a robot, separated by commas: follow, orbit or top, also with a target (`follow:left`), "
    "or a YAML file of them; see docs/images.md"
)
DEFAULT_SCENE = "linden_flat"


_FILL_SETTING = f"none, {', '.join(FILLS)} or the path of an ONNX file (.onnx), with ,depth to fill depth, too"


def parse_fill(what: str, value: str | os.PathLike[str], folder: Path = Path()) -> tuple[str, bool]:
    """Returns the method to fill holes in a setting, a file as absolute path, empty = none; and whether depth is filled too.

    Args:
        what: name of the setting in messages.
        value: a method of ``FILLS`` or the path of an ONNX file, also with ``,depth``; or ``none``, or empty.
        folder: folder to which the path of a file is relative; the default is the working directory.

    Raises:
        ConfigError: the value is something else, or the file does not exist.
    """
    if not isinstance(value, (str, os.PathLike)):
        raise ConfigError(f"{what} is {quoted(value)}, must be {_FILL_SETTING}")
    text = os.fspath(value).strip()
    before, _, last = text.rpartition(",")
    fill, with_depth = (before.strip(), True) if last.strip() == "depth" and "," in text else (text, False)
    if fill in ("", "none") and not with_depth:
        return "", False
    if fill in FILLS:
        return fill, with_depth
    if not fill.endswith(".onnx"):
        hint = f"; {hint}" if (hint := nearest(fill, (*FILLS, "none"))) else ""
        raise ConfigError(f"{what} is {quoted(text)}, must be {_FILL_SETTING}{hint}")
    path = (folder / Path(fill).expanduser()).absolute()
    if not exists(path):
        raise ConfigError(f"{what}: there is no file '{clipped(str(path), 200)}'; give an ONNX file, or {', '.join(FILLS)}")
    return str(path), with_depth


def absolute_name(name: str) -> str:
    """Returns the name of a topic or a node with its leading slash, which users may leave out."""
    return name if name.startswith("/") else f"/{name}"


_SUBSCRIBERS = re.compile(r"(/?[A-Za-z_]\w*(?:/[A-Za-z_]\w*)*)(?::([1-9]\d{0,5}))?", re.ASCII)


def parse_subscribers(what: str, entries: Iterable[str]) -> dict[str, int]:
    """Returns topic -> required number of subscribers.

    Args:
        what: name of the setting in messages.
        entries: each ``TOPIC:N``, or ``TOPIC`` for one subscriber.

    Raises:
        ConfigError: an entry is something else.
    """
    required = {}
    for entry in entries:
        match = _SUBSCRIBERS.fullmatch(entry)
        if match is None:
            raise ConfigError(f"{what} has {quoted(entry)}, must be TOPIC or TOPIC:N, such as /camera/image_raw:1")
        required[match[1]] = int(match[2] or 1)
    return required


def robots_of(text: str) -> tuple[tuple[str, str], ...]:
    """Returns the robots in a setting: (name, robot) of each, where a robot is an argument of ``load_robot``; a single one has no name.

    Raises:
        ConfigError: the text is empty, or names of several robots are missing or equal.
    """
    if not text.strip():
        raise ConfigError("robot is empty: name one, such as gibson_bot, or give its file")
    if "=" not in text:
        return (("", text),)
    robots: dict[str, str] = {}
    for entry in text.split(","):
        name, _, robot = (word.strip() for word in entry.partition("="))
        if not (name and robot):
            raise ConfigError(
                f"robot {quoted(entry.strip())} must be name=robot where there are several, e.g. left=gibson_bot,right=gibson_bot"
            )
        if name in robots:
            raise ConfigError(f"two robots are named {quoted(name)}; names must be unique")
        robots[name] = robot
    return tuple(robots.items())


def outputs_of(name: str, text: str) -> tuple[Output, ...]:
    """Returns the outputs in a setting, in the order of ``OUTPUTS``."""
    names = [part.strip() for part in text.split(",") if part.strip()]
    unknown = [part for part in names if part not in OUTPUTS]
    if unknown:
        hint = nearest(unknown[0], OUTPUTS)
        raise ConfigError(
            f"setting {quoted(name)} has {', '.join(unknown)}; must be of {', '.join(OUTPUTS)}{f'; {hint}' if hint else ''}"
        )
    return tuple(output for output in OUTPUTS if output in names)


def size_of(name: str, text: str) -> tuple[int, int]:
    """Returns (width, height) in a setting, pixels."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 1 <= int(width) <= 16384 and 1 <= int(height) <= 16384):
        raise ConfigError(f"setting {quoted(name)} is {quoted(text)}, must be WIDTHxHEIGHT, each 1 to 16384 pixels, e.g. 640x480")
    return int(width), int(height)


def _pairs(name: str, text: str, example: str) -> tuple[tuple[str, str], ...]:
    """Returns the (left, right) pairs of the ``left=right`` items in a setting."""
    pairs: list[tuple[str, str]] = []
    for part in (part.strip() for part in text.split(",")):
        left, equals, right = (word.strip() for word in part.partition("="))
        if part and (not (left and equals and right) or "=" in right):
            raise ConfigError(f"setting {quoted(name)} has {quoted(part)}, must be pairs separated by commas, e.g. {example}")
        if any(left == other for other, _ in pairs):
            raise ConfigError(f"setting {quoted(name)} has {quoted(left)} twice; it may be left of one equals sign only")
        if part:
            pairs.append((left, right))
    return tuple(pairs)


@dataclass(frozen=True)
class WorldSettings:
    """What is simulated: the scene, its robots, and what varies with a seed."""

    scene: str = setting(
        DEFAULT_SCENE,
        "Scene: a name, a folder with scene.yaml, a world file (SDF, Drake directives) or a mesh file",
        names="scene",
    )
    robot: str = setting(
        "gibson_bot",
        "Robot: a name, a folder with robot.yaml, that file, or a URDF or xacro; several, each in a namespace: `left=gibson_bot,right=gibson_bot`",
        names="robots",
    )
    start: str = setting(
        "",
        "Name of a start pose, or x,y,yaw_deg; for several robots in their order, separated by `;`; "
        "empty = the scene's first start pose, or its most open place",
    )
    robot_tf: str = setting(
        "namespaced",
        "For several robots: a `<robot>/tf` for each with the frames of a single robot, or one `/tf` with frames `<robot>/base_link`",
        choices=("namespaced", "prefixed"),
    )
    seed: int = setting(0, "Seed of the noise of all sensors; equal seeds and commands give equal measurements", minimum=0)
    sdf_lamps: bool = setting(
        False,
        "Render the point and spot lights of an SDF world, which cast no shadows and cost time each; off = ambient light instead",
    )
    randomise: str = setting(
        "",
        "Rules that change lights, colours, textures and materials: a file, or a name under config/randomisation; empty = none",
        names="rules",
    )
    randomise_seed: int = setting(0, "Seed of the rules; equal seeds give equal pixels", minimum=0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class TimeSettings:
    """How simulation time passes."""

    step_hz: int = setting(240, "Physics steps per second of simulation time", unit="Hz", minimum=60, maximum=10_000)
    clock_hz: int = setting(
        100,
        "Rate of /clock in simulation time; it is also published with every other message",
        unit="Hz",
        minimum=1,
        maximum=1000,
    )
    publish_hz: int = setting(
        60, "Rate of tf, odometry, joint states and scene state; must divide step_hz", unit="Hz", minimum=1, maximum=1000
    )
    rate: float = setting(
        1.0,
        "Speed of simulation time against wall time; 0 = as fast as possible. May be changed while it runs",
        minimum=0.0,
        maximum=1000.0,
    )
    start_paused: bool = setting(False, "Start paused; a client sets the simulation to playing")
    reset_time: str = setting(
        "rewind",
        "What /clock does at a reset of time: restart at 0, or continue, for nodes that cannot handle a jump back",
        choices=("rewind", "monotonic"),
    )
    duration: float = setting(0.0, "End after this much simulation time; 0 = never", unit="s", minimum=0.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.step_hz % self.publish_hz:
            raise ConfigError(f"setting 'publish_hz' is {self.publish_hz} Hz, must divide 'step_hz', which is {self.step_hz} Hz")
        if self.clock_hz > self.step_hz:
            raise ConfigError(f"setting 'clock_hz' is {self.clock_hz} Hz, must be at most 'step_hz', {self.step_hz} Hz")

    @property
    def steps_per_tick(self) -> int:
        """Number of physics steps between two ticks, at which states are published."""
        return self.step_hz // self.publish_hz


@dataclass(frozen=True)
class SyncSettings:
    """What simulation time waits for: participants of lockstep, images, subscribers."""

    lockstep: bool = setting(
        False,
        "Begin a tick only when every participant, renderers and nodes that join, has finished the last one; see docs/lockstep.md",
    )
    pipelined: bool = setting(
        False,
        "In lockstep, compute the next tick while the participants process the current one, if cores are free; a command takes effect one tick later",
    )
    participants: str = setting(
        "",
        "Nodes that must join lockstep before time starts, separated by `;`: names of nodes that report their own "
        "progress, as `render`; or rules for other nodes, as `localise=pose after scan` or `nav=cmd_vel every 0.05 from goal_pose`",
        names="participants",
    )
    participant_timeout: float = setting(
        30.0, "Timeout of a participant in a tick of lockstep, wall time", unit="s", minimum=0.01, maximum=86_400.0
    )
    on_timeout: str = setting(
        "stop", "Action after that timeout: end the run, or continue without the participant's answer", choices=("stop", "go_on")
    )
    image_timeout: float = setting(
        5.0,
        "With rate 0 and without lockstep, time waits for images that have subscribers; timeout of a tick, seconds of wall time. "
        "0 = time does not wait, and images are skipped",
        unit="s",
        minimum=0.0,
        maximum=86_400.0,
    )
    wait_for: str = setting(
        "",
        "Delay the first tick until topics have this many subscribers, e.g. `scene_state:1,cameras:1,robots:1`, and each robot this many "
        "publishers of its cmd_vel, `commands:1`; `page:1` waits until the page of the same run is served (120 s at most)",
    )

    def __post_init__(self) -> None:
        check_settings(self)
        for name in ("participants", "pipelined"):
            if getattr(self, name) and not self.lockstep:
                raise ConfigError(f"setting {quoted(name)} is given without 'lockstep'; set that too, or leave this out")
        self.required_subscribers  # noqa: B018  # an invalid value is an error at once

    @cached_property
    def required_subscribers(self) -> Mapping[str, int]:
        """Topic of ``wait_for`` -> required number of subscribers."""
        return parse_subscribers("setting 'wait_for'", filter(None, self.wait_for.split(",")))


@dataclass(frozen=True)
class CommandSettings:
    """How robots are commanded: velocities, tools, grippers."""

    cmd_vel_timeout: float = setting(
        0.5, "A velocity command older than this (simulation time) stops the robot", unit="s", minimum=0.01, maximum=60.0
    )
    cmd_vel_type: str = setting(
        "both",
        "Type of `cmd_vel`: Twist, TwistStamped, or both, which `ros2 topic echo` and `ros2 bag record` refuse: "
        "use `cmd_vel_applied` there; see docs/ros_interfaces.md",
        choices=("both", "twist", "stamped"),
    )
    servo_timeout: float = setting(
        0.25, "A tool velocity command older than this (simulation time) stops the arm", unit="s", minimum=0.01, maximum=60.0
    )
    servo_max_linear: float = setting(0.5, "Largest linear speed of a tool", unit="m/s", minimum=0.001, maximum=100.0)
    servo_max_angular: float = setting(1.5, "Largest angular speed of a tool", unit="rad/s", minimum=0.001, maximum=100.0)
    grasp_mode: str = setting(
        "assisted",
        "How grippers hold objects: by friction, by a ball joint to an object in reach, or rigidly to one they touch; see docs/manipulation.md",
        choices=("physical", "assisted", "sticky"),
    )
    grasp_distance: float = setting(
        0.2,
        "assisted: largest distance between tool and surface at which a gripper grasps",
        unit="m",
        minimum=0.001,
        maximum=10.0,
    )
    grasp_force: float = setting(
        500.0, "Largest force of the joint between a gripper and the held object", unit="N", minimum=0.001, maximum=1e6
    )
    grasp_release_force: float = setting(
        0.0, "Force above which a gripper releases the object; 0 = never", unit="N", minimum=0.0, maximum=1e6
    )
    grasp_release_angle_deg: float = setting(
        90.0, "Opening angle above which a gripper releases a door; 0 = never", unit="deg", minimum=0.0, maximum=360.0
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class CameraSettings:
    """Cameras of the robots, and views."""

    camera_rate: float = setting(
        0.0, "Images per second of every camera; 0 = as in the robot's file", unit="Hz", minimum=0.0, maximum=1000.0
    )
    camera_outputs: str = setting(
        "", f"Outputs of every camera, separated by commas: {', '.join(OUTPUTS)}; empty = as in the robot's file"
    )
    camera_fill: str = setting(
        "",
        "Fill holes in the images of every camera: push_pull, learned, an ONNX file, or none; with ,depth also in depth; empty = as in the "
        "robot's file; see docs/filler.md",
    )
    views: str = setting("", VIEWS + "; on topics `view_follow/image_raw` and so on", names="views")
    view_size: str = setting("640x480", "Default width and height of views", unit="px")
    view_rate: float = setting(30.0, "Images per second of views", unit="Hz", minimum=0.001, maximum=1000.0)

    def __post_init__(self) -> None:
        check_settings(self)
        self.outputs, self.fill, self.size_of_views  # noqa: B018  # an invalid value is an error at once

    @cached_property
    def outputs(self) -> tuple[Output, ...]:
        """Outputs in ``camera_outputs``."""
        return outputs_of("camera_outputs", self.camera_outputs)

    @cached_property
    def fill(self) -> tuple[str, bool]:
        """Fill method in ``camera_fill``, a file as absolute path, empty = none; and whether depth is filled too."""
        return parse_fill("setting 'camera_fill'", self.camera_fill)

    @cached_property
    def size_of_views(self) -> tuple[int, int]:
        """Width and height in ``view_size``, pixels."""
        return size_of("view_size", self.view_size)


@dataclass(frozen=True)
class TopicSettings:
    """What else is published, and under which names."""

    map: str = setting(
        "auto",
        "Publish the occupancy grid of the floor on `map`: auto = until another node publishes one (SLAM, a map server)",
        choices=("auto", "on", "off"),
    )
    map_resolution: float = setting(0.05, "Cell size of the map", unit="m", minimum=0.005, maximum=1.0)
    publish_map_tf: bool = setting(
        False, "Publish map -> odom from ground truth, as a perfect localiser does. Leave it off with AMCL or SLAM"
    )
    contacts_rate: float = setting(
        30.0,
        "Messages per second on `contacts` while it has subscribers; at most publish_hz",
        unit="Hz",
        minimum=0.001,
        maximum=1000.0,
    )
    service_prefix: str = setting(
        "", "Prefix of the services of simulation_interfaces, e.g. `sim/` or `/gzserver/`; empty = none"
    )
    digests: bool = setting(False, "Publish a hash of the data of each tick on `tick_digest`, to compare runs")
    summary_path: str = setting("", "File for a JSON summary of the run; empty = none")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class PhysicsConfig:
    """Settings of the physics node, by concept. Their names are those of its parameters, without the part: see ``make_settings``."""

    world: WorldSettings = WorldSettings()
    time: TimeSettings = TimeSettings()
    sync: SyncSettings = SyncSettings()
    commands: CommandSettings = CommandSettings()
    cameras: CameraSettings = CameraSettings()
    topics: TopicSettings = TopicSettings()

    def __post_init__(self) -> None:
        if self.cameras.camera_rate > self.time.publish_hz:
            raise ConfigError(
                f"setting 'camera_rate' is {self.cameras.camera_rate:g} Hz, must be at most 'publish_hz', {self.time.publish_hz} Hz"
            )

    @classmethod
    def of(cls, **values: Any) -> PhysicsConfig:
        """Returns the settings with these values, by the names of the parameters.

        Raises:
            ConfigError: a value is not allowed.
        """
        return make_settings(cls, values)


@dataclass(frozen=True)
class RenderConfig:
    """Settings of the render node."""

    egl_device: int = setting(
        -1, "EGL device, as listed by `gibson-sim doctor`; -1 = a GPU if there is one, else software", minimum=-1, maximum=255
    )
    egl_uuid: str = setting(
        "", "UUID of the rendering GPU, as `gibson-sim doctor` shows it, or its beginning; empty = by `egl_device`"
    )
    egl_library: str = setting("libEGL.so.1", "EGL library: a file name for the dynamic linker, or a path")
    cameras: str = setting("", "Names of the cameras to render, separated by commas; empty = all cameras of the scene")
    detail_px: float = setting(
        DETAIL_PX,
        "Largest error of levels of detail in the image, in scenes with 50,000 triangles or more; 0 = draw every triangle",
        unit="px",
        minimum=0.0,
        maximum=16.0,
    )
    compress_textures: bool = setting(False, "Compress textures (S3TC): an eighth of the memory, slightly less exact")
    cache: str = setting("", "Folder of the cache of loaded scenes; empty = ~/.cache/gibson-sim/scenes, none = no cache")
    register_depth: str = setting(
        "",
        "Depth cameras whose depth is also published registered to a colour camera of the same robot, "
        "e.g. `depth_camera=color`; separated by commas",
    )
    compressed_format: str = setting("jpeg", "Format of <camera>/image_raw/compressed", choices=("jpeg", "png"))
    jpeg_quality: int = setting(95, "Quality of JPEG images", minimum=1, maximum=100)
    png_level: int = setting(3, "Compression level of PNG images: 0 = fast, 9 = small", minimum=0, maximum=9)
    compressed_depth_max: float = setting(
        10.0, "Largest depth of compressedDepth images; farther pixels have no value", unit="m", minimum=0.1, maximum=1000.0
    )
    compressed_depth_quantization: float = setting(
        100.0,
        "Resolution of compressedDepth: a step at d metres is about d^2 / quantization^2 metres",
        minimum=1.0,
        maximum=1000.0,
    )
    asset_roots: str = setting(
        "",
        "Folders of the physics machine and the same folders on this one: `from=to` pairs, separated by commas; "
        "empty = scenes, robots and objects are searched by name",
    )
    digests: bool = setting(False, "Publish a hash of each image on `tick_digest`, to compare runs")
    summary_path: str = setting("", "File for a JSON summary of the run; empty = none")

    def __post_init__(self) -> None:
        check_settings(self)
        self.registrations, self.asset_folders  # noqa: B018  # an invalid value is an error at once

    @cached_property
    def camera_names(self) -> tuple[str, ...]:
        """Names in ``cameras``; empty = all."""
        return tuple(part.strip() for part in self.cameras.split(",") if part.strip())

    @cached_property
    def registrations(self) -> Mapping[str, str]:
        """Depth camera of ``register_depth`` -> camera that it is registered to."""
        return dict(_pairs("register_depth", self.register_depth, "depth_camera=color"))

    def check_cameras(self, known: Sequence[str]) -> None:
        """Checks that the scene has the cameras that the settings name.

        Raises:
            ConfigError: a setting names a camera that the scene does not have.
        """
        registrations = self.registrations
        named = [("cameras", name) for name in self.camera_names]
        named += [("register_depth", name) for name in (*registrations, *registrations.values())]
        for setting_name, name in named:
            if name not in known:
                hint = nearest(name, known)
                raise ConfigError(
                    f"setting {quoted(setting_name)} has camera {quoted(name)}; {f'{hint} ' if hint else ''}the scene has: "
                    f"{', '.join(known) or 'none'}"
                )

    @cached_property
    def asset_folders(self) -> tuple[tuple[str, str], ...]:
        """Pairs of ``asset_roots``: absolute folders on the physics machine, and folders on this machine."""
        pairs = _pairs("asset_roots", self.asset_roots, "/there/scenes=/here/scenes")
        for remote, local in pairs:
            if not remote.startswith("/"):
                raise ConfigError(
                    f"setting 'asset_roots' has {quoted(remote)}, must be an absolute folder of the physics machine"
                )
            if not Path(os.path.expanduser(local)).is_dir():
                raise ConfigError(
                    f"setting 'asset_roots' maps {remote} to {quoted(local)}, which is not a folder of this machine"
                )
        return tuple((remote, str(Path(os.path.expanduser(local)))) for remote, local in pairs)
