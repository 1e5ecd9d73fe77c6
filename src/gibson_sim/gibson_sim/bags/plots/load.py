"""Reads the plotted data from a bag, which may be that of a real robot, without ground truth and without a map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison import topics as roles
from gibson_sim.bags.plots.run_data import F64, Arrivals, Floor, RecordedRun, RobotRun, Track, Velocities
from gibson_sim.bags.plots.touches import Touch, TouchFinder, origin_ns, robot_bodies, robot_namespaces
from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.replaying import read_facts
from gibson_sim.errors import ConfigError, GibsonSimError, RecordError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest
from gibson_sim.types import NS_PER_S

_SAME_M = 0.005
"""Maximum distance of an estimate that counts as the ground truth, published as map -> odom, m."""
_MAP_HEIGHT = 0.5
"""Height above the floor up to which objects of a scene count as obstacles if the bag has no map, m."""
_LARGEST = 1e10
"""Maximum of coordinates, velocities and times that are drawn, SI units; larger values are damaged."""
_QUIET = ("/parameter_events", "/rosout")
"""Topics of every node that are not periodic."""
_LEAST_ARRIVALS = 3
"""Minimum number of messages for which the rate of a topic is shown."""


def load_run(folder: Path, robot: str = "") -> RecordedRun:
    """Returns the plotted data of a bag.

    Args:
        folder: folder of the bag.
        robot: namespace of the only robot to show; empty = all.

    Raises:
        RecordError: the bag cannot be read, or is empty.
        ConfigError: the bag has no such robot.
    """
    with BagReader(folder) as bag:
        infos = {name: info for name, info in bag.topics().items() if info.count}
        if not infos:
            raise RecordError(f"bag {folder} contains no messages: nothing to plot")
        names = robot_namespaces(infos)
        if robot and robot.strip("/") not in names:
            available = ", ".join(name for name in names if name) or "one without a namespace: leave --robot out"
            hint = nearest(robot, [name for name in names if name])
            raise ConfigError(f"--robot {quoted(robot)}: the bag has {available}{f'; {hint}' if hint else ''}")
        reading = _Reading(bag, infos, (robot.strip("/"),) if robot else names)
        reading.read()
        return reading.run()


class _RobotData:
    """Topics and data of one robot while the bag is read."""

    def __init__(self, name: str, infos: Mapping[str, TopicInfo]) -> None:
        self.name = name
        prefix = f"/{name}" if name else ""
        robot_infos = {topic.removeprefix(prefix): info for topic, info in infos.items() if topic.startswith(f"{prefix}/")}
        truths = [topic for topic in robot_infos if topic.rpartition("/")[0].endswith("/ground_truth")]
        # Among the other topics, the only odometry of a bag counts as wheel odometry, whatever its name.
        topics = roles.find_topics({topic: info for topic, info in robot_infos.items() if topic not in truths}, {}, "")
        role_of = {
            topics[role]: stored_as
            for role, stored_as in (("cmd_vel", "cmd_vel"), ("odom", "odom"), ("truth", "estimate"))
            if role in topics
        }
        role_of.update({topic: "truth" for topic in truths[:1] if robot_infos[topic].type_name in (roles.ODOMETRY, roles.POSE)})
        self.role_of = {prefix + topic: role for topic, role in role_of.items()}
        self.rows: dict[str, list[tuple[float, ...]]] = {
            "cmd_vel": [],
            "odom": [],
            "truth": [],
            "estimate": [],
            "map_from_odom": [],
        }
        self.odom_frame = self.map_frame = ""

    def topic(self, role: str) -> str:
        """Returns the topic of a role; empty = the bag has none."""
        return next((topic for topic, stored_as in self.role_of.items() if stored_as == role), "")


class _Reading:
    """One pass over a bag."""

    def __init__(self, bag: BagReader, infos: Mapping[str, TopicInfo], names: tuple[str, ...]) -> None:
        self._bag, self._infos = bag, infos
        self._origin_ns = origin_ns(bag)
        self._robots = [_RobotData(name, infos) for name in names]
        self._owner = {topic: (robot, role) for robot in self._robots for topic, role in robot.role_of.items()}
        self._touches = TouchFinder(infos, names, robot_bodies(bag, names))
        self._log: dict[str, list[int]] = {topic: [] for topic in infos}
        self._map_topic = _map_topic(infos)
        self._map: Any = None
        self._first_z: float | None = None
        """First true height of a robot, metres; None = the bag has no true pose."""
        self._notes: list[str] = []

    def read(self) -> None:
        """Reads all messages once; decodes only those that are plotted."""
        for topic, log_ns, data in self._bag.raw_messages():
            self._log[topic].append(log_ns)
            info, t = self._infos[topic], (log_ns - self._origin_ns) / NS_PER_S
            if topic in self._owner:
                self._add(*self._owner[topic], t, self._bag.decode(info.type_name, data))
            elif topic == self._map_topic:
                self._map = self._bag.decode(info.type_name, data)
            elif info.type_name == roles.TF and topic.rpartition("/")[2] in ("tf", "tf_static"):
                self._transforms(topic, t, self._bag.decode(info.type_name, data))
            elif self._touches.needs(topic):
                self._touches.add(topic, t, self._bag.decode(info.type_name, data))

    def _add(self, robot: _RobotData, role: str, t: float, msg: Any) -> None:
        if role == "cmd_vel":
            twist = getattr(msg, "twist", msg)
            robot.rows[role].append((t, twist.linear.x, twist.linear.y, twist.angular.z))
            return
        if role == "odom" and not robot.odom_frame:
            robot.odom_frame = msg.header.frame_id.lstrip("/")
        pose, twist = msg.pose, getattr(msg, "twist", None)
        pose = getattr(pose, "pose", pose)
        if role == "truth" and self._first_z is None and math.isfinite(pose.position.z):
            self._first_z = float(pose.position.z)
        q = pose.orientation
        v = (np.nan, np.nan, np.nan) if twist is None else (twist.twist.linear.x, twist.twist.linear.y, twist.twist.angular.z)
        robot.rows[role].append((t, pose.position.x, pose.position.y, yaw_from_quat((q.x, q.y, q.z, q.w)), *v))

    def _transforms(self, topic: str, t: float, msg: Any) -> None:
        """Stores the transforms map -> odom of each robot, identified by its namespace or the prefix of its frames."""
        for transform in msg.transforms:
            parent, child = transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")
            if parent.rpartition("/")[2] != "map" or child.rpartition("/")[2] != "odom":
                continue
            for robot in self._robots:
                if robot.name in ("", topic.rpartition("/")[0].strip("/"), child.rpartition("/")[0]):
                    translation, q = transform.transform.translation, transform.transform.rotation
                    robot.rows["map_from_odom"].append((t, translation.x, translation.y, yaw_from_quat((q.x, q.y, q.z, q.w))))

    def run(self) -> RecordedRun:
        """Returns the run from the messages read."""
        first_ns, last_ns = self._bag.span_ns
        touches = self._touches.touches()
        robots = tuple(self._robot(robot, touches) for robot in self._robots)
        floor = self._floor(robots)
        started = datetime.fromtimestamp(first_ns / NS_PER_S, timezone.utc)
        label = f"seconds since {started:%Y-%m-%d %H:%M:%S} UTC" if self._origin_ns else "simulation time, s"
        unlatched = [topic for topic, info in self._infos.items() if not info.latched and not topic.endswith(_QUIET)]
        arrivals = tuple(
            Arrivals(topic, (np.array(self._log[topic], dtype=np.int64) - self._origin_ns) / NS_PER_S)
            for topic in unlatched
            if len(self._log[topic]) >= _LEAST_ARRIVALS
        )
        return RecordedRun(
            self._bag.folder, (first_ns - self._origin_ns) / NS_PER_S, (last_ns - self._origin_ns) / NS_PER_S, label, robots, floor,
            bool(self._touches.topics), arrivals, tuple(self._notes),
        )  # fmt: skip

    def _robot(self, robot: _RobotData, touches: tuple[Touch, ...]) -> RobotRun:
        odometry, truth = _track(robot, "odom"), _track(robot, "truth")
        estimate = _track(robot, "estimate") or _by_transforms(robot, odometry)
        if truth is not None and estimate is not None and _distance(truth, estimate) < _SAME_M:
            estimate = None
        onto = truth or estimate
        if odometry is not None and onto is not None:
            odometry = odometry.laid_onto(onto)
        return RobotRun(
            robot.name, truth, odometry, estimate, _commands(robot), _velocities(robot, "odom"), _velocities(robot, "truth"),
            tuple(touch for touch in touches if touch.robot == robot.name),
        )  # fmt: skip

    def _floor(self, robots: tuple[RobotRun, ...]) -> Floor | None:
        """Returns the map of the bag, else that of its scene; None if no pose in the map is known."""
        if not any(robot.truth or robot.estimate for robot in robots):
            if self._map is not None:
                self._notes.append(
                    "the map is left out: the bag has neither a true pose nor that of a localiser, so the pose of the odometry in it is unknown"
                )
            return None
        if self._map is None:
            return self._floor_of_scene()
        info, cells = self._map.info, np.asarray(self._map.data, dtype=np.int8)
        geometry = float(info.resolution), float(info.origin.position.x), float(info.origin.position.y)
        if (
            len(cells) != info.width * info.height
            or not len(cells)
            or not _is_sane(np.array(geometry)).all()
            or geometry[0] <= 0.0
        ):
            self._notes.append(
                f"the map is left out: {self._map_topic} has {info.width}x{info.height} cells of {geometry[0]:g} m, and values for {len(cells)}"
            )
            return None
        return Floor(cells.reshape(info.height, info.width), geometry[0], geometry[1:], self._map_topic)

    def _floor_of_scene(self) -> Floor | None:
        name = str(read_facts(self._bag.folder).settings.get("physics", {}).get("scene", ""))
        if not name:
            return None
        # Imported only when needed: most bags have a map.
        from gibson_sim.maps.floor_map import floor_name, scene_floor_map, with_floor_at
        from gibson_sim.scenes.load import load_scene

        try:
            scene = load_scene(name)
            scene = with_floor_at(scene, scene.floor_z if self._first_z is None else self._first_z)
            floor = scene_floor_map(scene, robot_height=_MAP_HEIGHT)
        except GibsonSimError as error:
            self._notes.append(f"there is no map: the bag has none, and that of its scene cannot be computed ({error})")
            return None
        cells = np.where(floor.occupied, 100, np.where(floor.floor, 0, -1)).astype(np.int8)
        return Floor(cells, floor.resolution, floor.origin, ", ".join(filter(None, (f"scene {name}", floor_name(scene)))))


def _map_topic(infos: Mapping[str, TopicInfo]) -> str:
    """Returns the topic of the map: ``/map``, else the only grid that is not a costmap; empty = there is none."""
    grids = [name for name, info in infos.items() if info.type_name == roles.MAP and "costmap" not in name]
    if "/map" in grids:
        return "/map"
    return grids[0] if len(grids) == 1 else ""


def _is_sane(values: F64) -> NDArray[np.bool_]:
    """Returns a mask of the values that are finite and smaller than ``_LARGEST``."""
    return np.asarray(np.isfinite(values) & (np.abs(values) < _LARGEST))


def _table(rows: list[tuple[float, ...]]) -> F64 | None:
    """Returns the rows with valid poses as an array, (N, C), sorted by strictly increasing time; None if there are fewer than two."""
    if len(rows) < 2:
        return None
    table = np.array(rows, dtype=np.float64)
    table = table[_is_sane(table[:, :4]).all(axis=1)]
    _, first = np.unique(table[:, 0], return_index=True)
    return table[first] if len(first) > 1 else None


def _track(robot: _RobotData, role: str) -> Track | None:
    table = _table(robot.rows[role])
    if table is None:
        return None
    return Track(table[:, 0], table[:, 1], table[:, 2], np.unwrap(table[:, 3]), robot.topic(role))


def _velocities(robot: _RobotData, role: str) -> Velocities | None:
    table = _table(robot.rows[role])
    if table is not None:
        table = table[_is_sane(table[:, 4:]).all(axis=1)]
    if table is None or not len(table):
        return None
    return Velocities(table[:, 0], table[:, 4], table[:, 5], table[:, 6], robot.topic(role))


def _commands(robot: _RobotData) -> Velocities | None:
    table = np.array(robot.rows["cmd_vel"], dtype=np.float64).reshape(-1, 4)
    table = table[_is_sane(table).all(axis=1)]
    if not len(table):
        return None
    return Velocities(table[:, 0], table[:, 1], table[:, 2], table[:, 3], robot.topic("cmd_vel"))


def _by_transforms(robot: _RobotData, odometry: Track | None) -> Track | None:
    """Returns odometry in the map frame by a localiser's transforms map -> odom; None = there are none."""
    rows = robot.rows["map_from_odom"]
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    table = table[_is_sane(table).all(axis=1)]
    if odometry is None or not len(table):
        return None
    is_known = odometry.t >= table[0, 0]
    if np.count_nonzero(is_known) < 2:
        return None
    rows_at = np.searchsorted(table[:, 0], odometry.t[is_known], side="right") - 1
    x, y, yaw = table[rows_at, 1], table[rows_at, 2], np.unwrap(table[:, 3])[rows_at]
    c, s = np.cos(yaw), np.sin(yaw)
    ox, oy = odometry.x[is_known], odometry.y[is_known]
    return Track(odometry.t[is_known], x + c * ox - s * oy, y + s * ox + c * oy, odometry.yaw[is_known] + yaw, "tf map -> odom")


def _distance(a: Track, b: Track) -> float:
    """Returns the maximum distance between two tracks at common times, metres; infinite if they do not overlap in time."""
    t = b.t[(b.t >= a.t[0]) & (b.t <= a.t[-1])]
    if not len(t):
        return float("inf")
    x, y = np.interp(t, b.t, b.x) - np.interp(t, a.t, a.x), np.interp(t, b.t, b.y) - np.interp(t, a.t, a.y)
    return float(np.hypot(x, y).max())
