from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter

import gibson_sim.bags.mcap_file as sink_module
from gibson_sim.bags.mcap_file import LARGE_BYTES
from gibson_sim.bags.writer import BagWriter, TopicQos
from gibson_sim.errors import RecordError

STRING = "std_msgs/msg/String"


def _mcap(folder: Path) -> Path:
    return folder / f"{folder.name}_0.mcap"


def _write(folder: Path, messages: Any, **options: Any) -> list[bytes]:
    """Writes ten messages of 1000 bytes into chunks of 2500."""
    data = [messages.text(f"{i:1000d}") for i in range(10)]
    with BagWriter(folder, reserve_bytes=0, chunk_bytes=2500, **options) as bag:
        bag.add_topic("/a", STRING)
        for i, message in enumerate(data):
            bag.write("/a", message, 1000 + i, 900 + i)
    return data


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_rosbags_reads_back_every_byte_and_time(tmp_path: Path, messages: Any, compression: str) -> None:
    data = _write(tmp_path / "bag", messages, compression=compression)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [(c.topic, t, raw) for c, t, raw in reader.messages()] == [("/a", 1000 + i, d) for i, d in enumerate(data)]


def test_publish_time_is_kept_beside_log_time(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages)
    with _mcap(tmp_path / "bag").open("rb") as file:
        times = [(m.log_time, m.publish_time) for _, _, m in make_reader(file).iter_messages()]
    assert times == [(1000 + i, 900 + i) for i in range(10)]


def test_messages_are_in_indexed_chunks(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages)
    with _mcap(tmp_path / "bag").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    # Three messages of 1046 bytes each exceed 2500 bytes.
    assert [len(c.message_index_offsets) for c in summary.chunk_indexes] == [1, 1, 1, 1]
    assert (summary.chunk_indexes[0].message_start_time, summary.chunk_indexes[-1].message_end_time) == (1000, 1009)


def _written_apart(folder: Path, messages: Any) -> list[tuple[str, int]]:
    """Writes small messages every 0.1 s, and after every third a large one, which fills a chunk; returns topics and times."""
    written, large = [], messages.text("x" * 2 * LARGE_BYTES)
    with BagWriter(folder, reserve_bytes=0, chunk_bytes=LARGE_BYTES) as bag:
        for topic in ("/small", "/large"):
            bag.add_topic(topic, STRING)
        for i in range(30):
            time_ns = i * 100_000_000
            for topic in ("/small", "/large") if i % 3 == 2 else ("/small",):
                bag.write(topic, large if topic == "/large" else messages.text(str(i)), time_ns, time_ns)
                written.append((topic, time_ns))
    return written


def test_large_messages_are_in_chunks_of_their_own(tmp_path: Path, messages: Any) -> None:
    written = _written_apart(tmp_path / "bag", messages)
    with _mcap(tmp_path / "bag").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert sorted((c.topic, m.log_time) for _, c, m in reader.iter_messages()) == sorted(written)
    assert summary is not None
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    kinds = [{topics[number] for number in chunk.message_index_offsets} for chunk in summary.chunk_indexes]
    assert all(len(kind) == 1 for kind in kinds)
    assert kinds.count({"/large"}) == 10
    with AnyReader([tmp_path / "bag"]) as rosbags:
        read = [(c.topic, t) for c, t, _ in rosbags.messages()]
    assert [t for _, t in read] == [t for _, t in written]
    assert sorted(read) == sorted(written)


def test_small_messages_do_not_lag_behind_large_ones_by_more_than_a_second(tmp_path: Path, messages: Any) -> None:
    _written_apart(tmp_path / "bag", messages)
    with _mcap(tmp_path / "bag").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    small_until = 0
    for chunk in summary.chunk_indexes:
        if chunk.uncompressed_size > LARGE_BYTES:
            assert chunk.message_end_time - small_until <= 1.3e9
        else:
            small_until = chunk.message_end_time


def test_file_has_the_same_records_as_one_of_rosbags(tmp_path: Path, messages: Any) -> None:
    """rosbag2 reads the files of rosbags: profile, schema, channel and metadata record must agree with them."""
    qos = TopicQos.latched()
    with BagWriter(tmp_path / "ours", reserve_bytes=0) as bag:
        bag.add_topic("/scene", STRING, qos)
        bag.write("/scene", messages.text("x"), 7, 7)
    with AnyReader([tmp_path / "ours"]) as reader:
        profiles = reader.connections[0].ext.offered_qos_profiles
    with RosbagsWriter(tmp_path / "theirs", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/scene", STRING, typestore=messages.store, offered_qos_profiles=profiles)
        writer.write(connection, 7, messages.text("x"))
    ours, theirs = _facts(_mcap(tmp_path / "ours")), _facts(tmp_path / "theirs" / "theirs.mcap")
    hashes = [t["topic_metadata"]["type_description_hash"] for t in theirs["information"]["topics_with_message_count"]]
    theirs["channel"]["topic_type_hash"] = hashes[0]  # rosbag2 writes it into the channel too
    theirs["information"].update(ros_distro="jazzy", relative_file_paths=["ours_0.mcap"])
    theirs["information"]["files"][0]["path"] = "ours_0.mcap"
    assert ours == theirs


def _facts(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        (schema,), (channel,) = summary.schemas.values(), summary.channels.values()
        (record,) = reader.iter_metadata()
        lines = [line.split("#")[0].strip() for line in schema.data.decode().splitlines()]
        qos = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        return {
            "profile": reader.get_header().profile,
            "schema": (schema.name, schema.encoding, [line for line in lines if line]),
            "encoding": channel.message_encoding,
            "channel": {**channel.metadata, "offered_qos_profiles": qos},
            "metadata": record.name,
            "information": yaml.safe_load(record.metadata["serialized_metadata"]),
        }


def test_latched_topic_is_latched_in_the_file_and_in_the_metadata(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/scene", STRING, TopicQos.latched())
        bag.write("/scene", messages.text("x"), 1, 1)
    with AnyReader([tmp_path / "bag"]) as reader:
        # rosbags matches the two descriptions of a topic by their quality of service: a message shows that they agree.
        assert [c.ext.offered_qos_profiles[0].durability.name for c, _, _ in reader.messages()] == ["TRANSIENT_LOCAL"]


def test_metadata_counts_every_topic(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        for topic in ("/a", "/b", "/silent"):
            bag.add_topic(topic, STRING)
        bag.write("/a", messages.text("1"), 10, 10)
        bag.write("/b", messages.text("2"), 10, 10)
        bag.write("/a", messages.text("3"), 30, 30)
    information = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counts == {"/a": 2, "/b": 1, "/silent": 0}
    assert information["duration"] == {"nanoseconds": 20}


def test_bag_without_messages_can_be_opened(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 0


def test_folder_contains_only_the_bag(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages)
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_empty_folder_is_accepted(tmp_path: Path, messages: Any) -> None:
    (tmp_path / "bag").mkdir()
    assert len(_write(tmp_path / "bag", messages)) == 10


def test_folder_with_content_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(RecordError, match=r"not empty.*another folder"):
        BagWriter(tmp_path, reserve_bytes=0)
    assert [p.name for p in tmp_path.iterdir()] == ["note.txt"]


def test_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bag").write_text("mine")
    with pytest.raises(RecordError, match="cannot be used"):
        BagWriter(tmp_path / "bag", reserve_bytes=0)


def test_closing_twice_does_nothing(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", reserve_bytes=0)
    bag.close()
    before = _mcap(tmp_path / "bag").read_bytes()
    bag.close()
    assert _mcap(tmp_path / "bag").read_bytes() == before


def test_writing_after_close_is_an_error(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", reserve_bytes=0)
    bag.add_topic("/a", STRING)
    bag.close()
    with pytest.raises(RecordError, match="closed"):
        bag.write("/a", b"\0\1\0\0", 0, 0)


def test_undeclared_topic_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
        with pytest.raises(RecordError, match="/b was not declared; known: /a"):
            bag.write("/b", b"\0\1\0\0", 0, 0)


def test_time_that_runs_backwards_is_refused(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
        bag.write("/a", messages.text("x"), 100, 100)
        with pytest.raises(RecordError, match="99 ns after 100 ns"):
            bag.write("/a", messages.text("x"), 99, 99)


def test_topic_cannot_change_its_type(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
        bag.add_topic("/a", STRING)
        with pytest.raises(RecordError, match="has the type std_msgs/msg/String already"):
            bag.add_topic("/a", "std_msgs/msg/Bool")


def test_memoryview_is_accepted(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
        bag.write("/a", memoryview(messages.text("x")), 1, 1)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [bytes(raw) for _, _, raw in reader.messages()] == [messages.text("x")]


@pytest.mark.parametrize("call", range(2, 14))
def test_interrupt_in_the_middle_of_a_write_leaves_a_bag_of_whole_chunks(
    tmp_path: Path, messages: Any, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    """Ctrl-C raises KeyboardInterrupt anywhere: here after half of the bytes are on disk."""
    write, calls = sink_module.Sink.write, iter(range(100))

    def interrupted(sink: Any, data: bytes) -> int:
        if next(calls) == call:
            write(sink, data[: len(data) // 2])
            raise KeyboardInterrupt
        return write(sink, data)

    monkeypatch.setattr(sink_module.Sink, "write", interrupted)
    bag = BagWriter(tmp_path / "bag", reserve_bytes=0, chunk_bytes=2500)
    bag.add_topic("/a", STRING)
    with pytest.raises(KeyboardInterrupt):
        _write_ten(bag, messages)
    bag.close()
    with AnyReader([tmp_path / "bag"]) as reader:
        times = [t for _, t, _ in reader.messages()]
    assert times == list(range(len(times)))
    # At most the open chunk, of three messages, is lost.
    assert bag.message_count - 3 <= len(times)
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def _write_ten(bag: BagWriter, messages: Any) -> None:
    for i in range(10):
        bag.write("/a", messages.text(f"{i:1000d}"), i, i)
    bag.close()


@pytest.mark.ros
@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")
def test_bytes_of_rclpy_are_read_back_as_sent(tmp_path: Path) -> None:
    rclpy = pytest.importorskip("rclpy.serialization", reason="SKIPPED: no rclpy")
    from geometry_msgs.msg import PoseStamped
    from rclpy.qos import DurabilityPolicy, QoSProfile

    message = PoseStamped()
    message.header.frame_id, message.header.stamp.sec, message.pose.position.y = "map", 12, -2.5
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/pose", "geometry_msgs/msg/PoseStamped", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        bag.write("/pose", rclpy.serialize_message(message), 1, 1)
    with AnyReader([tmp_path / "bag"]) as reader:
        ((connection, _, raw),) = reader.messages()
        got = reader.deserialize(raw, connection.msgtype)
    assert connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    assert (got.header.frame_id, got.header.stamp.sec, got.pose.position.y) == ("map", 12, -2.5)
