"""Parameters of the nodes, each with its unit, its limits and a description. Independent of ROS: a node declares a parameter for every field."""

from __future__ import annotations

import difflib
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import Field, dataclass, field, fields
from typing import Any

from gibson_path_following.errors import SettingError, quoted
from gibson_path_following.images.goggles import MODES
from gibson_path_following.types import IMAGES_OF

PINHOLE_HFOV_DEG = (1.0, 179.0)
"""Least and largest horizontal field of view of a pinhole camera, degrees."""
_TOPIC = re.compile(r"(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
"""Names of topics (https://design.ros2.org/articles/topic_and_service_names.html)."""


def option(default: Any, text: str, least: float | None = None, most: float | None = None, *, is_topic: bool = False) -> Any:
    """Returns a field with a description and, for a number, its limits; ``is_topic``: its value is a name of a topic, or are several."""
    metadata = {"text": text, "least": least, "most": most, "is_topic": is_topic}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Options:
    """Base of the parameters of a node; checks types and limits."""

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            _check(one.name, value, one.default, one.metadata["least"], one.metadata["most"])
            if one.metadata["is_topic"]:
                for topic in [value] if isinstance(value, str) else value:
                    _check_topic(one.name, topic)


def describe(kind: type[Options]) -> str:
    """Returns the parameters of a node as text: type, limits, default and description of each."""
    return "\n".join(_described(one) for one in fields(kind))


def unknown_name(name: str, kind: type[Options]) -> str:
    """Returns the line of a warning about a parameter that a node does not have."""
    names = [one.name for one in fields(kind)]
    swapped = [one for one in names if sorted(one) == sorted(name)]  # exchanged letters are nearer than a missing one
    near = swapped or difflib.get_close_matches(name, names, 1, 0.5)
    hint = f"did you mean {quoted(near[0])}?" if near else "--help lists the parameters of this node"
    return f"parameter {quoted(name)} is unknown and has no effect; {hint}"


@dataclass(frozen=True)
class CameraOptions(Options):
    """The robot's camera, or pair of cameras."""

    image_topics: Sequence[str] = option(
        ("camera/image_raw",),
        "topics of the images: one for a pinhole camera; front, back for a fisheye pair. Names that end in /compressed carry "
        "sensor_msgs/CompressedImage, others sensor_msgs/Image",
        is_topic=True,
    )
    use_camera_info: bool = option(True, "wait for camera_info beside each image topic, and map the images by its calibration")
    camera_hfov_deg: float = option(
        0.0, "horizontal field of view of a camera without calibration, degrees; 0 = that of the path", 0.0, 360.0
    )
    rate_hz: float = option(5.0, "maximum rate at which images are used, by their stamps; 0 = all", 0.0, 1000.0)
    sync_tolerance: float = option(0.02, "largest difference between the stamps of front and back, seconds", 0.0, 1.0)


@dataclass(frozen=True)
class RecorderOptions(CameraOptions):
    """Parameters of ``path_recorder``."""

    rate_hz: float = option(10.0, "maximum rate at which images are used, by their stamps; 0 = all", 0.0, 1000.0)
    folder: str = option("path", "folder of the path, which is written when the recording ends; ~ is the home folder")
    replace: bool = option(
        False, "whether an older path in that folder is replaced; a folder that holds other files, too, is refused"
    )
    autostart: bool = option(False, "record at once, until path_recorder/stop is called or the node ends")
    camera: str = option("pinhole", f"kind of the path's camera: {' or '.join(IMAGES_OF)}")
    width: int = option(96, "width of the path's images, pixels", 16, 4096)
    height: int = option(64, "height of the path's images, pixels", 16, 4096)
    hfov_deg: float = option(
        0.0, "horizontal field of view of the path's images, degrees; 0 = all that a calibrated camera sees", 0.0, 360.0
    )
    spacing: float = option(0.2, "distance between nodes, metres", 0.01, 10.0)
    turn_deg: float = option(20.0, "turn after which a node is added at any distance, degrees", 1.0, 360.0)
    interval: float = option(
        0.0,
        "time after which a node is added at any distance, seconds; 0 = never. For images alone, without odom and cmd_vel",
        0.0,
        3600.0,
    )
    use_odometry: bool = option(True, "distances and poses from odom; else distances from the commands, and no poses")
    stamped: bool = option(False, "cmd_vel is geometry_msgs/TwistStamped")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.camera not in IMAGES_OF:
            raise SettingError(f"parameter camera is {quoted(self.camera)}, must be one of {', '.join(IMAGES_OF)}")
        check_camera(self.camera, self)
        _check_hfov("hfov_deg", self.hfov_deg, self.camera)
        if not self.folder:
            raise SettingError("parameter folder is empty, must be the folder of the path")


@dataclass(frozen=True)
class LocaliserOptions(CameraOptions):
    """Parameters of ``path_localiser``."""

    path: str = option("", "folder of the path; must be given")
    start: float = option(-1.0, "node where the robot is at the start; -1 = anywhere", -1.0, 1e6)
    use_commands: bool = option(True, "predict the motion by cmd_vel while it has a publisher; false = localise by images alone")
    stamped: bool = option(False, "cmd_vel is geometry_msgs/TwistStamped")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_path(self.path)


@dataclass(frozen=True)
class PolicyOptions(CameraOptions):
    """Parameters of ``path_policy``."""

    path: str = option("", "folder of the path; must be given")
    backend: str = option("learned", "learned, or learned:FILE with another network; teach_repeat; onnx:FILE")
    autostart: bool = option(True, "configure and activate without a lifecycle manager")
    start: float = option(0.0, "node where the robot is at the start; -1 = anywhere", -1.0, 1e6)
    max_linear: float = option(0.5, "maximum speed, m/s", 0.01, 10.0)
    max_angular: float = option(1.0, "maximum yaw rate, rad/s", 0.01, 10.0)
    stale_after: float = option(0.5, "age of the newest images at which the robot stops, seconds", 0.05, 60.0)
    camera_ahead: float = option(
        0.12, "distance of the camera in front of the middle of the wheels, metres; for learned", -5.0, 5.0
    )
    latency: float = option(
        0.0, "expected time from a command to its motion, seconds; the true one is learned while driving", 0.0, 10.0
    )
    search: bool = option(True, "a robot that is lost turns in place to either side, once and slowly, to find the path again")
    watchdog_hz: float = option(
        10.0, "rate at which commands are sent and the age of the images is checked, Hz, in ROS time", 1.0, 100.0
    )
    stamped: bool = option(False, "send geometry_msgs/TwistStamped")
    base_frame: str = option("base_footprint", "frame of TwistStamped")
    deadman_button: int = option(-1, "button of joy that must be held while the robot drives; -1 = none", -1, 64)
    exit_at_end: bool = option(False, "end with code 0 when the end of the path is reached")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_path(self.path)


@dataclass(frozen=True)
class EvaluatorOptions(Options):
    """Parameters of ``path_evaluator``."""

    path: str = option("", "folder of the path, must be given; its nodes need poses in the frame of ground_truth/odom")
    file: str = option("path_following.json", "file of the results")
    collision_topic: str = option("bumper", "topic of collisions; empty = none is counted", is_topic=True)
    collision_type: str = option(
        "std_msgs/msg/Bool",
        "its type: a message with a bool `data`, or with `count` and `ongoing` as gibson_msgs/msg/CollisionCount",
    )
    arrival_radius: float = option(0.5, "a node is visited, and the end reached, within this distance, metres", 0.01, 10.0)
    time_limit: float = option(0.0, "ends the drive after this time, seconds of ROS time; 0 = never", 0.0, 1e6)
    exit_at_end: bool = option(True, "end when the results are written, with code 0")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_path(self.path)
        if not self.file.endswith(".json"):
            raise SettingError(f"parameter file is {quoted(self.file)}, must be a name that ends in .json")


@dataclass(frozen=True)
class FaultOptions(Options):
    """Parameters of ``camera_faults``."""

    cover_after: float = option(2.0, "time from the robot's first motion to when the lens is covered, seconds", 0.0, 3600.0)
    cover: float = option(0.0, "how long the lens is covered, seconds; 0 = never", 0.0, 3600.0)
    drop: float = option(0.0, "share of the images that is dropped, evenly spread: 0.5 = every other one", 0.0, 1.0)
    delay: float = option(0.0, "delay of the images, seconds, in steps of their period", 0.0, 60.0)
    stamped: bool = option(False, "cmd_vel is geometry_msgs/TwistStamped")


@dataclass(frozen=True)
class GogglesOptions(Options):
    """Parameters of ``goggles``."""

    image_topic: str = option(
        "camera/image_raw",
        "topic of the images; a name that ends in /compressed carries sensor_msgs/CompressedImage",
        is_topic=True,
    )
    mode: str = option("learned", f"how images are adapted to the appearance of the simulator: {', '.join(MODES)}")
    model: str = option("", "ONNX file of learned; empty = the network in the package")
    queue_size: int = option(
        1,
        "images that may wait while one is adapted; 1 = the newest only, for a robot; a larger number, for bags, receives reliably and adapts "
        "images in their order",
        1,
        10_000,
    )
    reference: str = option("", "folder of a path whose colours the other modes aim at; empty = the simulator's")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.image_topic:
            raise SettingError("parameter image_topic is empty, must be a topic of images")
        _check_image_topic("image_topic", self.image_topic)
        if self.mode not in MODES:
            raise SettingError(f"parameter mode is {quoted(self.mode)}, must be one of {', '.join(MODES)}")
        if self.model and self.mode != "learned":
            raise SettingError(f"parameter model is {quoted(self.model)}, which mode {self.mode} does not use; leave it empty")
        if self.reference and self.mode == "learned":
            raise SettingError(
                f"parameter reference is {quoted(self.reference)}, which mode learned does not use; leave it empty"
            )


def _described(one: Field[Any]) -> str:
    least, most = one.metadata["least"], one.metadata["most"]
    if isinstance(one.default, tuple):
        kind, default = "list of strings", f"[{', '.join(one.default)}]"
    elif isinstance(one.default, bool):
        kind, default = "bool", str(one.default).lower()
    elif isinstance(one.default, str):
        kind, default = "string", one.default or "empty"
    else:
        kind, default = "float" if isinstance(one.default, float) else "integer", f"{one.default!r}"
    limits = "" if least is None or most is None else f", {least:g} to {most:.9g}"
    text = textwrap.fill(one.metadata["text"], 100, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return f"  {one.name}  ({kind}{limits}; default {default})\n{text}"


_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
"""Types of parameters; a bool is an int, too."""


def _check_topic(name: str, topic: str) -> None:
    if topic and not _TOPIC.fullmatch(topic):
        raise SettingError(
            f"parameter {name} is {quoted(topic)}, which cannot name a topic; must be letters, digits, _ and /, such as camera/image_raw"
        )


def _check_image_topic(name: str, topic: str) -> None:
    if topic.rpartition("/")[2] == "camera_info":
        raise SettingError(f"parameter {name} has {quoted(topic)}, must be topics of images, such as camera/image_raw")


def _check(name: str, value: Any, default: object, least: Any, most: Any) -> None:
    """``least`` and ``most``: limits of a number; None = it has none."""
    if isinstance(default, tuple):
        if not value:  # rclpy has None for an empty list
            raise SettingError(f"parameter {name} is empty, must be a list of names, such as [{', '.join(default)}]")
        if not isinstance(value, Sequence) or isinstance(value, str) or not all(isinstance(part, str) and part for part in value):
            raise SettingError(f"parameter {name} is {quoted(value)}, must be a list of names, such as [{', '.join(default)}]")
        return
    allowed: Any = (int, float) if isinstance(default, float) else type(default)
    if not isinstance(value, allowed) or (isinstance(value, bool) and not isinstance(default, bool)):
        kind = next(text for of, text in _KINDS.items() if isinstance(default, of))
        raise SettingError(f"parameter {name} is {quoted(value)}, must be {kind}")
    is_limited = least is not None and most is not None and isinstance(value, (int, float))
    if is_limited and not (math.isfinite(value) and least <= value <= most):
        raise SettingError(f"parameter {name} is {value:g}, must be {least:g} to {most:g}")


def check_camera(camera: str, options: CameraOptions) -> None:
    """Checks that parameters fit a kind of camera.

    Raises:
        SettingError: there are too few topics or too many, one is given twice, or a pinhole camera cannot have the field of view.
    """
    names, topics = next(images for kind, images in IMAGES_OF.items() if kind == camera), options.image_topics
    if len(topics) != len(names):
        raise SettingError(
            f"parameter image_topics has {len(topics)} names, a {camera} camera needs {len(names)}: {', '.join(names)}"
        )
    for topic in topics:
        _check_image_topic("image_topics", topic)
    if len(set(topics)) < len(topics):
        raise SettingError(f"parameter image_topics is {quoted(list(topics))}, must be different topics: {', '.join(names)}")
    _check_hfov("camera_hfov_deg", options.camera_hfov_deg, camera)


def _check_hfov(name: str, value: float, camera: str) -> None:
    least, most = PINHOLE_HFOV_DEG
    if value != 0.0 and not (least <= value and (value <= most or camera != "pinhole")):
        limits = f"{least:g} to {most:g} for a pinhole camera" if camera == "pinhole" else f"{least:g} to 360"
        raise SettingError(f"parameter {name} is {value:g}, must be 0, or {limits}")


def check_start(start: float, nodes: int) -> None:
    """Checks that a path has the node where the robot is at the start.

    Raises:
        SettingError: it has not.
    """
    if not (start == -1.0 or 0.0 <= start <= nodes - 1):
        raise SettingError(f"parameter start is {start:g}, must be -1 = anywhere, or a node of the path, 0 to {nodes - 1}")


def _check_path(path: str) -> None:
    if not path:
        raise SettingError("parameter path is empty, must be a folder that path_recorder wrote")
