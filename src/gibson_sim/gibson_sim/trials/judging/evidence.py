"""Reads the evidence for judging a run from its bag, in one pass that decodes only the required topics.

All times are seconds of simulation time since the goal was sent. Data outside the interval from the goal to the end are ignored, except
earlier values that still hold.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison import topics as roles
from gibson_sim.bags.digest_comparison import Tick, TickDigests
from gibson_sim.bags.plots.run_data import Floor
from gibson_sim.bags.plots.touches import Touch, TouchFinder, robot_bodies, robot_namespaces
from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.errors import RecordError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.standard.requests import CONTROLS
from gibson_sim.trials.foreign_calls import TIME_CONTROL, JournalEntry
from gibson_sim.trials.records import Outcome
from gibson_sim.types import NS_PER_S

F64 = NDArray[np.float64]
_TWISTS = (roles.TWIST, roles.TWIST_STAMPED)
_COMMANDS = ("/cmd_vel", "/cmd_vel_applied")
"""Topics of the robot's velocity commands; the second repeats the applied commands."""
PATH, DIGEST, INPUT = "nav_msgs/msg/Path", "gibson_msgs/msg/TickDigest", "gibson_msgs/msg/Input"
_PLAN_NAMES = ("plan", "global_plan", "path", "planned_path", "global_path", "received_global_plan")
"""Last parts of topic names of the plan that a robot follows, in order of preference."""
_OCCUPIED = 50
"""Least value of an occupied cell of an OccupancyGrid: 0 free to 100 occupied."""
_SAME_M = 0.005
"""Greatest error, m, of an estimate that is the truth itself, published by the simulation as map -> odom."""
_MISSED = 1.5
"""Least ratio of the time between two ticks of the bag to the usual one from which ticks are missing between them."""
_DIGEST_SIZE = 16
"""Size of a run's digest, bytes."""
_LARGEST = 1e6
"""Coordinates, velocities and times above this value are damaged, SI units."""


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
        """Returns x, y (m) and yaw (rad) interpolated at times (...,) as (3, ...); outside the track, the first or last pose."""
        return np.array([np.interp(t, self.t, values) for values in (self.x, self.y, self.yaw)])

    @property
    def last(self) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) of the last pose."""
        return float(self.x[-1]), float(self.y[-1]), float(self.yaw[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The pose estimate of the stack's localiser."""

    poses: Poses
    """Poses of the robot in the map frame: odometry transformed by the latest correction."""
    corrections: F64
    """(K, 4): time, s since the goal, and T_map_odom as x, y, yaw of each update; the first may precede the goal. K may be 0."""
    odometry: Poses | None
    """Odometry that the corrections apply to."""
    source: str
    """``pose topic`` or ``tf map -> odom``."""


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """Velocity commands as the stack sent them, in the base frame."""

    t: F64
    """(N,), s since the goal."""
    forward: F64
    sideways: F64
    """(N,), m/s; not finite if the command is not."""
    turning: F64
    """(N,), rad/s."""
    topic: str

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """(N,): whether all values of a command are finite."""
        return np.asarray(np.isfinite(self.forward) & np.isfinite(self.sideways) & np.isfinite(self.turning))


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A path that the stack published, in the map frame."""

    t: float
    """s since the goal."""
    points: F64
    """(N, 2), metres; N is 2 or more."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Simulation time of which the bag has no tick."""

    begin: float
    """Time of the last tick before it, s since the goal."""
    length: float
    """s."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Evidence from the bag of a run, between goal and end; None = not in the bag."""

    duration: float
    """Time from the goal to the end, s."""
    decided: float
    """Time from the goal until the stack reported its end or the robot came to rest at the goal, s; ``duration`` if neither happened."""
    truth: Poses | None
    odometry: Poses | None
    """Wheel odometry, in the odom frame."""
    estimate: Estimate | None
    commands: Commands | None
    applied: F64 | None
    """(N,), times at which the simulation applied velocity commands, s since the goal."""
    unsupported_commands: str
    """Topic and type of velocity commands that the robot does not accept, if it has no others; empty = none."""
    touches: tuple[Touch, ...] | None
    """Contacts that began before the end and ended after the goal; times in s since the goal."""
    plans: tuple[Plan, ...]
    """Plans in order of time, without consecutive duplicates."""
    floor: Floor | None
    """The first map of the bag."""
    counts: Mapping[str, int]
    """Requested topic -> number of messages from the goal until the run was decided."""
    topics: tuple[str, ...]
    """All topics with messages."""
    calls: tuple[JournalEntry, ...]
    """Requests up to the end that changed the world or how its time passes, those before the goal included, see ``CONTROLS``."""
    digest: str
    """See ``records.RunResult.digest``."""
    first: float
    last: float
    """Times of the first and the last message up to the end, s since the goal."""
    gaps: tuple[Gap, ...]
    """Gaps between the ticks from the goal to the end, in order of time."""


def read_evidence(folder: Path, outcome: Outcome, counted: Collection[str] = ()) -> Evidence:
    """Returns the evidence from the bag of a run.

    Args:
        folder: folder of the bag.
        outcome: outcome of the run; without a goal, times are relative to the start.
        counted: topics whose messages are counted.

    Raises:
        RecordError: the bag is missing, empty or damaged.
    """
    with BagReader(folder) as bag:
        all_infos = bag.topics()
        infos = {name: info for name, info in all_infos.items() if info.count}
        if not infos:
            raise RecordError(f"bag {folder} holds no messages")
        begin_ns = max(outcome.goal_ns, 0)
        end_ns = outcome.end_ns if outcome.end_ns >= 0 else bag.span_ns[1]
        decided_ns = outcome.decided_ns if begin_ns <= outcome.decided_ns < end_ns else end_ns
        reading = _Reading(bag, infos, (begin_ns, decided_ns, end_ns), counted)
        reading.read()
        return reading.evidence(has_journal=any(info.type_name == INPUT for info in all_infos.values()))


@dataclass(slots=True)
class _Rows:
    """Rows of poses and velocities, in the order of the bag."""

    truth: list[tuple[float, ...]] = field(default_factory=list)
    odometry: list[tuple[float, ...]] = field(default_factory=list)
    poses: list[tuple[float, ...]] = field(default_factory=list)
    commands: list[tuple[float, ...]] = field(default_factory=list)
    map_from_odom: list[tuple[float, ...]] = field(default_factory=list)
    odom_from_base: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    """Child frame -> poses from tf in the odom frame."""
    applied: list[float] = field(default_factory=list)
    calls: list[JournalEntry] = field(default_factory=list)
    plans: list[Plan] = field(default_factory=list)


class _RunDigest:
    """The digest of a run, one hash of all messages that physics published; collects ``tick_digest`` messages in any order.

    Equal digests mean equal runs. Digests of render nodes are ignored: the set of rendered images depends on subscribers and machine speed, and
    their pixels depend on the graphics driver.
    """

    def __init__(self) -> None:
        self._ticks: dict[Tick, tuple[int, tuple[tuple[str, int], ...]]] = {}
        """Physics tick -> stamp, and the digest of each topic."""

    def add(self, msg: Any) -> None:
        """Adds a gibson_msgs/TickDigest."""
        digests = TickDigests(time_from_msg(msg.header.stamp), tuple(msg.topics), msg.digests)
        if digests.is_physics:
            values = tuple(sorted((topic, int(digest)) for topic, digest in digests.values().items()))
            self._ticks[int(msg.epoch), int(msg.step)] = digests.stamp_ns, values

    @property
    def stamps_ns(self) -> list[int]:
        """Stamps of all ticks, ns, in no particular order."""
        return [stamp_ns for stamp_ns, _ in self._ticks.values()]

    def hexdigest(self, end_ns: int) -> str:
        """Returns the BLAKE2b hash of all ticks up to a stamp, ns, in order; empty = no ticks.

        Epochs are counted from the first one, so that a run after a reset equals one in a fresh simulation.
        """
        ticks = sorted(tick for tick, (stamp_ns, _) in self._ticks.items() if stamp_ns <= end_ns)
        if not ticks:
            return ""
        digest, first = hashlib.blake2b(digest_size=_DIGEST_SIZE), ticks[0][0]
        for epoch, step in ticks:
            values = self._ticks[epoch, step][1]
            digest.update(struct.pack("<IQI", epoch - first, step, len(values)))
            for topic, value in values:
                name = topic.encode()
                digest.update(struct.pack("<I", len(name)) + name + struct.pack("<Q", value))
        return digest.hexdigest()


class _Reading:
    """One pass over a bag."""

    def __init__(
        self, bag: BagReader, infos: Mapping[str, TopicInfo], times_ns: tuple[int, int, int], counted: Collection[str]
    ) -> None:  # fmt: skip
        """``times_ns``: stamps of the goal, of the decision and of the end."""
        self._bag, self._infos = bag, infos
        self._begin_ns, self._decided_ns, self._end_ns = times_ns
        names = robot_namespaces(infos)
        # A trial has one robot; further robots in the bag, if any, have namespaces.
        name = names[0]
        self._prefix = f"/{name}" if name else ""
        robot_infos = {t.removeprefix(self._prefix): info for t, info in infos.items() if t.startswith(f"{self._prefix}/")}
        truths = [t for t, info in robot_infos.items() if t.endswith("/ground_truth/odom") and info.type_name == roles.ODOMETRY]
        topics = roles.find_topics({t: info for t, info in robot_infos.items() if "ground_truth" not in t}, {}, "")
        self._role: dict[str, str] = {self._prefix + topics["odom"]: "odom"} if "odom" in topics else {}
        commands = [t for name in _COMMANDS if (t := self._prefix + name) in infos and infos[t].type_name in _TWISTS]
        self._role.update({topic: "cmd_vel" for topic in commands[:1]})
        self._role.update({self._prefix + t: "truth" for t in truths[:1]})
        if "truth" in topics:
            self._role[self._prefix + topics["truth"]] = "pose"
        self._touches = TouchFinder(infos, (name,), robot_bodies(bag, (name,)))
        self._maps = [t for t in infos if t.endswith("/map") and infos[t].type_name == roles.MAP]
        self._plan_topic = _plan_topic(infos)
        self._map: Any = None
        self._map_frame = "map"
        self._rows = _Rows()
        self._digest = _RunDigest()
        self._counted = set(counted) & set(infos)
        self._counts: Counter[str] = Counter({topic: 0 for topic in self._counted})
        self._first_ns, self._last_ns = bag.span_ns[0], min(bag.span_ns[1], self._end_ns)

    def _seconds(self, ns: int) -> float:
        return (ns - self._begin_ns) / NS_PER_S

    def _required_topics(self) -> list[str]:
        required = {*self._role, *self._touches.topics, *self._maps[:1], *self._counted}
        required |= {self._plan_topic} & set(self._infos)
        for topic, info in self._infos.items():
            last = topic.rpartition("/")[2]
            named = {INPUT: ("inputs", TIME_CONTROL), roles.TF: ("tf", "tf_static")}.get(info.type_name, ())
            if info.type_name == DIGEST or last in named:
                required.add(topic)
        return sorted(required)

    def read(self) -> None:
        """Reads the messages up to the end."""
        for topic, log_ns, data in self._bag.raw_messages(self._required_topics(), stop_ns=self._end_ns + 1):
            info, t = self._infos[topic], self._seconds(log_ns)
            has_goal = log_ns >= self._begin_ns
            if has_goal and log_ns <= self._decided_ns and topic in self._counted:
                self._counts[topic] += 1
            if topic in self._role:
                if has_goal:
                    self._add(self._role[topic], t, self._bag.decode(info.type_name, data))
            elif topic in self._maps[:1]:
                if self._map is None:
                    self._map = self._bag.decode(info.type_name, data)
                    self._map_frame = self._map.header.frame_id.lstrip("/") or "map"
            elif topic == self._plan_topic:
                if has_goal:
                    self._add_plan(t, self._bag.decode(info.type_name, data))
            elif info.type_name == DIGEST:
                self._digest.add(self._bag.decode(info.type_name, data))
            elif info.type_name == INPUT:
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
        stamp = self._seconds(time_from_msg(msg.header.stamp))
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
            self._rows.applied += [t] if t >= 0.0 else []
            return
        stamp_ns = time_from_msg(msg.header.stamp)
        entry = JournalEntry(stamp_ns, int(msg.step), str(msg.name), bytes(bytearray(msg.data)))
        if entry.kind in CONTROLS:
            self._rows.calls.append(entry)

    def _add_transforms(self, t: float, msg: Any) -> None:
        """Stores map -> odom with its time of arrival, and odom -> base with its stamp."""
        for transform in msg.transforms:
            parent, child = (
                frame.lstrip("/").rpartition("/")[2] for frame in (transform.header.frame_id, transform.child_frame_id)
            )
            if (parent, child) != ("map", "odom") and parent != "odom":
                continue
            translation, q = transform.transform.translation, transform.transform.rotation
            pose = translation.x, translation.y, yaw_from_quat((q.x, q.y, q.z, q.w))
            if parent == "map":
                self._rows.map_from_odom.append((t, *pose))
            elif t >= 0.0:
                stamp = self._seconds(time_from_msg(transform.header.stamp))
                self._rows.odom_from_base.setdefault(child, []).append((stamp, *pose))

    def evidence(self, *, has_journal: bool) -> Evidence:
        """Returns the evidence from the messages read; ``has_journal``: whether the bag records the inputs of the simulation."""
        rows, duration = self._rows, max(0.0, self._seconds(self._end_ns))
        truth, odometry = _poses(rows.truth, duration), _poses(rows.odometry, duration)
        tf_rows = max(rows.odom_from_base.values(), key=len, default=[])
        estimate = _estimate(rows, _poses(tf_rows, duration) or odometry, duration)
        if truth is not None and estimate is not None and float(errors(estimate.poses, truth)[0].max()) < _SAME_M:
            estimate = None
        command_topic = next((topic for topic, role in self._role.items() if role == "cmd_vel"), "")
        unsupported = [
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
            commands=_commands(rows.commands, command_topic),
            applied=np.array(rows.applied, dtype=np.float64) if has_journal else None,
            unsupported_commands=unsupported[0] if unsupported and not command_topic else "",
            touches=touches if self._touches.topics else None,
            plans=tuple(rows.plans),
            floor=_floor(self._map, self._maps[0] if self._maps else ""),
            counts=self._counts,
            topics=tuple(self._infos),
            calls=tuple(rows.calls),
            digest=self._digest.hexdigest(self._end_ns),
            first=self._seconds(self._first_ns),
            last=self._seconds(self._last_ns),
            gaps=self._gaps(duration),
        )

    def _gaps(self, duration: float) -> tuple[Gap, ...]:
        """Returns the gaps in what the simulation publishes at every tick: in its digests, and in the true pose.

        The one that lacks more counts: messages of the other kind may have been published by somebody else meanwhile.
        """
        sources = ([self._seconds(ns) for ns in self._digest.stamps_ns], [row[0] for row in self._rows.truth])
        return max((_gaps(times, duration) for times in sources), key=lambda gaps: sum(gap.length for gap in gaps))


def errors(estimate: Poses, truth: Poses) -> tuple[F64, F64]:
    """Returns the errors of an estimate against the truth at the times of the estimate: (N,), metres, and (N,), radians, 0 to pi."""
    x, y, yaw = truth.at(estimate.t)
    turn = np.abs(np.remainder(estimate.yaw - yaw + math.pi, 2.0 * math.pi) - math.pi)
    return np.hypot(estimate.x - x, estimate.y - y), turn


def compose(correction: F64, pose: F64) -> F64:
    """Returns T_map_base (3, ...) from T_map_odom and T_odom_base, each x, y, yaw as (3, ...)."""
    x, y, yaw = correction
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([x + c * pose[0] - s * pose[1], y + s * pose[0] + c * pose[1], yaw + pose[2]])


def _table(rows: list[tuple[float, ...]]) -> F64:
    """Returns the rows (N, 4) with finite and plausible values, by strictly increasing time; of equal times, the last row."""
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 4)
    table = table[(np.abs(table) < _LARGEST).all(axis=1)][::-1]
    _, first = np.unique(table[:, 0], return_index=True)
    return np.asarray(table[first])


def _poses(rows: list[tuple[float, ...]], duration: float) -> Poses | None:
    table = _table(rows)
    table = table[(table[:, 0] >= 0.0) & (table[:, 0] <= duration)]
    return Poses(table[:, 0], table[:, 1], table[:, 2], np.unwrap(table[:, 3])) if len(table) else None


def _estimate(rows: _Rows, odometry: Poses | None, duration: float) -> Estimate | None:
    """Returns the estimate from transforms map -> odom, else from a pose topic; None = neither exists."""
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
    first = max(0, int(np.searchsorted(corrections[:, 0], 0.0, side="right")) - 1)
    corrections = corrections[first:]
    known = odometry.t >= corrections[0, 0]
    if not known.any():
        return None
    t = odometry.t[known]
    index = np.searchsorted(corrections[:, 0], t, side="right") - 1
    x, y, yaw = compose(corrections[index, 1:].T, odometry.at(t))
    return Estimate(Poses(t, x, y, yaw), corrections, odometry, source)


def _commands(rows: list[tuple[float, ...]], topic: str) -> Commands | None:
    if not rows:
        return None
    table = np.array(rows, dtype=np.float64)
    return Commands(table[:, 0], table[:, 1], table[:, 2], table[:, 3], topic)


def _plan_topic(infos: Mapping[str, TopicInfo]) -> str:
    """Returns the topic of the plan that the robot follows: by name, else the only path topic; empty = unknown."""
    paths = [topic for topic, info in infos.items() if info.type_name == PATH]
    for name in _PLAN_NAMES:
        for topic in paths:
            if topic.rpartition("/")[2] == name:
                return topic
    return paths[0] if len(paths) == 1 else ""


def _gaps(times: Collection[float], duration: float) -> tuple[Gap, ...]:
    """Returns the gaps between the goal, ticks at these times (s since the goal, any order, duplicates allowed), and the end."""
    ticks = np.unique(np.array([t for t in times if 0.0 < t < duration], dtype=np.float64))
    if len(ticks) < 2:
        return ()
    period = float(np.median(np.diff(ticks)))
    ends = np.array([0.0, *ticks, duration])
    steps = np.diff(ends)
    return tuple(Gap(float(ends[k]), float(steps[k]) - period) for k in np.flatnonzero(steps > _MISSED * period))


def _floor(msg: Any, topic: str) -> Floor | None:
    """Returns a map with its occupied cells; None = missing or damaged."""
    if msg is None:
        return None
    info, cells = msg.info, np.asarray(msg.data, dtype=np.int8)
    numbers = float(info.resolution), float(info.origin.position.x), float(info.origin.position.y)
    if len(cells) != info.width * info.height or not len(cells) or not (np.abs(numbers) < _LARGEST).all() or numbers[0] <= 0.0:
        return None
    grid = np.where(cells >= _OCCUPIED, 100, cells).astype(np.int8)
    return Floor(grid.reshape(info.height, info.width), numbers[0], numbers[1:], topic)
