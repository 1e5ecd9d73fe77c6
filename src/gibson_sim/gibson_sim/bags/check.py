"""Checks a bag: agreement of stamps, missing messages, contacts, and wheel odometry against ground truth.

It determines which topics are periodic, and the number of their missing messages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.images.decode import COMPRESSED, IMAGE, IMAGE_TYPES, base_topic
from gibson_sim.bags.metadata import REPAIRED, read_metadata
from gibson_sim.bags.plots.touches import Touch, TouchFinder, origin_ns, robot_bodies, robot_namespaces
from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.rerender import SCENE_TYPE, STATE_TYPE, state_period_ns
from gibson_sim.bags.stamps import nominal_period_ns, stamp_ns, time_from_msg
from gibson_sim.errors import RecordError
from gibson_sim.geometry.transforms import wrap_angle, yaw_from_quat
from gibson_sim.sensors.schedule import images_due
from gibson_sim.types import NS_PER_S

ODOMETRY = "nav_msgs/msg/Odometry"
CLOCK = "rosgraph_msgs/msg/Clock"
TF = "tf2_msgs/msg/TFMessage"
ONE_SOURCE = (
    IMAGE,
    COMPRESSED,
    ODOMETRY,
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/Imu",
    "gibson_msgs/msg/SceneState",
    CLOCK,
)
"""Types whose topics have one publisher, so that their stamps must increase. Others (/rosout, /diagnostics) mix several."""
NO_RATE = ("rcl_interfaces/msg/ParameterEvent", "rcl_interfaces/msg/Log", "diagnostic_msgs/msg/DiagnosticArray")
"""Types whose messages are sent on events, by many nodes: their topics have no rate."""
Stamps = NDArray[np.int64]
_LEAST = 5
"""Minimum number of messages for which a topic can have a rate."""
_REGULAR_SHARE = 0.8
"""Minimum share of intervals within half a period of one period, for a topic with a rate."""
_EVENT_TYPES = (
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "gibson_msgs/msg/Input",
    "gibson_msgs/msg/TickDone",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rosgraph_msgs/msg/Clock",
)
"""Types sent on events, or by several nodes: none of their messages count as missing. /clock also comes with whatever else is published."""
_EVENT_PACKAGES = ("rcl_interfaces/", "action_msgs/", "lifecycle_msgs/", "trajectory_msgs/", "visualization_msgs/")
_FOREIGN_NS = 24 * 3600 * NS_PER_S
"""Minimum difference between stamps and log times for which they are of different clocks, ns."""
_LEAST_RATE = 1e-3
"""Smallest rate of a sensor, Hz."""
_CAMERA_TOPICS = ("/image_raw", "/camera_info", "/points")
"""Endings of the topics that have a message for each image of a camera."""


@dataclass(frozen=True, slots=True)
class TopicReport:
    """Timing of one topic, by its stamps if it has any of the bag's clock, else by the times of its recording."""

    info: TopicInfo
    first_ns: int = 0
    last_ns: int = 0
    """Both 0 if the topic has no message."""
    rate_hz: float = 0.0
    """Message rate in simulation time, Hz: the camera's, if the bag has it, else that of the received messages; 0 = the topic has no rate."""
    missing: int | None = None
    """Messages missing at this rate, between the first and the last; None = unknown, for topics without a rate or without stamps, and for
    camera_info without its images: both are published only while the images have subscribers."""
    is_rate_known: bool = False
    """Whether the rate is that of the recorded camera."""


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
    robot: str = ""
    """Namespace of the robot's topics; empty for a single robot."""

    @property
    def end_error_percent(self) -> float:
        """Final position error, % of the path length; 0 if the robot stood still."""
        return 0.0 if self.stood else 100.0 * self.end_error_m / self.distance_m

    @property
    def stood(self) -> bool:
        """Whether the robot stood still, apart from settling on its wheels."""
        return self.distance_m < _STOOD_M

    def text(self) -> str:
        """Returns the report as a sentence."""
        slip = self.odometry_distance_m - self.distance_m
        slipped = abs(slip) > max(_SLIP_M, _SLIP_PART * self.distance_m)
        share = "" if self.stood else f" ({self.end_error_percent:.2f} % of the path length)"
        return (
            f"odometry{f' of {self.robot}' if self.robot else ''}: {self.distance_m:.3f} m driven, {self.odometry_distance_m:.3f} m by "
            f"odometry{' (wheel slip)' if slipped else ''}; final error {self.end_error_m:.3f} m{share} "
            f"and {self.end_error_deg:.2f} deg"
        )


@dataclass(frozen=True, slots=True)
class BagReport:
    """The result of ``check_bag``."""

    folder: Path
    topics: tuple[TopicReport, ...]
    problems: tuple[str, ...]
    """Errors; empty = the stamps agree."""
    notes: tuple[str, ...]
    """Findings that are not errors."""
    odometries: tuple[OdometryReport, ...] = ()
    """Report of each robot with wheel odometry and ground truth."""
    touches: tuple[Touch, ...] = ()
    """Contacts of the robots, ordered by time."""
    seconds: float = 0.0
    """Time between the first and the last message."""
    compared: tuple[str, ...] = ()
    """Topics with which the stamps of every image were compared."""

    @property
    def ok(self) -> bool:
        """Whether the stamps agree."""
        return not self.problems

    @property
    def odometry(self) -> OdometryReport | None:
        """The report of the first robot; None if one of the odometry topics is missing."""
        return self.odometries[0] if self.odometries else None

    def text(self) -> str:
        """Returns the report for a terminal."""
        rows = [_COLUMNS, *map(_row, self.topics)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(_COLUMNS))]
        count = sum(topic.info.count for topic in self.topics)
        lines = [f"bag {self.folder}: {self.seconds:.2f} s, {count} messages on {len(self.topics)} topics", ""]
        for row in rows:
            lines.append("  ".join([row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in range(1, len(row)))]))
        return "\n".join([*lines, "", *self._legend(), *self.findings()])

    def markdown(self) -> str:
        """Returns the report as Markdown."""
        rows = [_COLUMNS, ("---", *["---:"] * (len(_COLUMNS) - 1)), *map(_row, self.topics)]
        table = [f"| {' | '.join(row)} |" for row in rows]
        return "\n".join(
            [f"## Bag `{self.folder}`", "", *table, "", *[f"- {line}" for line in [*self._legend(), *self.findings()]], ""]
        )

    def _legend(self) -> list[str]:
        """Returns the legend of dashes in the table, if there are any."""
        lacks = any(topic.info.count and not (topic.rate_hz and topic.missing is not None) for topic in self.topics)
        return [_LEGEND] if lacks else []

    def findings(self) -> list[str]:
        """Returns the findings, one line each: motion and contacts of the robots, notes, problems, and the verdict."""
        lines = [odometry.text() for odometry in self.odometries]
        shown = self.touches[:_MOST_TOUCHES]
        lines += [f"contact: {touch.text()}" for touch in shown]
        if more := len(self.touches) - len(shown):
            lines.append(f"contact: {more} more")
        lines += [f"note: {note}" for note in self.notes]
        lines += [f"PROBLEM: {problem}" for problem in self.problems]
        return [*lines, self._verdict()]

    def _verdict(self) -> str:
        if self.ok:
            images = f"each image has that of {' and of '.join(self.compared)}; " if self.compared else ""
            return f"stamps agree: {images}none goes back in time"
        more = f" (and {_counted(len(self.problems) - 1, 'more problem')} above)" if len(self.problems) > 1 else ""
        return f"FAILED: stamps do not agree: {self.problems[0]}{more}"


_COLUMNS = ("topic", "messages", "rate (Hz)", "missing", "first (s)", "last (s)")
_LEGEND = (
    "rate -: messages come with events, from several nodes, or seldom (/clock: beside every other message); "
    "missing -: not counted without a rate, nor for camera_info without its images"
)
_MOST_TOUCHES = 20
"""Maximum number of contacts that a report lists."""
_STOOD_M = 0.01
"""Path length below which the robot counts as standing still, metres."""
_SLIP_M, _SLIP_PART = 0.05, 0.05
"""Difference of the path lengths above which wheel slip is reported, metres, and as a fraction of the true length."""


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _row(topic: TopicReport) -> tuple[str, ...]:
    rate = f"{topic.rate_hz:.2f}" if topic.rate_hz else "-"
    missing = "-" if topic.missing is None else str(topic.missing)
    times = [f"{time_ns / NS_PER_S:.3f}" if topic.info.count else "-" for time_ns in (topic.first_ns, topic.last_ns)]
    return (topic.info.name, str(topic.info.count), rate, missing, *times)


@dataclass(slots=True)
class _Collected:
    """Data collected in one pass over the bag."""

    stamps: dict[str, Stamps] = field(default_factory=dict)
    log_ns: dict[str, Stamps] = field(default_factory=dict)
    touches: tuple[Touch, ...] = ()
    tf_stamps: dict[str, list[int]] = field(default_factory=dict)
    """Topic and child frame -> stamps, since a transform topic has several publishers."""
    poses: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Odometry topic -> poses x, y, yaw, (N, 3), in its frame."""


def check_bag(folder: str | Path) -> BagReport:
    """Reads a whole bag and checks it.

    An image must have the stamp of an odometry message and of its camera_info, and stamps must strictly increase. Images
    before the first or after the last odometry message (the recording began or ended between them) are reported as notes.

    Raises:
        RecordError: the bag cannot be read.
    """
    with BagReader(folder) as bag:
        infos = bag.topics()
        if not any(info.count for info in infos.values()):
            raise RecordError(f"bag {folder} holds no messages: nothing can be checked")
        data, rates = _collect(bag, infos), _camera_rates(bag)
        first_ns, last_ns = bag.span_ns
    problems = _order_problems(infos, data)
    notes = _repair_notes(Path(folder))
    compared = dict.fromkeys(("its camera_info", "an odometry"), 0)
    images = [topic for topic, info in infos.items() if info.type_name in IMAGE_TYPES and info.count]
    for topic in images:
        if topic not in data.stamps:
            problems.append(
                f"{topic}: the bag defines {infos[topic].type_name} without a header, so that its images have no stamps"
            )
            continue
        partners = [partner for partner in _partners(topic, infos) if partner in data.stamps]
        for partner in partners:
            if not (len(data.stamps[topic]) and len(data.stamps[partner])):
                problems.append(
                    f"{topic if len(data.stamps[partner]) else partner}: the index of the bag lists messages that do not exist"
                )
            elif _compare(topic, partner, data, problems, notes):
                compared["its camera_info" if partner.endswith("/camera_info") else "an odometry"] += 1
        notes += [f"{topic}: the bag has no {what}" for what in _lacking(topic, partners)]
    reports = tuple(
        _topic_report(info, data.stamps.get(topic), data.log_ns[topic], images, _camera_rate_of(topic, rates))
        for topic, info in infos.items()
    )
    notes += _missing_notes(reports)
    odometries = tuple(found for robot in robot_namespaces(infos) if (found := _odometry(robot, infos, data)) is not None)
    seconds = (last_ns - first_ns) / NS_PER_S
    of_all = tuple(what for what, count in compared.items() if images and count == len(images))
    return BagReport(Path(folder), reports, tuple(problems), tuple(notes), odometries, data.touches, seconds, of_all)


def _collect(bag: BagReader, infos: dict[str, TopicInfo]) -> _Collected:
    stamps: dict[str, list[int]] = {topic: [] for topic, info in infos.items() if info.stamped}
    log_times: dict[str, list[int]] = {topic: [] for topic in infos}
    poses: dict[str, list[tuple[float, float, float]]] = {t: [] for t, info in infos.items() if info.type_name == ODOMETRY}
    data = _Collected()
    robots, begin_ns = robot_namespaces(infos), origin_ns(bag)
    touches = TouchFinder(infos, robots, robot_bodies(bag, robots))
    for topic, log_ns, raw in bag.raw_messages():
        log_times[topic].append(log_ns)
        if topic in stamps:
            stamps[topic].append(stamp_ns(raw))
        if topic in poses:
            poses[topic].append(_planar(bag.decode(ODOMETRY, raw).pose.pose))
        elif infos[topic].type_name == TF and not infos[topic].latched:
            for transform in bag.decode(TF, raw).transforms:
                key = f"{topic} to {transform.child_frame_id}"
                data.tf_stamps.setdefault(key, []).append(time_from_msg(transform.header.stamp))
        elif touches.needs(topic):
            touches.add(topic, (log_ns - begin_ns) / NS_PER_S, bag.decode(infos[topic].type_name, raw))
    data.stamps = {topic: np.array(values, dtype=np.int64) for topic, values in stamps.items()}
    data.log_ns = {topic: np.array(values, dtype=np.int64) for topic, values in log_times.items()}
    data.poses = {topic: np.array(values, dtype=np.float64).reshape(-1, 3) for topic, values in poses.items()}
    data.touches = touches.touches()
    return data


def _repair_notes(folder: Path) -> list[str]:
    """Returns a note on what was lost when the bag was repaired, if it was."""
    custom = read_metadata(folder).get("custom_data")
    mark = custom.get(REPAIRED) if isinstance(custom, dict) else None
    return [f"the bag was repaired: {' '.join(str(mark).split()):.300}"] if mark else []


def _missing_notes(reports: Iterable[TopicReport]) -> list[str]:
    """Returns a note for each number of missing messages: the topics of one camera lack the same messages."""
    alike: dict[tuple[int, int, str], list[str]] = {}
    for report in reports:
        if report.missing and report.info.type_name in ONE_SOURCE:
            rate = f"{report.rate_hz:g} Hz" if report.is_rate_known else "the rate of the received ones"
            alike.setdefault((report.missing, report.info.count, rate), []).append(report.info.name)
    notes = []
    for (missing, count, rate), topics in alike.items():
        images = [topic for topic in topics if not topic.endswith("/camera_info")]  # these come with images
        why = (
            ": the renderer skips images that it cannot draw in time, or failed to draw (see the summary and the log of the run)"
            if any("image" in topic for topic in images)
            else ""
        )
        notes.append(f"{missing} of {missing + count} messages are missing on {', '.join(images or topics)}, at {rate}{why}")
    return notes


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
    """Returns the topics of the bag that must contain the stamps of an image."""
    candidates = [_odometry_topic(topic, infos), base_topic(topic).rpartition("/")[0] + "/camera_info"]
    return [c for c in candidates if c in infos and infos[c].count]


def _odometry_topic(topic: str, infos: dict[str, TopicInfo]) -> str:
    """Returns the wheel odometry with the longest namespace that the image shares: ``/odom`` or ``/robot1/odom``."""
    candidates = [
        t for t, i in infos.items() if i.type_name == ODOMETRY and t.endswith("/odom") and not t.endswith("ground_truth/odom")
    ]
    inside = [t for t in candidates if topic.startswith(t.removesuffix("odom"))]
    return max(inside, key=len, default="")


def _lacking(topic: str, partners: list[str]) -> list[str]:
    lacking = [] if any(p.endswith("/odom") for p in partners) else ["odometry to compare its stamps with"]
    return lacking if any(p.endswith("/camera_info") for p in partners) else [*lacking, "camera_info of it"]


def _compare(topic: str, partner: str, data: _Collected, problems: list[str], notes: list[str]) -> bool:
    """Compares the stamps of images with those of another topic; returns whether any could be compared."""
    images, others = data.stamps[topic], data.stamps[partner]
    inside = (images >= others.min()) & (images <= others.max())
    alone = images[inside & ~np.isin(images, others)]
    if not partner.endswith("/camera_info"):  # of which each image has one of its own
        in_gap = _is_in_gap(alone, others)
        if lost := int(np.count_nonzero(in_gap)):
            notes.append(
                f"{topic}: {lost} of {len(images)} stamps cannot be compared, since messages of {partner} are missing there"
            )
        alone = alone[~in_gap]
    if len(alone):
        problems.append(f"{topic}: {len(alone)} of {len(images)} stamps are not in {partner}, first {alone[0] / NS_PER_S:.9f} s")
    if inside.all():
        return True
    number = int(np.count_nonzero(~inside))
    outside = (
        f"{_counted(number, 'image')} {'lies' if number == 1 else 'lie'} before the first or after the last message of {partner}"
    )
    if inside.any():
        notes.append(f"{topic}: {outside}")
    elif all(_is_of_this_clock(data.stamps[t], data.log_ns[t]) for t in (topic, partner)):
        # A recorder subscribes to its topics one by one: a short recording has few messages of each topic, at different times.
        notes.append(f"{topic}: all of its {outside}, so that their stamps cannot be compared")
    else:
        problems.append(
            f"{topic}: its stamps ({_span(images)}) and those of {partner} ({_span(others)}) are of different clocks; set use_sim_time alike "
            "in the nodes that publish them"
        )
    return bool(inside.any())


def _is_in_gap(stamps: Stamps, others: Stamps) -> NDArray[np.bool_]:
    """Returns for each stamp whether it lies between two of the other stamps where messages are missing."""
    ordered = np.unique(others)
    period_ns = _period_of(ordered, periodic=True)
    if len(ordered) < 2 or not period_ns:
        return np.zeros(len(stamps), dtype=bool)
    after = np.clip(np.searchsorted(ordered, stamps), 1, len(ordered) - 1)
    found: NDArray[np.bool_] = np.rint((ordered[after] - ordered[after - 1]) / period_ns) > 1
    return found


def _span(stamps: Stamps) -> str:
    return f"{stamps.min() / NS_PER_S:.3f} s to {stamps.max() / NS_PER_S:.3f} s"


def _topic_report(
    info: TopicInfo, stamps: Stamps | None, log_ns: Stamps, images: list[str], camera_rate_hz: float
) -> TopicReport:
    """Returns the timing of a topic.

    Args:
        info: the topic.
        stamps: its stamps, ns; None = it has none.
        log_ns: its log times, ns.
        images: image topics of the bag.
        camera_rate_hz: recorded rate of its camera, Hz; 0 = unknown, or not of a camera.
    """
    stamped = stamps is not None and _is_of_this_clock(stamps, log_ns)
    times = stamps if stamped and stamps is not None else log_ns
    if not len(times):
        return TopicReport(info)
    first, last = int(times.min()), int(times.max())
    if info.latched or info.type_name in (CLOCK, *NO_RATE):
        return TopicReport(info, first, last)
    is_known = stamped and camera_rate_hz > 0.0
    period = NS_PER_S / camera_rate_hz if is_known else _period_of(times, periodic=info.type_name in ONE_SOURCE)
    if not period:
        return TopicReport(info, first, last)
    folder, _, name = info.name.rpartition("/")
    alone = name == "camera_info" and not any(base_topic(image).rpartition("/")[0] == folder for image in images)
    counts = stamped and not _is_event(info) and not alone
    missing = _missing_at(times, camera_rate_hz) if is_known else _missing_in(times, period)
    return TopicReport(info, first, last, NS_PER_S / period, missing if counts else None, is_known)


def _odometry(robot: str, infos: dict[str, TopicInfo], data: _Collected) -> OdometryReport | None:
    prefix = f"/{robot}/" if robot else "/"
    wheels = _odometry_topic(prefix, infos) or next((t for t in infos if t in data.poses and "ground_truth" not in t), "")
    truth = wheels.removesuffix("odom") + "ground_truth/odom"
    if not wheels or truth not in data.poses or not {wheels, truth} <= data.stamps.keys():
        return None
    common, at_wheels, at_truth = np.intersect1d(data.stamps[wheels], data.stamps[truth], return_indices=True)
    if len(common) < 2:
        return None
    measured, true = data.poses[wheels][at_wheels], data.poses[truth][at_truth]
    x, y, yaw = _seen_from_start(measured) - _seen_from_start(true)
    return OdometryReport(
        distance_m=_length(true),
        odometry_distance_m=_length(measured),
        end_error_m=float(np.hypot(x, y)),
        end_error_deg=abs(float(np.degrees(wrap_angle(float(yaw))))),
        robot=robot,
    )


def _seen_from_start(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns x, y, yaw (3,) of the last pose in the frame of the first pose."""
    dx, dy, turn = poses[-1] - poses[0]
    c, s = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    return np.array([c * dx + s * dy, c * dy - s * dx, turn])


def _length(poses: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum())


def _is_event(info: TopicInfo) -> bool:
    """Returns whether the messages of a topic are sent on events, so that none can be missing."""
    return info.latched or info.type_name in _EVENT_TYPES or info.type_name.startswith(_EVENT_PACKAGES)


def _is_of_this_clock(stamps: NDArray[np.int64], log_ns: NDArray[np.int64]) -> bool:
    """Returns whether stamps (N,) and log times (N,) use the same clock: /rosout has wall time in a bag of simulation time."""
    return bool(len(stamps)) and abs(int(np.median(stamps)) - int(np.median(log_ns))) < _FOREIGN_NS


def _period_of(times: NDArray[np.int64], *, periodic: bool = False) -> float:
    """Returns the period of a series of times (N,), nanoseconds; 0.0 if it is not periodic.

    Args:
        times: times of the messages, nanoseconds.
        periodic: whether the topic is known to be periodic, regardless of missing messages.
    """
    ordered = np.sort(times)
    period = nominal_period_ns(ordered)
    if periodic:
        return period
    if len(times) < _LEAST:
        return 0.0
    steps = np.diff(ordered)
    regular = np.count_nonzero(np.abs(steps - period) <= 0.6 * period)
    return period if period and regular >= _REGULAR_SHARE * len(steps) else 0.0


def _missing_in(times: NDArray[np.int64], period_ns: float) -> int:
    """Returns the number of messages missing between the first and the last: a gap of two periods, rounded, = one missing."""
    return int(np.maximum(np.rint(np.diff(times) / period_ns).astype(np.int64) - 1, 0).sum())


def _missing_at(times: NDArray[np.int64], rate_hz: float) -> int:
    """Returns the number of messages missing between the first and the last of a camera with a known rate."""
    first, last = int(times.min()), int(times.max())
    return max(0, images_due(first, last, rate_hz) + 1 - len(np.unique(times)))


def _camera_rates(bag: BagReader) -> dict[str, float]:
    """Returns prefix of topics, ``/camera/`` for example -> rate, Hz, of each camera of the newest recorded scene.

    Cameras with a higher rate than the recorded states are left out: they are rendered at each state.

    Raises:
        RecordError: the scene cannot be decoded.
    """
    of_type = {info.type_name: name for name, info in bag.topics().items() if info.count}
    if SCENE_TYPE not in of_type or STATE_TYPE not in of_type:
        return {}
    newest = deque(bag.raw_messages([of_type[SCENE_TYPE]]), maxlen=1)
    period_ns = state_period_ns(bag, of_type[STATE_TYPE])
    if not newest or not period_ns:
        return {}
    prefix, highest = of_type[SCENE_TYPE].rpartition("/")[0], 1.01 * NS_PER_S / period_ns
    cameras = getattr(bag.decode(SCENE_TYPE, newest[0][2]), "cameras", ())
    rates = {
        f"{prefix}/{getattr(camera, 'name', '')}/": getattr(camera, "rate", None) for camera in cameras
    }  # the bag defines the type
    return {topics: rate for topics, rate in rates.items() if isinstance(rate, float) and _LEAST_RATE <= rate <= highest}


def _camera_rate_of(topic: str, rates: Mapping[str, float]) -> float:
    """Returns the rate of the camera whose images the messages of a topic belong to, Hz; 0.0 if it is unknown."""
    if not base_topic(topic).endswith(_CAMERA_TOPICS):
        return 0.0
    prefixes = [prefix for prefix in rates if topic.startswith(prefix)]
    return rates[max(prefixes, key=len)] if prefixes else 0.0
