"""Reads from the bag of a run what it is judged by, in one pass that decodes the topics that are needed and no others.

All times are seconds of simulation time since the goal was given; what lies outside the time from the goal to the end is left out, except
where a value from before still holds.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison import topics as roles
from gibson_sim.bags.plots.run_data import Floor
from gibson_sim.bags.plots.touches import Touch, TouchFinder, robot_bodies, robot_namespaces
from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.stamps import header_stamp_ns
from gibson_sim.errors import RecordError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.trials.judging.digest import RunDigest
from gibson_sim.trials.records import Outcome
from gibson_sim.types import NS_PER_S

F64 = NDArray[np.float64]
_TWISTS = (roles.TWIST, roles.TWIST_STAMPED)
_COMMANDS = ("/cmd_vel", "/cmd_vel_applied")
"""Topics of the robot's commands, the second repeats those that took effect."""
PATH, DIGEST, INPUT = "nav_msgs/msg/Path", "gibson_msgs/msg/TickDigest", "gibson_msgs/msg/Input"
_PLAN_NAMES = ("plan", "global_plan", "path", "planned_path", "global_path", "received_global_plan")
"""Last parts of the names of topics with the plan that a robot follows, in order of preference."""
_OCCUPIED = 50
"""Least value of an occupied cell of an OccupancyGrid: 0 free to 100 occupied."""
_SAME_M = 0.005
"""Greatest distance, m, of an estimate that is the truth itself, published by the simulation as map -> odom."""
_LARGEST = 1e6
"""Coordinates, velocities and times above this are damaged, SI units."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Planar poses in one frame."""

    t: F64
    """(N,), strictly increasing, s since the goal; N is 1 or more."""
    x: F64
    y: F64
    """(N,), metres."""
    yaw: F64
    """(N,), radians, unwrapped."""

    def at(self, t: F64 | float) -> F64:
        """Returns x, y (m) and yaw (rad) at times (...,), interpolated, as (3, ...); the first or the last pose outside of the track."""
        return np.array([np.interp(t, self.t, values) for values in (self.x, self.y, self.yaw)])

    @property
    def last(self) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) of the last pose."""
        return float(self.x[-1]), float(self.y[-1]), float(self.yaw[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the stack's localiser believes."""

    poses: Poses
    """Of the robot in the map frame: odometry by the latest correction."""
    corrections: F64
    """(K, 4): time, s since the goal, and T_map_odom as x, y, yaw, of each update; the first may be from before the goal. K may be 0."""
    odometry: Poses | None
    """What the corrections are of."""
    source: str
    """Topic, or ``tf map -> odom``."""


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """Velocity commands as the stack sent them, in the base frame."""

    t: F64
    """(N,), s since the goal."""
    forward: F64
    sideways: F64
    """(N,), m/s; not finite where the command is not."""
    turning: F64
    """(N,), rad/s."""
    topic: str

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """(N,): whether all numbers of a command are finite."""
        return np.asarray(np.isfinite(self.forward) & np.isfinite(self.sideways) & np.isfinite(self.turning))


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A path that the stack published, in the map frame."""

    t: float
    """s since the goal."""
    points: F64
    """(N, 2), metres; N is 2 or more."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a bag tells of a run between goal and end; None = the bag does not tell it."""

    duration: float
    """From the goal to the end, s."""
    decided: float
    """From the goal to when the stack told its end, or the robot began to stand at the goal, s; ``duration`` if neither did."""
    truth: Poses | None
    odometry: Poses | None
    """By the wheels, in the odometry's frame."""
    estimate: Estimate | None
    commands: Commands | None
    applied: F64 | None
    """(N,), times at which the simulation applied velocity commands, s since the goal."""
    wrong_commands: str
    """Topic and type of commands where the robot's topic has none that it takes; empty = there are none."""
    touches: tuple[Touch, ...] | None
    """Begun before the end and ended after the goal; times in s since the goal."""
    plans: tuple[Plan, ...]
    """In the order of time; no plan is in it twice in a row."""
    floor: Floor | None
    """The first map of the bag."""
    counts: Mapping[str, int]
    """Messages of each topic from the goal until it was decided, of those that were requested."""
    topics: tuple[str, ...]
    """All that have messages."""
    digest: str
    first: float
    last: float
    """Times of the first and the last message up to the end, s since the goal."""


def read_evidence(folder: Path, outcome: Outcome, counted: Collection[str] = ()) -> Evidence:
    """Returns what the bag of a run tells.

    Args:
        folder: of the bag.
        outcome: of the run; without a goal, the times count from the start.
        counted: topics whose messages are counted.

    Raises:
        RecordError: the bag is missing, empty or damaged.
    """
    with BagReader(folder) as bag:
        every = bag.topics()
        infos = {name: info for name, info in every.items() if info.count}
        if not infos:
            raise RecordError(f"bag {folder} holds no messages")
        begin_ns = max(outcome.goal_ns, 0)
        end_ns = outcome.end_ns if outcome.end_ns >= 0 else bag.span_ns[1]
        decided_ns = outcome.decided_ns if begin_ns <= outcome.decided_ns < end_ns else end_ns
        reading = _Reading(bag, infos, (begin_ns, decided_ns, end_ns), counted)
        reading.read()
        return reading.evidence(has_journal=any(info.type_name == INPUT for info in every.values()))


@dataclass(slots=True)
class _Rows:
    """Poses or velocities as they are read."""

    truth: list[tuple[float, ...]] = field(default_factory=list)
    odometry: list[tuple[float, ...]] = field(default_factory=list)
    poses: list[tuple[float, ...]] = field(default_factory=list)
    commands: list[tuple[float, ...]] = field(default_factory=list)
    map_from_odom: list[tuple[float, ...]] = field(default_factory=list)
    odom_from_base: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    """Child frame -> poses by tf in the frame odom."""
    applied: list[float] = field(default_factory=list)
    plans: list[Plan] = field(default_factory=list)


class _Reading:
    """One pass over a bag."""

    def __init__(
        self, bag: BagReader, infos: Mapping[str, TopicInfo], times_ns: tuple[int, int, int], counted: Collection[str]
    ) -> None:  # fmt: skip
        """``times_ns``: when the goal was given, when it was decided, and when the run ended."""
        self._bag, self._infos = bag, infos
        self._begin_ns, self._decided_ns, self._end_ns = times_ns
        names = robot_namespaces(infos)
        # A trial has one robot: others of the bag, if any, have namespaces.
        name = names[0]
        self._prefix = f"/{name}" if name else ""
        own = {t.removeprefix(self._prefix): info for t, info in infos.items() if t.startswith(f"{self._prefix}/")}
        truths = [t for t, info in own.items() if t.endswith("/ground_truth/odom") and info.type_name == roles.ODOMETRY]
        found = roles.find_topics({t: info for t, info in own.items() if "ground_truth" not in t}, {}, "")
        self._role: dict[str, str] = {self._prefix + found["odom"]: "odom"} if "odom" in found else {}
        commands = [t for name in _COMMANDS if (t := self._prefix + name) in infos and infos[t].type_name in _TWISTS]
        self._role.update({topic: "cmd_vel" for topic in commands[:1]})
        self._role.update({self._prefix + t: "truth" for t in truths[:1]})
        if "truth" in found:
            self._role[self._prefix + found["truth"]] = "pose"
        self._touches = TouchFinder(infos, (name,), robot_bodies(bag, (name,)))
        self._maps = [t for t in infos if t.endswith("/map") and infos[t].type_name == roles.MAP]
        self._plan_topic = _plan_topic(infos)
        self._map: Any = None
        self._map_frame = "map"
        self._rows = _Rows()
        self._digest = RunDigest()
        self._counted = set(counted) & set(infos)
        self._counts: Counter[str] = Counter({topic: 0 for topic in self._counted})
        self._first_ns, self._last_ns = bag.span_ns[0], min(bag.span_ns[1], self._end_ns)

    def _seconds(self, ns: int) -> float:
        return (ns - self._begin_ns) / NS_PER_S

    def _wanted(self) -> list[str]:
        wanted = {*self._role, *self._touches.topics, *self._maps[:1], *self._counted}
        wanted |= {self._plan_topic} & set(self._infos)
        for topic, info in self._infos.items():
            last = topic.rpartition("/")[2]
            named = {INPUT: ("inputs",), roles.TF: ("tf", "tf_static")}.get(info.type_name, ())
            if info.type_name == DIGEST or last in named:
                wanted.add(topic)
        return sorted(wanted)

    def read(self) -> None:
        """Reads the messages up to the end."""
        for topic, log_ns, data in self._bag.raw_messages(self._wanted(), stop_ns=self._end_ns + 1):
            info, t = self._infos[topic], self._seconds(log_ns)
            running = log_ns >= self._begin_ns
            if running and log_ns <= self._decided_ns and topic in self._counted:
                self._counts[topic] += 1
            if topic in self._role:
                if running:
                    self._add(self._role[topic], t, self._bag.decode(info.type_name, data))
            elif topic in self._maps[:1]:
                if self._map is None:
                    self._map = self._bag.decode(info.type_name, data)
                    self._map_frame = self._map.header.frame_id.lstrip("/") or "map"
            elif topic == self._plan_topic:
                if running:
                    self._add_plan(t, self._bag.decode(info.type_name, data))
            elif info.type_name == DIGEST:
                self._digest.add(self._bag.decode(info.type_name, data))
            elif info.type_name == INPUT:
                if running:
                    self._add_input(t, self._bag.decode(info.type_name, data))
            elif info.type_name == roles.TF:
                self._add_transforms(t, self._bag.decode(info.type_name, data))
            elif self._touches.needs(topic):
                self._touches.add(topic, t, self._bag.decode(info.type_name, data))

    def _add(self, role: str, t: float, msg: Any) -> None:
        if role == "cmd_vel":
            twist = getattr(msg, "twist", msg)
            self._rows.commands.append((t, twist.linear.x, twist.linear.y, twist.angular.z))
            return
        pose = getattr(msg.pose, "pose", msg.pose)
        q = pose.orientation
        stamp = self._seconds(header_stamp_ns(msg.header.stamp))
        row = stamp, pose.position.x, pose.position.y, yaw_from_quat((q.x, q.y, q.z, q.w))
        {"truth": self._rows.truth, "odom": self._rows.odometry, "pose": self._rows.poses}[role].append(row)

    def _add_plan(self, t: float, msg: Any) -> None:
        frame = msg.header.frame_id.lstrip("/") or (msg.poses[0].header.frame_id.lstrip("/") if msg.poses else "")
        if frame != self._map_frame or len(msg.poses) < 2:
            return
        points = np.array([(p.pose.position.x, p.pose.position.y) for p in msg.poses], dtype=np.float64)
        points = points[(np.abs(points) < _LARGEST).all(axis=1)]
        plans = self._rows.plans
        if len(points) > 1 and not (plans and np.array_equal(plans[-1].points, points)):
            plans.append(Plan(t, points))

    def _add_input(self, t: float, msg: Any) -> None:
        if msg.type in _TWISTS and msg.name.rpartition("/")[2] == "cmd_vel":
            self._rows.applied.append(t)

    def _add_transforms(self, t: float, msg: Any) -> None:
        """Keeps map -> odom at the time at which it was known, and odom -> base at its stamp."""
        for one in msg.transforms:
            parent, child = (frame.lstrip("/").rpartition("/")[2] for frame in (one.header.frame_id, one.child_frame_id))
            if (parent, child) != ("map", "odom") and parent != "odom":
                continue
            move, q = one.transform.translation, one.transform.rotation
            pose = move.x, move.y, yaw_from_quat((q.x, q.y, q.z, q.w))
            if parent == "map":
                self._rows.map_from_odom.append((t, *pose))
            elif t >= 0.0:
                stamp = self._seconds(header_stamp_ns(one.header.stamp))
                self._rows.odom_from_base.setdefault(child, []).append((stamp, *pose))

    def evidence(self, *, has_journal: bool) -> Evidence:
        """Returns what the messages read tell; ``has_journal``: whether the inputs of the simulation were recorded, if there were any."""
        rows, duration = self._rows, max(0.0, self._seconds(self._end_ns))
        truth, odometry = _poses(rows.truth, duration), _poses(rows.odometry, duration)
        by_tf = max(rows.odom_from_base.values(), key=len, default=[])
        estimate = _estimate(rows, _poses(by_tf, duration) or odometry, duration)
        if truth is not None and estimate is not None and float(errors(estimate.poses, truth)[0].max()) < _SAME_M:
            estimate = None
        commands = next((topic for topic, role in self._role.items() if role == "cmd_vel"), "")
        others = [
            f"{topic} of type {info.type_name}"
            for topic, info in self._infos.items()
            if topic.rpartition("/")[2].startswith("cmd_vel") or info.type_name in _TWISTS
        ]
        touches = tuple(touch for touch in self._touches.touches() if touch.end >= 0.0 and touch.begin <= duration)
        return Evidence(
            duration=duration,
            decided=min(duration, self._seconds(self._decided_ns)),
            truth=truth,
            odometry=odometry,
            estimate=estimate,
            commands=_commands(rows.commands, commands),
            applied=np.array(rows.applied, dtype=np.float64) if has_journal else None,
            wrong_commands=others[0] if others and not commands else "",
            touches=touches if self._touches.topics else None,
            plans=tuple(rows.plans),
            floor=_floor(self._map, self._maps[0] if self._maps else ""),
            counts=self._counts,
            topics=tuple(self._infos),
            digest=self._digest.hexdigest(self._end_ns),
            first=self._seconds(self._first_ns),
            last=self._seconds(self._last_ns),
        )


def errors(estimate: Poses, truth: Poses) -> tuple[F64, F64]:
    """Returns how far an estimate is from the truth at its own times: metres (N,), and radians (N,), 0 to pi."""
    x, y, yaw = truth.at(estimate.t)
    turn = np.abs(np.remainder(estimate.yaw - yaw + math.pi, 2.0 * math.pi) - math.pi)
    return np.hypot(estimate.x - x, estimate.y - y), turn


def composed(correction: F64, pose: F64) -> F64:
    """Returns T_map_base (3, ...) from T_map_odom and T_odom_base, each x, y, yaw as (3, ...)."""
    x, y, yaw = correction
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([x + c * pose[0] - s * pose[1], y + s * pose[0] + c * pose[1], yaw + pose[2]])


def _table(rows: list[tuple[float, ...]]) -> F64:
    """Returns rows (N, 4) that are finite and of sane size, by strictly increasing time; of equal times, the last."""
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 4)
    table = table[(np.abs(table) < _LARGEST).all(axis=1)][::-1]
    _, first = np.unique(table[:, 0], return_index=True)
    return np.asarray(table[first])


def _poses(rows: list[tuple[float, ...]], duration: float) -> Poses | None:
    table = _table(rows)
    table = table[(table[:, 0] >= 0.0) & (table[:, 0] <= duration)]
    return Poses(table[:, 0], table[:, 1], table[:, 2], np.unwrap(table[:, 3])) if len(table) else None


def _estimate(rows: _Rows, odometry: Poses | None, duration: float) -> Estimate | None:
    """Returns the estimate by transforms map -> odom, else by a pose topic; None = there is none."""
    corrections, source = _table(rows.map_from_odom), "tf map -> odom"
    if not len(corrections):
        source = "pose topic"
        poses = _poses(rows.poses, duration)
        if poses is None:
            return None
        if odometry is None:
            return Estimate(poses, np.zeros((0, 4)), None, source)
        # T_map_odom = T_map_base * T_base_odom
        ox, oy, oyaw = odometry.at(poses.t)
        yaw = poses.yaw - oyaw
        c, s = np.cos(yaw), np.sin(yaw)
        corrections = np.column_stack([poses.t, poses.x - (c * ox - s * oy), poses.y - (s * ox + c * oy), yaw])
    if odometry is None:
        return None
    corrections[:, 3] = np.unwrap(corrections[:, 3])
    before = max(0, int(np.searchsorted(corrections[:, 0], 0.0, side="right")) - 1)
    corrections = corrections[before:]
    known = odometry.t >= corrections[0, 0]
    if not known.any():
        return None
    t = odometry.t[known]
    at = np.searchsorted(corrections[:, 0], t, side="right") - 1
    x, y, yaw = composed(corrections[at, 1:].T, odometry.at(t))
    return Estimate(Poses(t, x, y, yaw), corrections, odometry, source)


def _commands(rows: list[tuple[float, ...]], topic: str) -> Commands | None:
    if not rows:
        return None
    table = np.array(rows, dtype=np.float64)
    return Commands(table[:, 0], table[:, 1], table[:, 2], table[:, 3], topic)


def _plan_topic(infos: Mapping[str, TopicInfo]) -> str:
    """Returns the topic of the plan that the robot follows: by its name, else the only one; empty = none can be told."""
    paths = [topic for topic, info in infos.items() if info.type_name == PATH]
    for name in _PLAN_NAMES:
        for topic in paths:
            if topic.rpartition("/")[2] == name:
                return topic
    return paths[0] if len(paths) == 1 else ""


def _floor(msg: Any, topic: str) -> Floor | None:
    """Returns the occupied cells of a map; None = it is none, or damaged."""
    if msg is None:
        return None
    info, cells = msg.info, np.asarray(msg.data, dtype=np.int8)
    numbers = float(info.resolution), float(info.origin.position.x), float(info.origin.position.y)
    if len(cells) != info.width * info.height or not len(cells) or not (np.abs(numbers) < _LARGEST).all() or numbers[0] <= 0.0:
        return None
    grid = np.where(cells >= _OCCUPIED, 100, cells).astype(np.int8)
    return Floor(grid.reshape(info.height, info.width), numbers[0], numbers[1:], topic)
