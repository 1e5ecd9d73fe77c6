"""Plans the rendering of a recorded run: the topics to read and to copy, the states to render, and the cameras due at each. Pure.

``gibson_sim.ros.recording.render_bag`` renders and writes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice

import numpy as np

from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.stamps import nominal_period_ns, stamp_ns
from gibson_sim.errors import RecordError
from gibson_sim.geometry.interpolation import interpolate_states
from gibson_sim.sensors.schedule import images_due
from gibson_sim.types import NS_PER_S, CameraSpec, SceneState

SCENE_TYPE, STATE_TYPE = "gibson_msgs/msg/Scene", "gibson_msgs/msg/SceneState"
_IMAGE_TYPES = (
    "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo", "gibson_msgs/msg/LabelInfo",
    "vision_msgs/msg/LabelInfo", "gibson_msgs/msg/TickDigest",
)  # fmt: skip
"""Types of images, of their descriptions, and of data derived from them."""
_CLOUD_OF_DEPTH = "/depth/points"
_STATES_TIMED = 20
"""Number of states from which their period is measured."""


@dataclass(frozen=True, slots=True)
class SceneTopics:
    """Topics of the scene and of its states."""

    scene: str
    state: str

    @property
    def prefix(self) -> str:
        """Prefix of the cameras' names in topics."""
        return self.state.rpartition("/")[0] + "/"


def scene_topics(bag: BagReader) -> SceneTopics:
    """Returns the topics of the scene and of its states.

    Raises:
        RecordError: the bag does not have one of them; the message names the topics to record.
    """
    topics_found: list[str] = []
    for type_name, usual in ((SCENE_TYPE, "/scene"), (STATE_TYPE, "/scene_state")):
        topics = [topic for topic, info in bag.topics().items() if info.type_name == type_name and info.count]
        if not topics:
            raise RecordError(
                f"bag {bag.folder} has no message on {usual} ({type_name}), so there is nothing to draw: record /scene and /scene_state "
                "as well; `gibson-sim run --record DIR` does, unless --topics leaves them out"
            )
        topics_found.append(usual if usual in topics else topics[0])
    return SceneTopics(*topics_found)


def topics_to_copy(infos: Mapping[str, TopicInfo], copy: str, rewritten: SceneTopics) -> tuple[str, ...]:
    """Returns the topics to copy to the new bag unchanged.

    Args:
        infos: topics of the bag.
        copy: ``auto`` = all but images and topics derived from them, ``none``, or names separated by commas.
        rewritten: topics that are rewritten, not copied.

    Raises:
        RecordError: a topic is not in the bag.
    """
    if copy == "none":
        return ()
    if copy == "auto":
        return tuple(
            topic
            for topic, info in infos.items()
            if topic not in (rewritten.scene, rewritten.state) and not _is_of_pictures(info)
        )
    names = [name.strip() for name in copy.split(",") if name.strip()]
    unknown = [name for name in names if name not in infos]
    if unknown:
        raise RecordError(f"setting 'copy' names {', '.join(unknown)}; the bag has: {', '.join(infos)}")
    return tuple(name for name in names if name not in (rewritten.scene, rewritten.state))


def _is_of_pictures(info: TopicInfo) -> bool:
    return info.type_name in _IMAGE_TYPES or info.name.endswith(_CLOUD_OF_DEPTH)


def state_period_ns(bag: BagReader, topic: str) -> int:
    """Returns the period of the states, nanoseconds, measured from the first states."""
    stamps = [stamp_ns(data) for _, _, data in islice(bag.raw_messages([topic]), _STATES_TIMED)]
    return round(nominal_period_ns(np.array(stamps, dtype=np.int64)))


class CameraSchedule:
    """Determines the cameras that are due at each state.

    Args:
        period_ns: period of the recorded states, nanoseconds.
        interpolate: whether to interpolate states at the exact times at which cameras are due.
    """

    def __init__(self, period_ns: int, *, interpolate: bool = False) -> None:
        self._period_ns, self._interpolate = period_ns, interpolate
        self._before: SceneState | None = None

    def moments(
        self, state: SceneState, cameras: Sequence[CameraSpec], recorded: Sequence[int] | None = None
    ) -> Iterator[tuple[SceneState, tuple[int, ...]]]:
        """Yields states with the indices of the cameras due at each; the last is ``state``, even if no camera is due.

        Args:
            state: the next recorded state.
            cameras: cameras of its scene.
            recorded: indices of the cameras that were due at the state; None = determined by their rates.
        """
        previous, self._before = self._before, state
        follows = previous is not None and previous.links == state.links and previous.revision == state.revision
        if previous is None or not follows or previous.stamp_ns >= state.stamp_ns:
            previous = None
        after_ns = state.stamp_ns - self._period_ns if previous is None else previous.stamp_ns
        if recorded is not None:
            yield state, tuple(k for k in recorded if k < len(cameras))
            return
        if self._interpolate:
            if previous is not None:
                yield from _between(previous, state, cameras)
            yield state, tuple(k for k, c in enumerate(cameras) if state.stamp_ns in _times(after_ns, state.stamp_ns, c.rate_hz))
        else:
            yield state, tuple(k for k, c in enumerate(cameras) if images_due(after_ns, state.stamp_ns, c.rate_hz))


def _between(
    previous: SceneState, state: SceneState, cameras: Sequence[CameraSpec]
) -> Iterator[tuple[SceneState, tuple[int, ...]]]:
    due: dict[int, list[int]] = {}
    for number, camera in enumerate(cameras):
        for time_ns in _times(previous.stamp_ns, state.stamp_ns, camera.rate_hz):
            due.setdefault(time_ns, []).append(number)
    for time_ns in sorted(due):
        if time_ns < state.stamp_ns:
            fraction = (time_ns - previous.stamp_ns) / (state.stamp_ns - previous.stamp_ns)
            yield replace(interpolate_states(previous, state, fraction), stamp_ns=time_ns), tuple(due[time_ns])


def _times(after_ns: int, until_ns: int, rate_hz: float) -> list[int]:
    """Returns the multiples of 1 / rate in (after, until], nanoseconds, truncated as the stamps of ticks are."""
    ratio = Fraction(rate_hz).limit_denominator(1000) / NS_PER_S
    first, last = math.floor((after_ns + 1) * ratio), math.floor((until_ns + 1) * ratio)
    times = (math.floor(k / ratio) for k in range(first, last + 1))
    return [time_ns for time_ns in times if after_ns < time_ns <= until_ns]
