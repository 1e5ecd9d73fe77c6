"""Recordings without ROS: time, pauses, epochs, snapshots, errors."""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

import gibson_sim.bags.recording as recording_module
import gibson_sim.bags.writer as writer_module
from gibson_sim.bags.recording import MOST_WAITING, Recording, report_lines
from gibson_sim.bags.writer import TopicQos
from gibson_sim.client_config import RecordConfig
from gibson_sim.errors import ConfigError

STRING = "std_msgs/msg/String"
NS = 1_000_000_000


@pytest.fixture(autouse=True)
def small_reserve(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets tests run on a small disk."""
    monkeypatch.setattr(
        recording_module, "BagWriter", lambda folder, **o: writer_module.BagWriter(folder, **{**o, "reserve_bytes": 0})
    )


def _clock(ns: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<iI", *divmod(ns, NS))


class _Recorder:
    """A recording of a few topics; tests pass it the messages."""

    def __init__(self, folder: Path, messages: Any, **settings: Any) -> None:
        self.recording = Recording(RecordConfig(output=str(folder), **settings))
        self._messages = messages
        self.recording.add_topic("/clock", "rosgraph_msgs/msg/Clock", None)
        self.recording.add_topic("/a", STRING, None)
        self.recording.add_topic("/scene", STRING, TopicQos.latched(), latched=True)

    def clock(self, ns: int) -> None:
        self.recording.receive_clock(_clock(ns))

    def say(self, *texts: str, topic: str = "/a") -> None:
        for text in texts:
            self.recording.receive(topic, self._messages.text(text))


def _read(folder: Path, *topics: str) -> list[tuple[str, int, str]]:
    """Returns topic, time and text of messages; no text for /clock."""
    with AnyReader([folder]) as reader:
        found = [(c.topic, t, "" if c.topic == "/clock" else bytes(d[8:-1]).decode()) for c, t, d in reader.messages()]
        assert len(found) == reader.message_count
    return [message for message in found if not topics or message[0] in topics]


def test_messages_get_the_time_of_the_newest_clock(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.clock(5)
    recorder.say("one", "two")
    recorder.clock(9)
    recorder.say("three")
    recorder.recording.close()
    assert _read(tmp_path / "bag") == [
        ("/clock", 5, ""), ("/a", 5, "one"), ("/a", 5, "two"), ("/clock", 9, ""), ("/a", 9, "three"),
    ]  # fmt: skip


def test_messages_before_the_first_clock_get_its_time(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.say(*map(str, range(MOST_WAITING + 7)))
    recorder.say("room", topic="/scene")
    recorder.clock(0)
    recorder.recording.close()
    assert {t for _, t, _ in _read(tmp_path / "bag")} == {0}
    assert len(_read(tmp_path / "bag", "/a")) == MOST_WAITING
    assert _read(tmp_path / "bag", "/scene") == [("/scene", 0, "room")], "latched messages wait without a limit"
    assert recorder.recording.summary()["before_clock"] == 7


def test_nothing_is_written_while_it_is_paused(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.clock(1)
    recorder.say("before")
    recorder.recording.pause()
    recorder.clock(2)
    recorder.say("meanwhile")
    recorder.say("old room", "new room", topic="/scene")
    recorder.recording.resume()
    recorder.clock(3)
    recorder.say("after")
    recorder.recording.close()
    assert _read(tmp_path / "bag", "/a") == [("/a", 1, "before"), ("/a", 3, "after")]
    assert _read(tmp_path / "bag", "/clock") == [("/clock", 1, ""), ("/clock", 3, "")]
    assert _read(tmp_path / "bag", "/scene") == [("/scene", 2, "new room")], "what still holds is written when it goes on"


def test_duration_counts_recorded_time(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages, duration=2.0)
    recorder.clock(10 * NS)
    recorder.clock(11 * NS)
    recorder.recording.pause()
    recorder.clock(50 * NS)
    recorder.recording.resume()
    assert not recorder.recording.done
    recorder.clock(51 * NS)
    assert recorder.recording.done
    recorder.say("too late")
    recorder.recording.close()
    assert _read(tmp_path / "bag", "/a") == []


def test_time_that_goes_back_starts_another_bag(tmp_path: Path, messages: Any, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.clock(5 * NS)
    recorder.say("room", topic="/scene")
    recorder.say("one")
    for epoch in ("two", "three"):
        recorder.clock(0)
        recorder.say(epoch)
        recorder.clock(NS)
    recorder.recording.close()
    assert _read(tmp_path / "bag", "/a", "/scene") == [("/scene", 5 * NS, "room"), ("/a", 5 * NS, "one")]
    for number, text in ((1, "two"), (2, "three")):
        assert _read(tmp_path / f"bag_epoch{number}") == [
            ("/scene", 0, "room"), ("/clock", 0, ""), ("/a", 0, text), ("/clock", NS, ""),
        ]  # fmt: skip
    said = [record.getMessage() for record in caplog.records if "went back" in record.getMessage()]
    assert said[0] == (
        f"time went back from 5.000 s to 0.000 s: {tmp_path}/bag is closed, recording goes on in {tmp_path}/bag_epoch1"
    )
    assert len(said) == 2
    assert recorder.recording.summary()["bags"] == [str(tmp_path / name) for name in ("bag", "bag_epoch1", "bag_epoch2")]


def test_folder_of_an_earlier_run_is_not_touched_by_a_new_epoch(tmp_path: Path, messages: Any) -> None:
    (tmp_path / "bag_epoch1").mkdir()
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.clock(5)
    recorder.clock(0)
    recorder.recording.close()
    assert list((tmp_path / "bag_epoch1").iterdir()) == []
    assert _read(tmp_path / "bag_epoch2") == [("/clock", 0, "")]


def test_two_clocks_end_the_recording(tmp_path: Path, messages: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_module, "MOST_EPOCHS", 3)
    recorder = _Recorder(tmp_path / "bag", messages)
    for _ in range(5):
        recorder.clock(5)
        recorder.clock(3)
    assert recorder.recording.done
    assert "do two programs publish /clock?" in recorder.recording.error
    recorder.recording.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag", "bag_epoch1", "bag_epoch2", "bag_epoch3"]


def test_snapshot_has_the_last_seconds_and_latched_messages(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages, snapshot_seconds=2.0)
    assert recorder.recording.snapshot() is None, "nothing came yet"
    recorder.clock(0)
    recorder.say("room", topic="/scene")
    for second in range(1, 6):
        recorder.clock(second * NS)
        recorder.say(str(second))
    first = recorder.recording.snapshot()
    recorder.clock(6 * NS)
    recorder.say("6")
    second_bag = recorder.recording.snapshot()
    recorder.recording.close()
    assert (first, second_bag) == (tmp_path / "bag_snapshot1", tmp_path / "bag_snapshot2")
    assert _read(tmp_path / "bag_snapshot1", "/a", "/scene") == [
        ("/scene", 3 * NS, "room"), ("/a", 3 * NS, "3"), ("/a", 4 * NS, "4"), ("/a", 5 * NS, "5"),
    ]  # fmt: skip
    assert [text for _, _, text in _read(tmp_path / "bag_snapshot2", "/a")] == ["4", "5", "6"]
    assert not (tmp_path / "bag").exists()


def test_memory_of_snapshots_is_bounded(tmp_path: Path, messages: Any, caplog: pytest.LogCaptureFixture) -> None:
    recorder = _Recorder(tmp_path / "bag", messages, snapshot_seconds=1000.0, snapshot_mb=1)
    for second in range(9):
        recorder.clock(second * NS)
        recorder.say(f"{second}" * 200_000)
    assert recorder.recording.snapshot() is not None
    assert [text[0] for _, _, text in _read(tmp_path / "bag_snapshot1", "/a")] == ["5", "6", "7", "8"]
    assert sum("snapshot_mb, 1 MB, is too little" in record.getMessage() for record in caplog.records) == 1


def test_snapshot_after_a_reset_has_no_earlier_messages(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages, snapshot_seconds=100.0)
    recorder.clock(7 * NS)
    recorder.say("room", topic="/scene")
    recorder.say("old")
    recorder.clock(0)
    recorder.say("new")
    recorder.recording.snapshot()
    assert _read(tmp_path / "bag_snapshot1", "/a", "/scene") == [("/scene", 0, "room"), ("/a", 0, "new")]


def test_split_on_request_continues_in_the_next_file(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages)
    assert not recorder.recording.split()
    recorder.clock(1)
    assert recorder.recording.split()
    recorder.clock(2)
    recorder.recording.close()
    assert _read(tmp_path / "bag") == [("/clock", 1, ""), ("/clock", 2, "")]
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "bag_1.mcap", "metadata.yaml"]


def test_full_disk_ends_the_recording_with_a_whole_bag(tmp_path: Path, messages: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.clock(1)
    recorder.say("small")
    monkeypatch.setattr(writer_module.shutil, "disk_usage", lambda _: type("Usage", (), {"free": -1}))
    recorder.say("x" * 1_100_000, "not taken")
    assert recorder.recording.done
    assert "make room" in recorder.recording.error
    recorder.recording.close()
    assert _read(tmp_path / "bag", "/a") == [("/a", 1, "small")]
    assert recorder.recording.summary()["messages"] == {"/a": 1, "/clock": 1}


def test_missing_folder_name_is_an_error() -> None:
    with pytest.raises(ConfigError, match="'output' is empty"):
        Recording(RecordConfig())


def test_compressed_database_is_refused() -> None:
    with pytest.raises(ConfigError, match="must be 'none' where 'storage' is 'sqlite3'"):
        RecordConfig(output="bag", storage="sqlite3", compression="zstd")


def test_report_says_why_a_bag_without_clock_is_empty(tmp_path: Path, messages: Any) -> None:
    recorder = _Recorder(tmp_path / "bag", messages)
    recorder.say("hello", "again")
    summary = recorder.recording.summary()
    assert summary["messages"] == {} and summary["before_clock"] == 2
    assert report_lines(summary)[-1] == (
        "WARNING: 2 messages are not recorded, since no /clock had come to give them a time; start the simulation first, or play a bag with "
        "`gibson-sim bag play --clock`"
    )
    recorder.clock(NS)
    assert recorder.recording.summary()["before_clock"] == 0
    recorder.recording.close()


def test_report_marks_losses() -> None:
    summary = {
        "bags": ["/tmp/bag"], "messages": {"/a": 3, "/odom": 40, "/tf": 2}, "bytes": {"/a": 1_500_000, "/odom": 2000, "/tf": 9},
        "lost": {"/a": 2, "/odom": 0}, "message_lost": {"/tf": 1, "/odom": 5}, "error": "",
    }  # fmt: skip
    lines = report_lines(summary)
    assert [line.split() for line in lines[1:4]] == [
        ["/a", "3", "messages", "1.50", "MB", "LOST", "2"],
        ["/odom", "40", "messages", "0.00", "MB", "nothing", "lost"],
        ["/tf", "2", "messages", "0.00", "MB"],
    ]
    assert lines[-1].startswith("WARNING: messages were lost on the way: /a 2, /tf 1;")
