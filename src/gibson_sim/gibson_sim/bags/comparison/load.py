"""Reads the compared data from a bag. Message types come from the bag, which may be that of a real robot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison import topics as roles
from gibson_sim.bags.comparison.pictures import picture_statistics, thumbnail
from gibson_sim.bags.comparison.recorded_drive import (
    F64,
    Arrivals,
    Commands,
    ImuSamples,
    OccupancyMap,
    Pictures,
    PlanarTrack,
    RecordedDrive,
    Scans,
)
from gibson_sim.bags.comparison.timing import SAME_CLOCK_S
from gibson_sim.bags.reader import BagReader, TopicInfo, image_to_array
from gibson_sim.bags.stamps import stamp_ns, time_from_msg
from gibson_sim.errors import RecordError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, yaw_from_quat
from gibson_sim.sensors.image_codecs import decode_color
from gibson_sim.types import NS_PER_S, Pose

MOST_PICTURES = 200
"""Maximum number of images that are evaluated, evenly spaced over the recording."""
MOST_SCANS = 3000
"""Maximum number of scans that are evaluated, evenly spaced over the recording."""
LONGEST_S = 7 * 24 * 3600
"""Maximum duration of a recording, seconds; wrong stamps can make it years long."""
_OCCUPIED = 65
"""Minimum value of an occupied cell of an occupancy grid."""
_OPTIONAL_MAP = "map"


def load_recording(folder: Path, given: Mapping[str, str] | None = None) -> RecordedDrive:
    """Returns the content of a bag.

    Args:
        folder: Folder of the bag.
        given: Role -> topic, for names other than the usual ones.

    Raises:
        RecordError: the bag cannot be read.
        ConfigError: a given topic does not exist or has another type.
    """
    with BagReader(folder) as bag:
        infos = bag.topics()
        topics = roles.find_topics(infos, given or {}, str(folder))
        reading = _Reading(bag, infos, topics)
        reading.read()
        return reading.recording(folder)


class _Reading:
    """One pass over a bag."""

    def __init__(self, bag: BagReader, infos: Mapping[str, TopicInfo], topics: dict[str, str]) -> None:
        self._bag, self._infos, self._topics = bag, infos, topics
        self._rows: dict[str, list[Any]] = {role: [] for role in topics}
        self._log: dict[str, list[int]] = {topic: [] for topic in infos}
        self._stamps: dict[str, list[int]] = {topic: [] for topic in infos}
        self._fixed: dict[str, tuple[str, Mat4]] = {}
        """Child frame -> (parent frame, T_parent_child)."""
        self._map_from_odom: list[tuple[int, float, float, float]] = []
        self._frames: dict[str, str] = {}
        self.notes: list[str] = []
        self._strides = {
            role: max(1, -(-infos[topics[role]].count // most))
            for role, most in (("image", MOST_PICTURES), ("scan", MOST_SCANS))
            if role in topics
        }
        self._seen = dict.fromkeys(self._strides, 0)

    def read(self) -> None:
        """Reads all messages once; decodes only those of roles."""
        role_of = {topic: role for role, topic in self._topics.items()}
        readers = {
            "cmd_vel": self._command, "odom": self._odometry, "truth": self._truth, "imu": self._imu, "scan": self._scan,
            "map": self._map, "image": self._image,
        }  # fmt: skip
        for topic, log_ns, data in self._bag.raw_messages():
            info = self._infos[topic]
            self._log[topic].append(log_ns)
            if info.stamped:
                self._stamps[topic].append(stamp_ns(data))
            role = role_of.get(topic)
            if role in self._strides:
                self._seen[role] += 1
                if (self._seen[role] - 1) % self._strides[role]:
                    continue
            if role is not None:
                readers[role](log_ns, self._bag.decode(info.type_name, data))
            elif info.type_name == roles.TF and topic.rpartition("/")[2] in ("tf", "tf_static"):
                self._transforms(self._bag.decode(info.type_name, data), topic.endswith("tf_static"))

    def _command(self, log_ns: int, msg: Any) -> None:
        twist = getattr(msg, "twist", msg)
        self._rows["cmd_vel"].append((log_ns, twist.linear.x, twist.angular.z))

    def _odometry(self, log_ns: int, msg: Any) -> None:
        self._frames.setdefault("base", msg.child_frame_id)
        self._rows["odom"].append(_planar(msg.header.stamp, msg.pose.pose, msg.twist.twist))

    def _truth(self, log_ns: int, msg: Any) -> None:
        pose, twist = msg.pose, getattr(msg, "twist", None)
        pose = getattr(pose, "pose", pose)
        self._frames.setdefault("truth", msg.header.frame_id)
        self._rows["truth"].append(_planar(msg.header.stamp, pose, None if twist is None else twist.twist))

    def _imu(self, log_ns: int, msg: Any) -> None:
        w, a = msg.angular_velocity, msg.linear_acceleration
        self._rows["imu"].append((time_from_msg(msg.header.stamp), w.x, w.y, w.z, a.x, a.y, a.z))

    def _scan(self, log_ns: int, msg: Any) -> None:
        self._frames.setdefault("scan", msg.header.frame_id)
        self._rows["scan"].append((time_from_msg(msg.header.stamp), msg))

    def _map(self, log_ns: int, msg: Any) -> None:
        info = msg.info
        if len(msg.data) != info.width * info.height:
            self.notes.append(
                f"{self._topics['map']}: a map of {info.width}x{info.height} cells has {len(msg.data)} values: it is left out"
            )
            return
        occupied = np.asarray(msg.data, dtype=np.int16).reshape(info.height, info.width) >= _OCCUPIED
        origin = (float(info.origin.position.x), float(info.origin.position.y))
        self._rows["map"] = [OccupancyMap(occupied, float(info.resolution), origin)]

    def _image(self, log_ns: int, msg: Any) -> None:
        rgb = _rgb(msg)
        if rgb is not None:
            self._rows["image"].append((time_from_msg(msg.header.stamp), *picture_statistics(rgb), thumbnail(rgb)))

    def _transforms(self, msg: Any, fixed: bool) -> None:
        for one in msg.transforms:
            parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            t, q = one.transform.translation, one.transform.rotation
            if fixed:
                self._fixed[child] = (parent, matrix_from_pose(Pose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w))))
            elif child.rpartition("/")[2] == "odom" and parent.rpartition("/")[2] == "map":
                yaw = yaw_from_quat((q.x, q.y, q.z, q.w))
                self._map_from_odom.append((time_from_msg(one.header.stamp), t.x, t.y, yaw))

    def recording(self, folder: Path) -> RecordedDrive:
        """Returns the recording from the messages read."""
        begin = min((times[0] for times in [*self._log.values(), *self._stamps.values()] if times), default=0)
        stamps = [row[0] for role in ("odom", "truth", "imu", "scan") for row in self._rows.get(role, ())]
        if stamps:
            begin = min(stamps)
        log_end = max((times[-1] for times in self._log.values() if times), default=begin)
        log_begin = min((times[0] for times in self._log.values() if times), default=begin)
        odometry = self._track("odom", begin)
        truth = self._track("truth", begin) or self._truth_from_tf(odometry, begin)
        for role in roles.ROLES:
            if not self._rows.get(role.name) and not (role.name == "truth" and truth is not None):
                self.notes.append(
                    f"no {role.name} ({' or '.join(role.types)}): without it there is no comparison of {role.lacks}"
                )
        return RecordedDrive(
            path=folder, duration=(log_end - log_begin) / NS_PER_S, topics=dict(self._topics),
            commands=self._commands(begin), odometry=odometry, truth=truth, imu=self._imu_samples(begin),
            scans=self._scans(begin), map=(self._rows.get("map") or [None])[0], pictures=self._pictures(begin),
            arrivals=self._arrivals(), notes=tuple(self.notes),
        )  # fmt: skip

    def _arrivals(self) -> dict[str, Arrivals]:
        out = {}
        for topic, log in self._log.items():
            stamps = self._stamps[topic]
            if log and not self._infos[topic].latched:
                usable = len(stamps) == len(log) and any(stamps)
                out[topic] = Arrivals(np.array(log, dtype=np.int64), np.array(stamps, dtype=np.int64) if usable else None)
        return out

    def _commands(self, begin: int) -> Commands | None:
        rows = self._rows.get("cmd_vel")
        if not rows:
            return None
        values = np.array([row[1:] for row in rows], dtype=np.float64)
        times = self._on_stamp_clock(np.array([row[0] for row in rows], dtype=np.int64))
        return Commands((times - begin) / NS_PER_S, values[:, 0], values[:, 1])

    def _on_stamp_clock(self, log_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Converts log times to the clock of the stamps; the two differ if simulation time was recorded with wall time as log time."""
        topic = self._topics.get("odom", "")
        log, stamps = self._log.get(topic, []), self._stamps.get(topic, [])
        if len(log) < 2 or len(stamps) != len(log) or abs(np.median(np.subtract(log, stamps))) < SAME_CLOCK_S * NS_PER_S:
            return log_ns
        self.notes.append("log times and stamps are of different clocks: arrivals of cmd_vel are translated by those of odom")
        offset = np.interp(
            log_ns.astype(np.float64), np.array(log, dtype=np.float64), np.subtract(stamps, log).astype(np.float64)
        )
        return log_ns + np.rint(offset).astype(np.int64)

    def _track(self, role: str, begin: int) -> PlanarTrack | None:
        rows = self._rows.get(role)
        if not rows or len(rows) < 2:
            return None
        t, table = _in_order(rows, begin)
        x, y, yaw, linear, angular = table.T
        return PlanarTrack(t, x, y, np.unwrap(yaw), linear, angular, self._topics[role])

    def _truth_from_tf(self, odometry: PlanarTrack | None, begin: int) -> PlanarTrack | None:
        """Returns odometry in the map frame by a localiser's transform map -> odom; None = there is none."""
        if odometry is None or len(self._map_from_odom) < 2:
            return None
        t, table = _in_order(self._map_from_odom, begin)
        x, y, yaw = (np.interp(odometry.t, t, column) for column in (table[:, 0], table[:, 1], np.unwrap(table[:, 2])))
        cos, sin = np.cos(yaw), np.sin(yaw)
        nothing = np.full(len(odometry.t), np.nan)
        self._frames["truth"] = _OPTIONAL_MAP
        self.notes.append("the pose is that of a localisation (tf map -> odom): its own errors are in the drift")
        return PlanarTrack(
            odometry.t, x + cos * odometry.x - sin * odometry.y, y + sin * odometry.x + cos * odometry.y, yaw + odometry.yaw,
            nothing, nothing, "tf map -> odom",
        )  # fmt: skip

    def _imu_samples(self, begin: int) -> ImuSamples | None:
        rows = self._rows.get("imu")
        if not rows or len(rows) < 2:
            return None
        t, table = _in_order(rows, begin)
        return ImuSamples(t, table[:, :3], table[:, 3:])

    def _scans(self, begin: int) -> Scans | None:
        rows = self._rows.get("scan")
        if not rows or len(rows) < 2:
            return None
        first = rows[0][1]
        alike = [(stamp, msg) for stamp, msg in rows if len(msg.ranges) == len(first.ranges)]
        order = np.argsort([stamp for stamp, _ in alike], kind="stable")
        ranges = np.array([alike[i][1].ranges for i in order], dtype=np.float64)
        ranges[(ranges < first.range_min) | (ranges > first.range_max)] = np.inf
        mount, upside_down = self._mount()
        return Scans(
            (np.array([alike[i][0] for i in order]) - begin) / NS_PER_S, ranges, float(first.angle_min), float(first.angle_increment),
            float(first.range_min), float(first.range_max), mount, upside_down,
        )  # fmt: skip

    def _mount(self) -> tuple[tuple[float, float, float], bool]:
        """Returns x, y, yaw of the lidar in the base frame by the static transforms, and whether it is mounted upside down."""
        frame, base = self._frames.get("scan", "").lstrip("/"), self._frames.get("base", "").lstrip("/")
        T: Mat4 = np.eye(4)
        for _ in range(50):
            if frame == base or frame not in self._fixed:
                break
            frame, step = self._fixed[frame]
            T = step @ T
        if frame != base:
            self.notes.append(f"no fixed transform from {base or 'the base'} to the lidar's frame: it is taken to be at the base")
            return (0.0, 0.0, 0.0), False
        return (float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0]))), bool(T[2, 2] < 0.0)

    def _pictures(self, begin: int) -> Pictures | None:
        rows = self._rows.get("image")
        if not rows:
            return None
        stamps = np.array([row[0] for row in rows], dtype=np.int64)
        statistics, histograms = (np.array([row[i] for row in rows]) for i in (1, 2))
        return Pictures((stamps - begin) / NS_PER_S, statistics, histograms, tuple(row[3] for row in rows))


def _planar(stamp: Any, pose: Any, twist: Any) -> tuple[int, float, float, float, float, float]:
    q = pose.orientation
    linear, angular = (twist.linear.x, twist.angular.z) if twist is not None else (np.nan, np.nan)
    return time_from_msg(stamp), pose.position.x, pose.position.y, yaw_from_quat((q.x, q.y, q.z, q.w)), linear, angular


def _in_order(rows: list[Any], begin: int) -> tuple[F64, F64]:
    """Returns strictly increasing times since ``begin``, (N,), seconds, and the other columns, (N, C).

    Raises:
        RecordError: the stamps span more than ``LONGEST_S``.
    """
    stamps, first = np.unique(np.array([row[0] for row in rows], dtype=np.int64), return_index=True)
    if stamps[-1] - stamps[0] > LONGEST_S * NS_PER_S:
        raise RecordError(
            f"the stamps of a topic span {(stamps[-1] - stamps[0]) / NS_PER_S:.4g} s, at most {LONGEST_S:,} s are compared: "
            "check them (gibson-sim bag check)"
        )
    return (stamps - begin) / NS_PER_S, np.array([rows[i][1:] for i in first], dtype=np.float64)


def _rgb(msg: Any) -> NDArray[np.uint8] | None:
    """Returns the image as RGB; None = it cannot be read or is not a colour image."""
    if hasattr(msg, "format"):
        bgr = decode_color(bytes(msg.data))
        return None if bgr is None else bgr[:, :, ::-1]
    try:
        pixels = image_to_array(msg)
    except RecordError:
        return None
    if pixels.dtype != np.uint8:
        return None
    if pixels.ndim == 2:
        return np.repeat(pixels[:, :, None], 3, axis=2)
    return pixels[:, :, 2::-1] if msg.encoding.startswith("bgr") else pixels[:, :, :3]
