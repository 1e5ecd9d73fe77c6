"""Bags: mcap and sqlite3 with their metadata, whose records, rows, texts and messages are changed."""

from __future__ import annotations

import json
import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import fields, is_dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fuzz.grammar import HARSH_TEXTS, Mutator
from fuzz.seeds import ROOT, yaml_text
from fuzz.trial import Trial
from gibson_sim.bags.check import check_bag
from gibson_sim.bags.comparison.load import load_recording
from gibson_sim.bags.export import export_bag
from gibson_sim.bags.mcap_file import COMPRESSIONS
from gibson_sim.bags.metadata import METADATA_FILE, TopicQos, read_metadata
from gibson_sim.bags.plots.load import load_run
from gibson_sim.bags.plots.plot import plots_png
from gibson_sim.bags.reader import BagReader, image_to_array
from gibson_sim.bags.repairing.bag import repair
from gibson_sim.bags.replaying import read_facts, read_run
from gibson_sim.bags.video import write_contact_sheet, write_video
from gibson_sim.bags.writer import BagWriter

_NS = 10**9
_PERIOD_NS = 10**8
_MOMENTS = 6
_MOST_MESSAGES = 2000
TOPICS = {
    "/collisions": "gibson_msgs/msg/CollisionCount",
    "/contacts": "gibson_msgs/msg/Contacts",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/clock": "rosgraph_msgs/msg/Clock", "/odom": "nav_msgs/msg/Odometry", "/ground_truth/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage", "/camera/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image", "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo", "/scan": "sensor_msgs/msg/LaserScan", "/imu": "sensor_msgs/msg/Imu",
    "/cmd_vel": "geometry_msgs/msg/Twist", "/scene_state": "gibson_msgs/msg/SceneState", "/inputs": "gibson_msgs/msg/Input",
    "/run_info": "gibson_msgs/msg/RunInfo", "/tick_digest": "gibson_msgs/msg/TickDigest", "/joint_states": "sensor_msgs/msg/JointState",
}  # fmt: skip


@lru_cache(maxsize=1)
def store() -> Any:
    """Returns the types of Jazzy and ours."""
    made = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in sorted((ROOT / "src/gibson_msgs/msg").glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(), f"gibson_msgs/msg/{path.stem}"))
    made.register(types)
    return made


def blank(type_name: str, **values: Any) -> Any:
    """Returns a message with zeros, empty texts and empty lists, but for these values."""
    made = {}
    for name, desc in store().fielddefs[type_name][1]:
        made[name] = values.pop(name) if name in values else _blank_value(desc)
    assert not values, values
    return store().types[type_name](**made)


def _blank_value(desc: Any) -> Any:
    kind, rest = desc
    if kind == Nodetype.NAME:
        return blank(rest)
    if kind == Nodetype.BASE:
        return {"string": "", "wstring": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(rest[0], 0)
    (inner_kind, inner), length = rest[0], rest[1] if kind == Nodetype.ARRAY else 0
    if inner_kind == Nodetype.BASE and inner[0] not in ("string", "wstring"):
        return np.zeros(length, dtype={"bool": np.bool_, "octet": np.uint8}.get(inner[0], inner[0]))
    return [_blank_value((inner_kind, inner)) for _ in range(length)]


def _message(topic: str, k: int) -> Any:
    """Returns the message of a topic at a moment."""
    now = _NS + k * _PERIOD_NS
    stamp = blank("builtin_interfaces/msg/Time", sec=now // _NS, nanosec=now % _NS)
    header = blank("std_msgs/msg/Header", stamp=stamp, frame_id="odom")
    kind = TOPICS[topic]
    if topic == "/clock":
        return blank(kind, clock=stamp)
    if topic in ("/tf", "/tf_static"):
        turn = blank("geometry_msgs/msg/Quaternion", w=1.0)
        transform = blank("geometry_msgs/msg/Transform", rotation=turn, translation=blank("geometry_msgs/msg/Vector3", x=0.1 * k))
        child = "base_footprint" if topic == "/tf" else "camera_optical_frame"
        header = blank("std_msgs/msg/Header", stamp=stamp, frame_id="odom" if topic == "/tf" else "base_footprint")
        return blank(
            kind,
            transforms=[blank("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform)],
        )
    if topic == "/run_info":
        return (
            blank(kind, header=header, node="physics", settings="step_hz: 240\npublish_hz: 60\nscene: flat\n")
            if "settings" in _names(kind)
            else blank(kind)
        )
    values: dict[str, Any] = {"header": header} if "header" in _names(kind) else {}
    if topic.endswith("image_raw"):
        header = blank("std_msgs/msg/Header", stamp=stamp, frame_id="camera_optical_frame")
        depth = "depth" in topic
        pixels = np.full((6, 8), 1.0, dtype=np.float32) if depth else np.full((6, 8, 3), 10 * k, dtype=np.uint8)
        data = pixels.view(np.uint8).reshape(-1)
        values = {
            "header": header,
            "height": 6,
            "width": 8,
            "encoding": "32FC1" if depth else "rgb8",
            "step": len(data) // 6,
            "data": data,
        }
    elif topic.endswith("camera_info"):
        header = blank("std_msgs/msg/Header", stamp=stamp, frame_id="camera_optical_frame")
        matrix = np.array([8.0, 0, 3.5, 0, 8.0, 2.5, 0, 0, 1])
        values = {
            "header": header,
            "height": 6,
            "width": 8,
            "distortion_model": "plumb_bob",
            "d": np.zeros(5),
            "k": matrix,
            "r": np.eye(3).ravel(),
        }
        values["p"] = np.array([8.0, 0, 3.5, 0, 0, 8.0, 2.5, 0, 0, 0, 1, 0])
    elif topic == "/scan":
        values |= {
            "angle_min": -1.0,
            "angle_max": 1.0,
            "angle_increment": 0.2,
            "range_min": 0.1,
            "range_max": 10.0,
            "ranges": np.full(11, 2.0, dtype=np.float32),
        }
    elif topic == "/scene_state":
        values |= {
            "revision": 1,
            "step": 24 * k,
            "epoch_step": 24 * k,
            "poses": np.arange(7.0),
            "twists": np.zeros(6),
            "due_cameras": np.zeros(1, dtype=np.uint32),
        }
    elif topic == "/map":
        info = blank("nav_msgs/msg/MapMetaData", resolution=0.1, width=8, height=6)
        values |= {"info": info, "data": np.zeros(48, dtype=np.int8)}
    elif topic == "/collisions":
        values |= {"count": k, "ongoing": k % 2, "last_body": "wall"}
    elif topic == "/joint_states":
        values |= {"name": ["a", "b"], "position": np.zeros(2), "velocity": np.zeros(2), "effort": np.zeros(2)}
    elif topic == "/inputs":
        values |= {"step": 24 * k, "name": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "data": np.zeros(52, dtype=np.uint8)}
        values = {key: value for key, value in values.items() if key in _names(kind)}
    return blank(kind, **values)


def _names(kind: str) -> set[str]:
    return {name for name, _ in store().fielddefs[kind][1]}


def _export(kind: Any, bag: Path, out: Path) -> Any:
    return export_bag(bag, kind, out)


_WAYS: dict[str, Callable[[Path, Path], Any]] = {
    "check": lambda bag, _: check_bag(bag),
    "read_facts": lambda bag, _: read_facts(bag),
    "read_run": lambda bag, _: read_run(bag),
    "load_run": lambda bag, _: plots_png(load_run(bag)),
    "load_recording": lambda bag, _: load_recording(bag),
    "sheet": lambda bag, out: write_contact_sheet(bag, out.with_suffix(".png")),
    "video": lambda bag, out: write_video(bag, out.with_suffix(".mp4")),
    **{f"export {kind}": partial(_export, kind) for kind in ("tum", "png", "nerfstudio")},
}
"""Ways to use a bag beside reading it: each mutant is tried in some of them."""


def make(mutator: Mutator, folder: Path) -> None:
    """Writes a bag: its messages, its metadata, its records or its bytes are changed."""
    bag = folder / "bag"
    storage = mutator.rng.choice(("mcap", "mcap", "sqlite3"))
    compression = mutator.rng.choice(COMPRESSIONS) if storage == "mcap" else "none"
    times = mutator.times()
    kind = (
        mutator.rng.choice(
            ("messages", "messages", "metadata", "records", "bytes")
            if mutator.harsh
            else ("messages", "messages", "metadata", "order")
        )
        if times
        else ""
    )
    changed = (
        {(mutator.rng.choice(list(TOPICS)), mutator.rng.randrange(_MOMENTS)) for _ in range(times)}
        if kind == "messages"
        else set()
    )
    with BagWriter(bag, storage=storage, compression=compression, reserve_bytes=0, chunk_bytes=2000) as writer:
        for topic, type_name in TOPICS.items():
            writer.add_topic(topic, type_name, TopicQos.latched() if topic in ("/tf_static", "/run_info") else None)
        for k in range(_MOMENTS):
            topics = list(TOPICS)
            if kind == "order":
                mutator.rng.shuffle(topics)
            for topic in topics:
                if topic in ("/tf_static", "/run_info") and k:
                    continue
                message = _message(topic, k)
                if (topic, k) in changed:
                    _change_message(mutator, message)
                data = bytes(store().serialize_cdr(message, TOPICS[topic]))
                if (topic, k) in changed and mutator.harsh and mutator.chance(0.5):
                    data = mutator.data(data)
                now = _NS + k * _PERIOD_NS
                writer.write(topic, data, now, now)
    path = next(p for p in sorted(bag.iterdir()) if p.suffix in (".mcap", ".db3"))
    for _ in range(times):
        if kind == "metadata":
            document = yaml.safe_load((bag / METADATA_FILE).read_text()) if _is_yaml(bag / METADATA_FILE) else {}
            (bag / METADATA_FILE).write_bytes(mutator.file_text(yaml_text(mutator.tree(document))))
        elif kind == "bytes":
            path.write_bytes(mutator.data(path.read_bytes()))
        elif kind == "records" and storage == "mcap":
            path.write_bytes(_changed_records(mutator, path.read_bytes()))
        elif kind == "records":
            _change_rows(mutator, path)
    (folder / "case.json").write_text(json.dumps({"storage": storage, "kind": kind, "ways": mutator.rng.sample(list(_WAYS), 2)}))


def _is_yaml(path: Path) -> bool:
    try:
        return isinstance(yaml.safe_load(path.read_bytes()), dict)
    except (yaml.YAMLError, ValueError):
        return False


def _change_message(mutator: Mutator, message: Any) -> None:
    """Changes one value in a message, within its type."""
    places = [(holder, name) for holder, name in _values(message) if not is_dataclass(getattr(holder, name))]
    holder, name = mutator.rng.choice(places)
    value = getattr(holder, name)
    desc = dict(store().fielddefs[holder.__msgtype__][1])[name]
    if isinstance(value, str):
        new: Any = mutator.rng.choice([t for t in HARSH_TEXTS if t.isprintable()]) if mutator.harsh else value + "x"
    elif isinstance(value, bool):
        new = not value
    elif isinstance(value, np.ndarray):
        new = value.copy()
        if len(new) and mutator.chance(0.7):
            new[mutator.rng.randrange(len(new))] = _fitting(mutator, float(new[0]), new.dtype)
        elif desc[0] != Nodetype.ARRAY:
            new = np.resize(new, mutator.rng.choice((0, 1, len(new) + 1, 1000)))
    elif isinstance(value, int | float):
        new = _fitting(mutator, value, np.dtype(desc[1][0])).item()
    elif isinstance(value, list) and desc[0] == Nodetype.SEQUENCE:
        new = value * mutator.rng.choice((0, 2, 50))
    else:
        return
    setattr(holder, name, new)


def _fitting(mutator: Mutator, value: float | int, dtype: np.dtype[Any]) -> Any:
    with np.errstate(all="ignore"):
        if dtype.kind == "f":
            return np.array(float(mutator.number(float(value)))).astype(dtype)[()]
        info = np.iinfo(dtype)
        number = mutator.number(int(value))
        return np.array(min(max(int(number) if np.isfinite(float(number)) else info.max, info.min), info.max), dtype=dtype)[()]


def _values(message: Any) -> Iterator[tuple[Any, str]]:
    for entry in fields(message):
        if entry.name == "__msgtype__":
            continue
        value = getattr(message, entry.name)
        yield message, entry.name
        inner = value if isinstance(value, list) else [value]
        for one in inner:
            if is_dataclass(one):
                yield from _values(one)


def _changed_records(mutator: Mutator, data: bytes) -> bytes:
    """Returns an mcap file with one of its records gone, twice, elsewhere, longer, or other."""
    begin, records = 8, []
    while begin + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, begin)
        if length > len(data):
            return mutator.data(data)
        records.append((opcode, data[begin + 9 : begin + 9 + length]))
        begin += 9 + length
    if not records:
        return mutator.data(data)
    k = mutator.rng.randrange(len(records))
    opcode, content = records[k]
    length = None
    kind = mutator.rng.randrange(7)
    if kind == 0:
        del records[k]
    elif kind == 1:
        records.insert(mutator.rng.randrange(len(records)), records[k])
    elif kind == 2:
        mutator.rng.shuffle(records)
    elif kind == 3:
        records[k] = (mutator.rng.randrange(256), content)
    elif kind == 4:
        length = mutator.rng.choice((0, 2**31, 2**63, 2**64 - 1, len(content) + 1))
    else:
        records[k] = (opcode, mutator.data(content))
    out = [data[:8]]
    for i, (code, body) in enumerate(records):
        out.append(struct.pack("<BQ", code, length if i == k and length is not None else len(body)) + body)
    return b"".join(out) + data[-8:]


def _change_rows(mutator: Mutator, path: Path) -> None:
    """Changes a row, a column or a table of a database."""
    statements = (
        "UPDATE messages SET timestamp = ? WHERE id = 7", "UPDATE messages SET data = ? WHERE id = 9",
        "UPDATE messages SET topic_id = ? WHERE id = 3",
        "UPDATE topics SET name = ? WHERE id = 2", "UPDATE topics SET type = ? WHERE id = 2", "UPDATE topics SET offered_qos_profiles = ?",
        "UPDATE topics SET serialization_format = ?", "UPDATE message_definitions SET encoded_message_definition = ? WHERE id = 2",
        "UPDATE message_definitions SET encoding = ?", "UPDATE metadata SET metadata = ?", "UPDATE schema SET schema_version = ?",
        "DELETE FROM messages", "DELETE FROM topics WHERE id = 1", "DELETE FROM message_definitions", "DELETE FROM schema", "DROP TABLE messages",
        "DROP TABLE topics", "DROP TABLE message_definitions", "DROP TABLE metadata", "DROP TABLE schema",
        "ALTER TABLE messages RENAME COLUMN data TO x",
        "CREATE VIEW v AS SELECT * FROM messages",
        "INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, timestamp, data FROM messages",
    )  # fmt: skip
    statement = mutator.rng.choice(statements)
    value: Any = mutator.rng.choice(
        (0, -1, 2**63 - 1, -(2**63), 1.5, "text", b"", b"\0\1\0\0", b"\xff" * 100, "x" * 10**6, "[" * 3000, "- a: &a [*a]")
    )
    try:
        with closing(sqlite3.connect(path)) as connection:
            connection.execute("PRAGMA journal_mode=DELETE")
            with connection:
                connection.execute(statement, (value,) if "?" in statement else ())
    except sqlite3.Error:
        path.write_bytes(mutator.data(path.read_bytes()))


def run(folder: Path, trial: Trial) -> None:
    """Reads the bag in every way that there is, and mends a copy of it."""
    bag = folder / "bag"
    trial.call("read_metadata", read_metadata, bag)
    copy = folder / "copy"
    shutil.copytree(bag, copy)
    (copy / METADATA_FILE).unlink(missing_ok=True)
    trial.call("repair", repair, copy, go_on=True)
    trial.call("read_all", _read_all, bag, trial)
    for way in json.loads((folder / "case.json").read_text())["ways"]:
        trial.call(way, _WAYS[way], bag, folder / "made", go_on=True)


def _read_all(bag: Path, trial: Trial) -> None:
    with BagReader(bag) as reader:
        topics = reader.topics()
        _ = reader.span_ns
        trial.reach("loaded")
        count = 0
        for topic, _, data in reader.raw_messages():
            message = trial.call("decode", reader.decode, topics[topic].type_name, data, go_on=True)
            if message is None:
                continue
            if topics[topic].type_name == "sensor_msgs/msg/Image":
                trial.call("image", image_to_array, message, go_on=True)
            trial.reach("messages")
            count += 1
            if count > _MOST_MESSAGES:
                break
