"""Bags of made-up runs: a robot in a room of 10 x 4 m with walls around it, driven along given poses. Without ROS.

The goal is given at 2 s of simulation time; all times here are seconds after that. The room's walls are the outermost cells of 5 cm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.bags.writer import BagWriter
from gibson_sim.trials.records import Outcome, RunSpec
from gibson_sim.trials.scenario.spec import Scenario, StackSpec, Verdicts

SOURCE = Path(__file__).resolve().parents[2]
NS = 1_000_000_000
GOAL_NS = 2 * NS
PERIOD = 0.1
START, GOAL = (1.0, 2.0, 0.0), (6.0, 2.0, 0.0)
Pose = tuple[float, float, float]
Rows = Sequence[tuple[float, ...]]
TYPES = {
    "/ground_truth/odom": "nav_msgs/msg/Odometry",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/plan": "nav_msgs/msg/Path",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/collisions": "gibson_msgs/msg/CollisionCount",
    "/tick_digest": "gibson_msgs/msg/TickDigest",
    "/inputs": "gibson_msgs/msg/Input",
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}


def along(t: float, speed: float = 0.5) -> Pose:
    """Returns the pose of a robot that drives from the start to the goal, 5 m, and stops there: after 10 s at 0.5 m/s."""
    return min(1.0 + speed * max(t, 0.0), 6.0), 2.0, 0.0


def until(stop: float, x: float) -> Callable[[float], Pose]:
    """Returns the poses of a robot that drives at 0.5 m/s, and after ``stop`` seconds stands at ``x``."""
    return lambda t: along(t) if t < stop else (x, 2.0, 0.0)


def commands(*parts: tuple[float, float, float]) -> list[tuple[float, float, float]]:
    """Returns commands at 10 Hz, (time, m/s, rad/s), from (begin, end, m/s) in seconds."""
    return [(t, v, 0.0) for begin, end, v in parts for t in np.arange(begin, end - 1e-9, PERIOD).round(6).tolist()]


DRIVES_THERE = commands((0.0, 10.0, 0.5), (10.0, 12.0, 0.0))


@dataclass
class Run:
    """What happens in a run of 12 s that is good unless something is changed."""

    duration: float = 12.0
    truth: Callable[[float], Pose] | None = along
    odometry: Callable[[float], Pose] | None = None
    """None = the truth, but in a frame that begins at the start."""
    corrections: Sequence[tuple[float, float, float, float]] = ((-1.0, 1.0, 2.0, 0.0),)
    """Transforms map -> odom: time, x, y, yaw."""
    commands: Rows = field(default_factory=lambda: DRIVES_THERE)
    touches: Sequence[tuple[float, float, str]] = ()
    """Begin, end, body; they must not overlap."""
    plans: Sequence[tuple[float, Sequence[tuple[float, float]]]] = ((0.2, (START[:2], GOAL[:2])),)
    applied: Sequence[float] | None = None
    """Times of inputs; None = those of the commands."""
    without: Sequence[str] = ()
    """Topics that the bag lacks."""
    types: dict[str, str] = field(default_factory=dict)
    """Types other than usual."""
    extra: Sequence[tuple[float, str, Any]] = ()
    """Further messages: time, topic of ``TYPES``, message."""

    def write(self, folder: Path) -> Path:
        """Writes the bag to ``folder/bag`` and returns ``folder``."""
        make, rows = messages(), list[tuple[int, str, bytes]]()

        def add(t: float, topic: str, message: Any) -> None:
            if topic not in self.without:
                rows.append((ns(t), topic, make.cdr(message)))

        add(-1.5, "/map", make.grid())
        for t, *pose in self.corrections:
            add(t, "/tf", make.tf(t, "map", "odom", tuple(pose)))
        for k in range(-10, round(self.duration / PERIOD) + 1):
            t = round(k * PERIOD, 6)
            pose = (self.truth or along)(t)
            wheels = self.odometry(t) if self.odometry is not None else (pose[0] - 1.0, pose[1] - 2.0, pose[2])
            if self.truth is not None:
                add(t, "/ground_truth/odom", make.odometry(t, "map", pose))
            add(t, "/odom", make.odometry(t, "odom", wheels))
            add(t, "/tf", make.tf(t, "odom", "base_footprint", wheels))
            count = sum(begin <= t for begin, _, _ in self.touches)
            going = [body for begin, end, body in self.touches if begin <= t <= end]
            last = self.touches[count - 1][2] if count else ""
            add(t, "/collisions", make.collisions(t, count, len(going), last))
            add(t, "/tick_digest", make.digest(t, k + 10, {"/scene_state": k + 10, "/odom": 7}))
        for t, *velocity in self.commands:
            add(t, "/cmd_vel", make.twist(*velocity))
        for t in [row[0] for row in self.commands] if self.applied is None else self.applied:
            add(t, "/inputs", make.input(t))
        for t, points in self.plans:
            add(t, "/plan", make.path(points))
        for t, topic, message in self.extra:
            add(t, topic, message)
        with make.writer(folder / "bag") as bag:
            for topic in sorted({"/inputs", *(topic for _, topic, _ in rows)}):
                bag.add_topic(topic, {**TYPES, **self.types}[topic])
            for at, topic, data in sorted(rows, key=lambda row: row[0]):
                bag.write(topic, data, at, at)
        return folder

    def outcome(self, end: Any = "reached", **changes: Any) -> Outcome:
        """Returns the outcome of the run."""
        values = {"detail": "as told", "lockstep": True, "goal_ns": GOAL_NS, "end_ns": ns(self.duration)}
        return Outcome(end, **{**values, **changes})


def ns(t: float) -> int:
    """Returns the stamp of a time."""
    return GOAL_NS + round(t * NS)


def planned(**changes: Any) -> RunSpec:
    """Returns the planned run: 5 m straight on, a robot of 0.2 m radius."""
    values: dict[str, Any] = {
        "number": 0, "scene": "a scene that is not here", "robot": "gibson_bot", "seed": 1, "start": START, "goal": GOAL,
        "shortest": 5.0, "radius": 0.2,
    }  # fmt: skip
    return RunSpec(**{**values, **changes})


def scenario(folder: Path = Path(), **verdicts: Any) -> Scenario:
    """Returns a scenario in a folder with these verdicts beside the usual ones."""
    return Scenario("made_up", folder / "made_up.yaml", ("flat",), StackSpec(("true",)), verdicts=Verdicts(**verdicts))


@lru_cache(maxsize=1)
def messages() -> Messages:
    """Returns the builder of messages."""
    return Messages()


class Messages:
    """Builds messages of the types in rosbags and of gibson_msgs."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self.definitions = MessageDefinitions()
        types: dict[str, Any] = {}
        for path in sorted((SOURCE / "src/gibson_msgs/msg").glob("*.msg")):
            types.update(get_types_from_msg(path.read_text(), f"gibson_msgs/msg/{path.stem}"))
        self.store.register(types)

    def writer(self, folder: Path) -> BagWriter:
        """Returns a new bag, whose types need not be looked up again."""
        return BagWriter(folder, reserve_bytes=0, message_definitions=self.definitions)

    def __call__(self, type_name: str, **fields: Any) -> Any:
        """Returns a message; ``type_name`` without ``/msg/``."""
        return self.store.types[type_name.replace("/", "/msg/")](**fields)

    def cdr(self, message: Any) -> bytes:
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def header(self, t: float, frame: str) -> Any:
        at = ns(t)
        return self("std_msgs/Header", stamp=self("builtin_interfaces/Time", sec=at // NS, nanosec=at % NS), frame_id=frame)

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        return self("geometry_msgs/Vector3", x=x, y=y, z=z)

    def rotation(self, yaw: float) -> Any:
        return self("geometry_msgs/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))

    def pose(self, pose: Pose) -> Any:
        point = self("geometry_msgs/Point", x=pose[0], y=pose[1], z=0.0)
        return self("geometry_msgs/Pose", position=point, orientation=self.rotation(pose[2]))

    def odometry(self, t: float, frame: str, pose: Pose) -> Any:
        twist = self("geometry_msgs/Twist", linear=self.vector(), angular=self.vector())
        return self(
            "nav_msgs/Odometry", header=self.header(t, frame), child_frame_id="base_footprint",
            pose=self("geometry_msgs/PoseWithCovariance", pose=self.pose(pose), covariance=np.zeros(36)),
            twist=self("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip

    def estimate(self, t: float, pose: Pose) -> Any:
        covered = self("geometry_msgs/PoseWithCovariance", pose=self.pose(pose), covariance=np.zeros(36))
        return self("geometry_msgs/PoseWithCovarianceStamped", header=self.header(t, "map"), pose=covered)

    def tf(self, t: float, parent: str, child: str, pose: Pose) -> Any:
        transform = self(
            "geometry_msgs/Transform", translation=self.vector(pose[0], pose[1]), rotation=self.rotation(pose[2])
        )  # fmt: skip
        one = self("geometry_msgs/TransformStamped", header=self.header(t, parent), child_frame_id=child, transform=transform)
        return self("tf2_msgs/TFMessage", transforms=[one])

    def twist(self, forward: float, turning: float = 0.0) -> Any:
        return self("geometry_msgs/Twist", linear=self.vector(forward), angular=self.vector(z=turning))

    def input(self, t: float) -> Any:
        return self(
            "gibson_msgs/Input", header=self.header(t, ""), epoch=0, step=0, name="/cmd_vel", type="geometry_msgs/msg/Twist",
            data=np.zeros(0, dtype=np.uint8),
        )  # fmt: skip

    def path(self, points: Sequence[tuple[float, float]], frame: str = "map") -> Any:
        header = self.header(0.0, frame)
        poses = [self("geometry_msgs/PoseStamped", header=header, pose=self.pose((x, y, 0.0))) for x, y in points]
        return self("nav_msgs/Path", header=header, poses=poses)

    def collisions(self, t: float, count: int, ongoing: int, body: str) -> Any:
        return self(
            "gibson_msgs/CollisionCount", header=self.header(t, ""), count=count, ongoing=ongoing, duration=0.0, greatest_force=0.0,
            last_link="base", last_body=body,
        )  # fmt: skip

    def digest(self, t: float, step: int, values: dict[str, int], epoch: int = 0) -> Any:
        return self(
            "gibson_msgs/TickDigest", header=self.header(t, ""), epoch=epoch, step=step, topics=list(values),
            digests=np.array(list(values.values()), dtype=np.uint64),
        )  # fmt: skip

    def grid(self) -> Any:
        cells: NDArray[np.int8] = np.zeros((80, 200), dtype=np.int8)
        cells[[0, -1]] = 100
        cells[:, [0, -1]] = 100
        info = self(
            "nav_msgs/MapMetaData", map_load_time=self("builtin_interfaces/Time", sec=0, nanosec=0), resolution=0.05, width=200,
            height=80, origin=self.pose((0.0, 0.0, 0.0)),
        )  # fmt: skip
        return self("nav_msgs/OccupancyGrid", header=self.header(-1.5, "map"), info=info, data=cells.reshape(-1))
