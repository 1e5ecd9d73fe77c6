"""Reads and writes ``metadata.yaml`` of a rosbag2 folder, version 9 (Jazzy), with the quality of service of every topic."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import yaml

from gibson_sim.errors import TextError
from gibson_sim.reading import parse_yaml, read_yaml_file
from gibson_sim.types import NS_PER_S

METADATA_FILE = "metadata.yaml"
REPAIRED = "gibson_sim_repaired"
"""Key of ``custom_data`` that says what a repair of the bag lost."""
VERSION = 9
ROS_DISTRO = "jazzy"
FOREVER_NS = 2**63 - 1
"""Duration that Fast DDS reports for an infinite deadline, lifespan or lease, nanoseconds."""


_POLICIES = {
    "history": ("keep_last", "keep_all"),
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "liveliness": ("automatic", "manual_by_topic"),
}
"""Policy -> values that a publisher can offer; a bag may also have ``unknown`` or ``system_default``."""


class Profile(Protocol):
    """An object with the attributes of ``rclpy.qos.QoSProfile``."""

    @property
    def depth(self) -> int:
        """Queue depth, messages."""


@dataclass(frozen=True, slots=True)
class TopicQos:
    """Quality of service of a topic, as rosbag2 stores it; ``ros2 bag play`` publishes the topic with it."""

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    """``transient_local`` = latched: late joiners receive the last message, also in a replay."""
    deadline_ns: int = FOREVER_NS
    lifespan_ns: int = FOREVER_NS
    liveliness: str = "automatic"
    liveliness_lease_duration_ns: int = FOREVER_NS
    avoid_ros_namespace_conventions: bool = False

    @classmethod
    def latched(cls, depth: int = 1) -> TopicQos:
        """Returns the quality of service of a latched topic."""
        return cls(depth=depth, durability="transient_local")

    @classmethod
    def of(cls, profile: TopicQos | Profile | None) -> TopicQos:
        """Converts an ``rclpy.qos.QoSProfile``, or an object with its attributes; None = the default."""
        if profile is None:
            return cls()
        if isinstance(profile, cls):
            return profile
        values: dict[str, Any] = {}
        for f in fields(cls):
            value = getattr(profile, f.name.removesuffix("_ns"))
            if f.name.endswith("_ns"):
                value = int(value.nanoseconds)
            elif f.type == "str":
                value = str(value.name).lower()
            values[f.name] = value
        return cls(**values)

    @classmethod
    def recorded(cls, profile: Any) -> TopicQos:
        """Converts a profile of a bag, ``rosbags.interfaces.Qos``; policies that the bag does not name have their defaults."""
        default = cls()

        def policy(name: str) -> str:
            value = str(getattr(profile, name).name).lower()
            return value if value in _POLICIES[name] else str(getattr(default, name))

        def nanoseconds(name: str) -> int:
            time = getattr(profile, name)
            return int(time.sec * NS_PER_S + time.nsec) or FOREVER_NS

        return cls(
            history=policy("history"),
            depth=profile.depth or default.depth,
            reliability=policy("reliability"),
            durability=policy("durability"),
            deadline_ns=nanoseconds("deadline"),
            lifespan_ns=nanoseconds("lifespan"),
            liveliness=policy("liveliness"),
            liveliness_lease_duration_ns=nanoseconds("liveliness_lease_duration"),
        )

    def as_dict(self) -> dict[str, Any]:
        """Returns the mapping that rosbag2 writes."""
        values: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name.endswith("_ns"):
                seconds, nanoseconds = divmod(value, 1_000_000_000)
                value = {"sec": seconds, "nsec": nanoseconds}
            values[f.name.removesuffix("_ns")] = value
        return values


@dataclass(frozen=True, slots=True)
class TopicRecord:
    """A topic as listed in the metadata."""

    name: str
    type_name: str
    qos: Sequence[dict[str, Any]]
    """Offered profiles, each as ``TopicQos.as_dict`` returns it."""
    type_hash: str
    count: int


def dump_qos(profiles: Sequence[dict[str, Any]]) -> str:
    """Returns the text of ``offered_qos_profiles`` in the metadata of an mcap channel."""
    return _dump(list(profiles)).rstrip("\n") if profiles else ""


@dataclass(frozen=True, slots=True)
class FileRecord:
    """A storage file of a bag as listed in the metadata."""

    name: str
    start_ns: int = 0
    """Log time of the first message, nanoseconds; 0 for an empty file."""
    end_ns: int = 0
    """Log time of the last message, nanoseconds; 0 for an empty file."""
    count: int = 0


def bag_information(topics: Sequence[TopicRecord], files: Sequence[FileRecord], storage: str = "mcap") -> dict[str, Any]:
    """Returns the content of ``rosbag2_bagfile_information``.

    Args:
        topics: all topics, including those without messages.
        files: the storage files in order.
        storage: ``mcap`` or ``sqlite3``.
    """
    filled = [file for file in files if file.count]
    start, end = min((f.start_ns for f in filled), default=0), max((f.end_ns for f in filled), default=0)
    return {
        "version": VERSION,
        "storage_identifier": storage,
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(topic.count for topic in topics),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": list(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                "duration": {"nanoseconds": file.end_ns - file.start_ns},
                "message_count": file.count,
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": ROS_DISTRO,
    }


def dump_information(information: dict[str, Any]) -> str:
    """Returns the metadata embedded in a storage file: in the metadata record ``rosbag2`` of mcap, in a table of sqlite3."""
    return _dump(information)


def read_metadata(folder: Path) -> dict[str, Any]:
    """Returns the content of ``rosbag2_bagfile_information``; empty if the file is missing or cannot be parsed."""
    try:
        content = read_yaml_file(folder / METADATA_FILE)
    except (OSError, TextError):
        return {}
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    return information if isinstance(information, dict) else {}


def parse_information(text: str) -> dict[str, Any]:
    """Returns the metadata embedded in a storage file; empty if it cannot be parsed."""
    try:
        content = parse_yaml(text)
    except TextError:
        return {}
    content = content.get("rosbag2_bagfile_information", content) if isinstance(content, dict) else None
    return content if isinstance(content, dict) else {}


def listed_topics(information: Mapping[str, Any]) -> dict[str, TopicRecord]:
    """Returns the topics by name as metadata lists them; without entries that are no topics."""
    found: dict[str, TopicRecord] = {}
    entries = information.get("topics_with_message_count")
    for entry in entries if isinstance(entries, list) else []:
        topic, count = (entry.get("topic_metadata"), entry.get("message_count")) if isinstance(entry, dict) else (None, None)
        name, type_name = (topic.get("name"), topic.get("type")) if isinstance(topic, dict) else (None, None)
        if not (isinstance(topic, dict) and isinstance(name, str) and isinstance(type_name, str) and isinstance(count, int)):
            continue
        qos = topic.get("offered_qos_profiles")  # a text before version 9
        profiles = offered_qos(qos) if isinstance(qos, str) else qos if isinstance(qos, list) else []
        earlier = found[name].count if name in found else 0
        found[name] = TopicRecord(name, type_name, profiles, str(topic.get("type_description_hash") or ""), count + earlier)
    return found


def offered_qos(text: str) -> list[Any]:
    """Returns the profiles of a topic from their YAML text in a storage file; empty if it cannot be parsed."""
    try:
        content = parse_yaml(text)
    except TextError:
        return []
    return content if isinstance(content, list) else []


def is_qos(text: str) -> bool:
    """Returns whether the text of the profiles of a topic can be parsed; an empty one can."""
    try:
        content = parse_yaml(text)
    except TextError:
        return False
    return content is None or isinstance(content, list)


def damaged_qos(topic: str, replacement: str) -> str:
    """Returns the line that says what became of the damaged QoS of a topic."""
    return f"the QoS of topic {topic!r:.200} is damaged: " + ("that of the metadata counts" if replacement else "it is left out")


def write_metadata(folder: Path, information: dict[str, Any]) -> None:
    """Writes ``metadata.yaml`` atomically."""
    path = folder / METADATA_FILE
    draft = folder / (METADATA_FILE + ".tmp")
    try:
        draft.write_text(_dump({"rosbag2_bagfile_information": information}), encoding="utf-8")
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


class _PlainDumper(yaml.SafeDumper):
    """YAML dumper without anchors and aliases, which some readers do not support."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _dump(value: Any) -> str:
    return str(yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False, allow_unicode=True))
