"""Checks a bag: agreement of stamps, missing messages, and wheel odometry against ground truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.stamps import header_stamp_ns, nominal_period_ns, stamp_ns
from gibson_sim.errors import RecordError
from gibson_sim.geometry.transforms import wrap_angle, yaw_from_quat
from gibson_sim.types import NS_PER_S

IMAGE = "sensor_msgs/msg/Image"
ODOMETRY = "nav_msgs/msg/Odometry"
CLOCK = "rosgraph_msgs/msg/Clock"
TF = "tf2_msgs/msg/TFMessage"
ONE_SOURCE = (
    IMAGE,
    ODOMETRY,
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/Imu",
    "gibson_msgs/msg/SceneState",
    CLOCK,
)
"""Types whose topics have one publisher, so that their stamps must increase. Others (/rosout, /diagnostics) mix several."""

Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TopicReport:
    """Timing of one topic by its stamps; all zero if its messages have none."""

    info: TopicInfo
    first_ns: int = 0
    last_ns: int = 0
    rate_hz: float = 0.0
    """Messages a second of simulation time, from the nominal period."""
    missing: int = 0
    """Messages missing by the nominal period."""


@dataclass(frozen=True, slots=True)
class OdometryReport:
    """Wheel odometry against ground truth, between the first and the last common stamp."""

    distance_m: float
    """Length of the true path."""
    odometry_distance_m: float
    """Length of the path by wheel odometry."""
    end_error_m: float
    """Distance between the final positions by odometry and in truth, each relative to its start."""
    end_error_deg: float
    """Absolute difference of the final headings, degrees."""

    @property
    def end_error_percent(self) -> float:
        """Final position error, % of the path length; 0 if the robot stood still."""
        return 100.0 * self.end_error_m / self.distance_m if self.distance_m > 1e-6 else 0.0


@dataclass(frozen=True, slots=True)
class BagReport:
    """The result of ``check_bag``."""

    folder: Path
    topics: tuple[TopicReport, ...]
    problems: tuple[str, ...]
    """Errors; empty = the stamps agree."""
    notes: tuple[str, ...]
    """Findings that are not errors."""
    odometry: OdometryReport | None
    """None if one of the odometry topics is missing."""

    @property
    def ok(self) -> bool:
        """Whether the stamps agree."""
        return not self.problems

    def text(self) -> str:
        """Returns the report for a terminal."""
        rows = [_COLUMNS, *map(_row, self.topics)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(_COLUMNS))]
        lines = [f"bag {self.folder}", ""]
        for row in rows:
            lines.append("  ".join([row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in range(1, len(row)))]))
        return "\n".join([*lines, "", *self._findings()])

    def markdown(self) -> str:
        """Returns the report as Markdown."""
        rows = [_COLUMNS, ("---", *["---:"] * (len(_COLUMNS) - 1)), *map(_row, self.topics)]
        table = [f"| {' | '.join(row)} |" for row in rows]
        return "\n".join([f"## Bag `{self.folder}`", "", *table, "", *[f"- {line}" for line in self._findings()], ""])

    def _findings(self) -> list[str]:
        lines = []
        if self.odometry is not None:
            o = self.odometry
            lines.append(
                f"odometry: {o.distance_m:.3f} m driven ({o.odometry_distance_m:.3f} m by the wheels), "
                f"end error {o.end_error_m:.3f} m ({o.end_error_percent:.2f} %) and {o.end_error_deg:.2f} deg"
            )
        lines += [f"note: {note}" for note in self.notes]
        lines += [f"PROBLEM: {problem}" for problem in self.problems]
        return [*lines, "stamps agree" if self.ok else f"{len(self.problems)} problems"]


_COLUMNS = ("topic", "messages", "rate (Hz)", "missing", "first (s)", "last (s)")


def _row(topic: TopicReport) -> tuple[str, ...]:
    count = str(topic.info.count)
    if not topic.info.stamped or not topic.info.count:
        return (topic.info.name, count, "-", "-", "-", "-")
    rate, missing = (f"{topic.rate_hz:.2f}", str(topic.missing)) if topic.rate_hz else ("-", "-")
    return (topic.info.name, count, rate, missing, f"{topic.first_ns / NS_PER_S:.3f}", f"{topic.last_ns / NS_PER_S:.3f}")


@dataclass(slots=True)
class _Collected:
    """Data collected in one pass over the bag."""

    stamps: dict[str, Stamps] = field(default_factory=dict)
    tf_stamps: dict[str, list[int]] = field(default_factory=dict)
    """By topic and child frame, since a topic has several publishers."""
    poses: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """x, y, yaw (N, 3) of odometry topics, in their own frame."""


def check_bag(folder: str | Path) -> BagReport:
    """Reads a whole bag and checks it.

    An image must carry the stamp of an odometry message and of its camera_info, and stamps must strictly increase. Images
    before the first or after the last odometry message (recording began or ended between them) are notes.

    Raises:
        RecordError: the bag cannot be read.
    """
    with BagReader(folder) as bag:
        infos = bag.topics()
        if not any(info.count for info in infos.values()):
            raise RecordError(f"bag {folder} holds no messages: nothing can be checked")
        data = _collect(bag, infos)
    problems = _order_problems(infos, data)
    notes: list[str] = []
    for topic, info in infos.items():
        if info.type_name == IMAGE and info.count:
            partners = _partners(topic, infos)
            for partner in partners:
                if not (len(data.stamps[topic]) and len(data.stamps[partner])):
                    problems.append(
                        f"{topic if len(data.stamps[partner]) else partner}: the index of the bag lists messages that are not there"
                    )
                    continue
                _compare(topic, partner, data.stamps[topic], data.stamps[partner], problems, notes)
            notes += [f"{topic}: the bag has no {what}" for what in _lacking(topic, partners)]
    reports = tuple(_topic_report(info, data.stamps.get(topic)) for topic, info in infos.items())
    notes += [f"{r.info.name}: {r.missing} messages are missing" for r in reports if r.missing and r.info.type_name in ONE_SOURCE]
    return BagReport(Path(folder), reports, tuple(problems), tuple(notes), _odometry(infos, data))


def _collect(bag: BagReader, infos: dict[str, TopicInfo]) -> _Collected:
    stamps: dict[str, list[int]] = {topic: [] for topic, info in infos.items() if info.stamped}
    poses: dict[str, list[tuple[float, float, float]]] = {t: [] for t, info in infos.items() if info.type_name == ODOMETRY}
    data = _Collected()
    for topic, _, raw in bag.raw_messages():
        if topic in stamps:
            stamps[topic].append(stamp_ns(raw))
        if topic in poses:
            poses[topic].append(_planar(bag.decode(ODOMETRY, raw).pose.pose))
        elif infos[topic].type_name == TF and not infos[topic].latched:
            for transform in bag.decode(TF, raw).transforms:
                key = f"{topic} to {transform.child_frame_id}"
                data.tf_stamps.setdefault(key, []).append(header_stamp_ns(transform.header.stamp))
    data.stamps = {topic: np.array(values, dtype=np.int64) for topic, values in stamps.items()}
    data.poses = {topic: np.array(values, dtype=np.float64).reshape(-1, 3) for topic, values in poses.items()}
    return data


def _planar(pose: Any) -> tuple[float, float, float]:
    q = pose.orientation
    return float(pose.position.x), float(pose.position.y), yaw_from_quat((q.x, q.y, q.z, q.w))


def _order_problems(infos: dict[str, TopicInfo], data: _Collected) -> list[str]:
    series: dict[str, Iterable[int]] = dict(data.tf_stamps)
    for topic, stamps in data.stamps.items():
        if infos[topic].type_name in ONE_SOURCE and not infos[topic].latched:
            series[topic] = stamps
    problems = []
    for name, values in series.items():
        times = np.asarray(values, dtype=np.int64)
        wrong = np.flatnonzero(np.diff(times) <= 0)
        if len(wrong):
            a, b = times[wrong[0]] / NS_PER_S, times[wrong[0] + 1] / NS_PER_S
            problems.append(f"{name}: {len(wrong)} stamps do not rise, first {a:.9f} s is followed by {b:.9f} s")
    return problems


def _partners(topic: str, infos: dict[str, TopicInfo]) -> list[str]:
    """Returns the topics of the bag whose stamps an image must share."""
    candidates = [_odometry_topic(topic, infos), topic.rpartition("/")[0] + "/camera_info"]
    return [c for c in candidates if c in infos and infos[c].count]


def _odometry_topic(topic: str, infos: dict[str, TopicInfo]) -> str:
    """Returns the wheel odometry with the longest namespace that the image shares: ``/odom`` or ``/robot1/odom``."""
    found = [
        t for t, i in infos.items() if i.type_name == ODOMETRY and t.endswith("/odom") and not t.endswith("ground_truth/odom")
    ]
    inside = [t for t in found if topic.startswith(t.removesuffix("odom"))]
    return max(inside, key=len, default="")


def _lacking(topic: str, partners: list[str]) -> list[str]:
    lacking = [] if any(p.endswith("/odom") for p in partners) else ["odometry to compare its stamps with"]
    return lacking if any(p.endswith("/camera_info") for p in partners) else [*lacking, "camera_info of it"]


def _compare(topic: str, partner: str, images: Stamps, others: Stamps, problems: list[str], notes: list[str]) -> None:
    inside = (images >= others.min()) & (images <= others.max())
    alone = images[inside & ~np.isin(images, others)]
    if len(alone):
        problems.append(f"{topic}: {len(alone)} of {len(images)} stamps are not in {partner}, first {alone[0] / NS_PER_S:.9f} s")
    if not inside.any():
        problems.append(f"{topic}: no image lies in the time of {partner}")
    elif not inside.all():
        notes.append(f"{topic}: {np.count_nonzero(~inside)} images lie before the first or after the last message of {partner}")


def _topic_report(info: TopicInfo, stamps: Stamps | None) -> TopicReport:
    if stamps is None or not len(stamps):
        return TopicReport(info)
    first, last = int(stamps.min()), int(stamps.max())
    period = nominal_period_ns(stamps)
    if not period or info.latched or info.type_name == CLOCK:  # the clock also comes with whatever else is published
        return TopicReport(info, first, last)
    # A step is rounded to whole periods: 2 periods = 1 missing.
    missing = np.maximum(np.rint(np.diff(stamps) / period).astype(np.int64) - 1, 0).sum()
    return TopicReport(info, first, last, NS_PER_S / period, int(missing))


def _odometry(infos: dict[str, TopicInfo], data: _Collected) -> OdometryReport | None:
    wheels = _odometry_topic("/", infos) or next((t for t in infos if t in data.poses and "ground_truth" not in t), "")
    truth = wheels.removesuffix("odom") + "ground_truth/odom"
    if not wheels or truth not in data.poses:
        return None
    common, at_wheels, at_truth = np.intersect1d(data.stamps[wheels], data.stamps[truth], return_indices=True)
    if len(common) < 2:
        return None
    told, true = data.poses[wheels][at_wheels], data.poses[truth][at_truth]
    x, y, yaw = _seen_from_start(told) - _seen_from_start(true)
    return OdometryReport(
        distance_m=_length(true),
        odometry_distance_m=_length(told),
        end_error_m=float(np.hypot(x, y)),
        end_error_deg=abs(float(np.degrees(wrap_angle(float(yaw))))),
    )


def _seen_from_start(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns x, y, yaw (3,) of the last pose in the frame of the first one."""
    dx, dy, turn = poses[-1] - poses[0]
    c, s = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    return np.array([c * dx + s * dy, c * dy - s * dx, turn])


def _length(poses: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum())
