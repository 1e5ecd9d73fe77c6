"""Reads the data for a replay from a bag: settings, inputs with their steps, commands with their times, digests, the last tick.

Pure: handles CDR bytes, not messages. ``gibson_sim.ros.nodes.replay_node`` sends the inputs of ``InputSchedule``.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from sys import intern
from typing import Any

from gibson_sim.bags.digest_comparison import Tick, TickDigests
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.errors import RecordError, TextError
from gibson_sim.reading import parse_yaml
from gibson_sim.standard.requests import EPOCH_REQUESTS
from gibson_sim.types import NS_PER_S

_INPUT, _DIGEST, _RUN_INFO = "gibson_msgs/msg/Input", "gibson_msgs/msg/TickDigest", "gibson_msgs/msg/RunInfo"
_STATE, _CLOCK = "gibson_msgs/msg/SceneState", "rosgraph_msgs/msg/Clock"
_JOURNAL_TOPIC = "inputs"
COMMAND_TYPES: Mapping[str, tuple[str, ...]] = {
    "cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "joint_trajectory": ("trajectory_msgs/msg/JointTrajectory",),
    "joint_command": ("sensor_msgs/msg/JointState",),
    "delta_twist_cmds": ("geometry_msgs/msg/TwistStamped",),
    "grasp": ("std_msgs/msg/Bool",),
}
"""Last part of the name of a command topic -> types of its messages."""
_APPLIED = {"cmd_vel_applied": "cmd_vel"}
"""Last part of the name of a topic that republishes commands -> that of the original topic, which other recorders omit if it has two types."""
_SET_STATE, _LOAD_WORLD = "set_simulation_state", "load_world"
_STOPPED, _PLAYING = 0, 1
_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_BEGIN_STEPS = 60
"""Number of steps after which the start of a recording counts as in the middle of a run."""


@dataclass(frozen=True, slots=True)
class RecordedInput:
    """A command or service request that changed the run, and the first step at which it took effect."""

    epoch: int
    step: int
    """Number of steps of the epoch before the one at which it takes effect."""
    name: str
    """Resolved name of the topic or service."""
    type_name: str
    """``geometry_msgs/msg/Twist`` or ``simulation_interfaces/srv/SpawnEntity``."""
    data: bytes
    """CDR bytes."""


@dataclass(frozen=True, slots=True)
class RecordedCommand:
    """A command as received on a topic."""

    time_ns: int
    """Time since the first /clock of the bag, or since its first message, nanoseconds."""
    name: str
    type_name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """Content of a bag for a replay."""

    settings: Mapping[str, Mapping[str, Any]]
    """Kind of node -> its settings; empty if the bag has no ``run_info``."""
    surroundings: Mapping[str, Mapping[str, Any]]
    """Kind of node -> machine, versions, driver, digest of the scene."""
    journal: tuple[RecordedInput, ...] | None
    """Inputs ordered by step; None = the bag has no ``inputs``."""
    commands: tuple[RecordedCommand, ...]
    digests: Mapping[Tick, Sequence[TickDigests]]
    """Tick -> digests; empty = the run was recorded without digests."""
    last_tick: Tick | None
    """Epoch and step of the last tick; None if no message has them."""
    duration_ns: int
    """Time from the first /clock or message to the last, nanoseconds."""
    begins_late: bool
    """Whether recording began in the middle of the run, so that earlier inputs are unknown."""

    def inputs(self, step_hz: int) -> tuple[RecordedInput, ...]:
        """Returns the journal; without a journal, the commands as inputs at the steps of their times."""
        if self.journal is not None:
            return with_starts(self.journal)
        steps = (-(-command.time_ns * step_hz // NS_PER_S) for command in self.commands)
        return tuple(RecordedInput(0, s, c.name, c.type_name, c.data) for s, c in zip(steps, self.commands, strict=True))

    def end(self, step_hz: int, publish_hz: int) -> Tick:
        """Returns epoch and step of the tick at which the replay ends.

        Raises:
            RecordError: the bag is shorter than one tick.
        """
        if self.last_tick is not None:
            return self.last_tick
        ticks = step_hz // publish_hz
        steps = self.duration_ns * step_hz // NS_PER_S // ticks * ticks
        if not steps:
            raise RecordError("the bag holds less than one tick of time: there is nothing to replay")
        epoch = self.journal[-1].epoch if self.journal else 0
        return epoch, steps


@dataclass(frozen=True, slots=True)
class RunFacts:
    """Facts about a run that are read without the whole bag."""

    settings: Mapping[str, Mapping[str, Any]]
    """Kind of node -> its settings; empty if the bag has no ``run_info``."""
    has_journal: bool
    has_digests: bool
    has_commands: bool


@dataclass(slots=True)
class _Content:
    """Content that has been read so far from the bags of a run."""

    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    surroundings: dict[str, dict[str, Any]] = field(default_factory=dict)
    journal: list[RecordedInput] = field(default_factory=list)
    has_journal: bool = False
    commands: list[RecordedCommand] = field(default_factory=list)
    digests: dict[Tick, list[TickDigests]] = field(default_factory=dict)
    ticks: list[Tick] = field(default_factory=list)
    """The first and the last of each bag."""
    duration_ns: int = 0


def epoch_bags(folder: Path) -> list[Path]:
    """Returns the bags of a recording: the folder, and the bags in which it continued after resets of time."""
    parts = [folder]
    for number in count(1):
        part = folder.with_name(f"{folder.resolve().name}_epoch{number}")
        if not part.is_dir():
            return parts
        parts.append(part)
    return parts


def read_facts(folder: str | Path) -> RunFacts:
    """Returns facts about a run without reading the whole bag.

    Raises:
        RecordError: the bag cannot be read.
    """
    content = _Content()
    with BagReader(folder) as bag:
        topics = bag.topics().values()
        for _, _, message in bag.messages([t.name for t in topics if t.type_name == _RUN_INFO]):
            _add_run_info(message, content)
    return RunFacts(
        content.settings,
        has_journal=any(_is_journal(topic.name, topic.type_name) for topic in topics),
        has_digests=any(topic.type_name == _DIGEST and topic.count for topic in topics),
        has_commands=bool(_command_topics({topic.name: topic.type_name for topic in topics if topic.count})),
    )


def read_digests(folder: str | Path) -> dict[Tick, list[TickDigests]]:
    """Returns the digests of each tick in one bag; empty if it was recorded without digests.

    Raises:
        RecordError: the bag cannot be read.
    """
    digests: dict[Tick, list[TickDigests]] = {}
    with BagReader(folder) as bag:
        for _, _, message in bag.messages([name for name, info in bag.topics().items() if info.type_name == _DIGEST]):
            _add_digests(message, digests)
    return digests


def _is_journal(topic: str, type_name: str) -> bool:
    return type_name == _INPUT and topic.rpartition("/")[2] == _JOURNAL_TOPIC


def _command_topics(types: Mapping[str, str]) -> dict[str, str]:
    """Returns topic of a bag with commands -> topic on which a robot receives them.

    Args:
        types: topic with messages -> type.
    """
    commands = {topic: topic for topic, kind in types.items() if kind in COMMAND_TYPES.get(topic.rpartition("/")[2], ())}
    for topic, type_name in types.items():
        namespace, slash, last = topic.rpartition("/")
        command = f"{namespace}{slash}{_APPLIED.get(last, '')}"
        if last in _APPLIED and command not in commands and type_name in COMMAND_TYPES[_APPLIED[last]]:
            commands[topic] = command
    return commands


def read_run(folder: str | Path, *, digests: bool = True) -> RecordedRun:
    """Returns the content of a bag for a replay.

    Args:
        folder: folder of the bag; the bags in which the recording continued after a reset of time are beside it.
        digests: whether to read digests, which takes the longest.

    Raises:
        RecordError: the bag cannot be read, or the run begins in another bag.
    """
    content = _Content()
    for part in epoch_bags(Path(folder)):
        with BagReader(part) as bag:
            _read_part(bag, content, digests)
    ticks = sorted(content.ticks)
    if ticks and ticks[0][0] > 0:
        raise RecordError(
            f"bag {folder} begins in epoch {ticks[0][0]}, after a reset: replay the bag that the recording began with, "
            "beside which this one lies"
        )
    return RecordedRun(
        settings=content.settings,
        surroundings=content.surroundings,
        journal=tuple(in_order(content.journal)) if content.has_journal else None,
        commands=tuple(content.commands),
        digests=content.digests,
        last_tick=ticks[-1] if ticks else None,
        duration_ns=content.duration_ns,
        begins_late=bool(ticks) and ticks[0][1] > _BEGIN_STEPS,
    )


def _read_part(bag: BagReader, content: _Content, digests: bool) -> None:
    """Adds the content of one bag."""
    topics = bag.topics().values()
    types = {topic.name: topic.type_name for topic in topics if topic.count}
    content.has_journal |= any(_is_journal(topic.name, topic.type_name) for topic in topics)
    of_type = {kind: [name for name, type_name in types.items() if type_name == kind] for kind in set(types.values())}
    for _, _, message in bag.messages(of_type.get(_RUN_INFO, ())):
        _add_run_info(message, content)
    before = set(content.journal)  # the bag of an epoch begins with a copy of the latched messages
    journal = bag.messages([name for name in of_type.get(_INPUT, ()) if _is_journal(name, _INPUT)])
    inputs = (RecordedInput(m.epoch, m.step, m.name, m.type, bytes(bytearray(m.data))) for _, _, m in journal)
    content.journal += [item for item in inputs if item not in before]
    if not content.has_journal:
        _read_commands(bag, types, of_type.get(_CLOCK, ()), content)
    if digests:
        for _, _, message in bag.messages(of_type.get(_DIGEST, ())):
            _add_digests(message, content.digests)
    _add_ticks(bag, of_type, content)
    first, last = bag.span_ns
    content.duration_ns += last - _first_clock(bag, of_type.get(_CLOCK, ()), first)


def mapping_in(text: str) -> dict[str, Any]:
    """Returns the mapping in the YAML text of a message; empty if the text is not a mapping."""
    try:
        content = parse_yaml(text)
    except TextError:
        return {}
    return content if isinstance(content, dict) else {}


def _add_run_info(message: Any, content: _Content) -> None:
    """Adds the settings of a node; for several render nodes, the settings of the first with the cameras of all."""
    settings, known = mapping_in(message.settings), content.settings.get(message.kind)
    content.surroundings.setdefault(message.kind, mapping_in(message.platform) | {"gibson_sim": message.version})
    if known is None:
        content.settings[message.kind] = settings
    elif known.get("cameras") and settings.get("cameras") is not None:
        wanted = dict.fromkeys((*known["cameras"].split(","), *settings["cameras"].split(",")))
        known["cameras"] = ",".join(wanted) if settings["cameras"] else ""


def _read_commands(bag: BagReader, types: Mapping[str, str], clocks: Sequence[str], content: _Content) -> None:
    """Adds the commands on all topics that a robot subscribes to."""
    topics = _command_topics(types)
    begin_ns = _first_clock(bag, clocks, bag.span_ns[0])
    for name, time_ns, data in bag.raw_messages(topics):
        content.commands.append(RecordedCommand(max(0, time_ns - begin_ns), topics[name], types[name], data))


def _first_clock(bag: BagReader, clocks: Sequence[str], otherwise_ns: int) -> int:
    """Returns the log time of the first /clock."""
    return next((time_ns for _, time_ns, _ in bag.raw_messages(clocks)), otherwise_ns)


def _add_digests(message: Any, digests: dict[Tick, list[TickDigests]]) -> None:
    topics = tuple(intern(topic) for topic in message.topics)
    numbers = array("Q", [int(digest) for digest in message.digests])
    tick = int(message.epoch), int(message.step)
    digests.setdefault(tick, []).append(TickDigests(time_from_msg(message.header.stamp), topics, numbers))


def _add_ticks(bag: BagReader, of_type: Mapping[str, Sequence[str]], content: _Content) -> None:
    """Adds the first and the last tick of a bag, from its digests if it has any, else from its states."""
    ticks = content.digests.keys() - set(content.ticks)
    if not (ticks and of_type.get(_DIGEST)) and of_type.get(_STATE):
        messages = bag.messages(of_type[_STATE])
        ticks = {(int(m.epoch), int(m.epoch_step)) for _, _, m in messages if hasattr(m, "epoch_step")}
    if ticks:
        content.ticks += [min(ticks), max(ticks)]


def in_order(inputs: Iterable[RecordedInput]) -> list[RecordedInput]:
    """Returns inputs ordered by step; inputs of one step in the given order, except that a reset is last, since it ends the epoch."""
    return sorted(inputs, key=lambda i: (i.epoch, i.step, i.name.endswith(EPOCH_REQUESTS)))


def with_starts(journal: Sequence[RecordedInput]) -> tuple[RecordedInput, ...]:
    """Returns a journal with a start request wherever time would stand still: after a stop, and in a newly loaded world.

    There, time may have passed by single steps, which the journal does not contain. Other starts are left out, since they have no effect.
    """
    completed: list[RecordedInput] = []
    for number, item in enumerate(journal):
        service = item.name.rpartition("/")[2]
        state = item.data[4] if service.endswith(_SET_STATE) else None
        if state == _PLAYING:
            continue
        completed.append(item)
        ends_here = number + 1 == len(journal) or journal[number + 1].epoch > item.epoch
        if ends_here and (state == _STOPPED or service.endswith(_LOAD_WORLD)):
            prefix = item.name.removesuffix(_LOAD_WORLD).removesuffix(_SET_STATE)
            start = replace(item, epoch=item.epoch + 1, step=0, name=f"{prefix}{_SET_STATE}")
            type_name = "simulation_interfaces/srv/SetSimulationState"
            completed.append(replace(start, type_name=type_name, data=_CDR_LITTLE_ENDIAN + bytes([_PLAYING])))
    return tuple(completed)


class InputSchedule:
    """Returns inputs some steps ahead of time, also across resets.

    Args:
        inputs: inputs, ordered as by ``in_order``.
    """

    def __init__(self, inputs: Sequence[RecordedInput]) -> None:
        self._inputs, self._next = inputs, 0
        self._begins = {0: 0}
        """Epoch -> total number of steps of all earlier epochs."""
        for item in inputs:
            for epoch in range(max(self._begins) + 1, item.epoch + 1):
                self._begins[epoch] = self._begins[epoch - 1]
            # An epoch ends with the input that begins the next one.
            self._begins[item.epoch + 1] = self._begins[item.epoch] + item.step

    @property
    def left(self) -> int:
        """Number of remaining inputs."""
        return len(self._inputs) - self._next

    def pop_due(self, epoch: int, step: int, ahead: int) -> Sequence[RecordedInput]:
        """Returns the next inputs that take effect fewer than ``ahead`` steps after a step of an epoch."""
        until, first = self._steps(epoch, step) + ahead, self._next
        while self._next < len(self._inputs):
            item = self._inputs[self._next]
            if self._steps(item.epoch, item.step) >= until:
                break
            self._next += 1
        return self._inputs[first : self._next]

    def _steps(self, epoch: int, step: int) -> int:
        """Returns the number of steps of the run up to a step of an epoch."""
        return self._begins.get(epoch, max(self._begins.values())) + step
