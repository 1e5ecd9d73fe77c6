"""What a playback publishes, with which QoS, and when."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zstandard

from gibson_sim.bags.metadata import TopicQos
from gibson_sim.bags.playback.options import PlayOptions
from gibson_sim.bags.playback.plan import CLOCK, Pace, Span, messages_in_order, playback_qos, played_span, select_topics
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import ConfigError

NS = 1_000_000_000
STRING, CLOCK_TYPE = "std_msgs/msg/String", "rosgraph_msgs/msg/Clock"


def _write(folder: Path, messages: Any, **options: Any) -> Path:
    """Writes 10 s with a text each second from 100 s, maps at 100, 101 and 105 s, and a clock."""
    with BagWriter(folder, reserve_bytes=0, **options) as bag:
        bag.add_topic("/text", STRING)
        bag.add_topic("/map", STRING, TopicQos.latched(depth=1))
        bag.add_topic("/silent", STRING)
        bag.add_topic(CLOCK, CLOCK_TYPE)
        for second in range(100, 111):
            stamp = messages.types[CLOCK_TYPE](clock=messages.time(second * NS))
            bag.write(CLOCK, messages.cdr(stamp), second * NS, second * NS)
            if second in (100, 101, 105):
                bag.write("/map", messages.text(f"map {second}"), second * NS, second * NS)
            bag.write("/text", messages.text(str(second)), second * NS, second * NS)
    return folder


@pytest.fixture
def bag(tmp_path: Path, messages: Any) -> Iterator[BagReader]:
    with BagReader(_write(tmp_path / "bag", messages)) as reader:
        yield reader


def _played(bag: BagReader, **options: Any) -> list[tuple[float, str, str]]:
    """Returns seconds, topic and text of the messages of a playback."""
    chosen = PlayOptions(str(bag.folder), **options)
    period_ns = round(chosen.rate / chosen.clock * NS) if chosen.clock else 0
    messages = messages_in_order(bag, select_topics(bag, chosen), played_span(bag, chosen), period_ns)
    return [(m.time_ns / NS, m.topic, bag.decode(STRING, m.data).data if m.data else "") for m in messages]


# Options


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rate": 0.0}, "--rate is 0, must be above 0"),
        ({"rate": -1.0}, "--rate is -1, must be above 0"),
        ({"rate": math.nan}, "--rate is nan, must be above 0"),
        ({"rate": math.inf}, "--rate is inf, must be above 0 and at most 1000"),
        ({"clock": 0.0}, "--clock is 0 Hz, must be above 0"),
        ({"start_offset": -1.0}, "--start-offset is -1 s, must be 0 or more"),
        ({"delay": math.nan}, "--delay is nan s, must be 0 or more"),
        ({"playback_duration": 0.0}, "--playback-duration is 0 s, must be above 0"),
        ({"remap": ("/a=/b",)}, "--remap has '/a=/b', must be OLD:=NEW"),
        ({"remap": ("/a:=/b c",)}, "--remap has '/a:=/b c', must be OLD:=NEW"),
        ({"wait_for": ("/a:x",)}, "--wait-for has '/a:x', must be TOPIC or TOPIC:N"),
    ],
)
def test_invalid_option_is_refused_with_what_is_allowed(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        PlayOptions("bag", **options)


def test_options_survive_the_way_to_the_node() -> None:
    options = PlayOptions("bag", 2.0, ("/a", "b"), remap=("a:=/c",), clock=40.0, wait_for=("/c:2", "b"), loop=True)
    assert PlayOptions.from_json(options.to_json()) == options
    assert (options.remapped(), options.required_subscribers()) == ({"/a": "/c"}, {"/c": 2, "/b": 1})


# Topics


def _selected(bag: BagReader, **options: Any) -> dict[str, str]:
    return {topic.name: topic.published_as for topic in select_topics(bag, PlayOptions(str(bag.folder), **options))}


def test_all_topics_with_messages_are_played_except_the_clock(bag: BagReader) -> None:
    assert _selected(bag) == {"/map": "/map", "/text": "/text"}


def test_topics_can_be_named_excluded_and_renamed_without_a_slash(bag: BagReader) -> None:
    assert _selected(bag, topics=("text", "/map"), exclude_topics=("/map", "/clock"), remap=("/text:=words",)) == {
        "/text": "/words"
    }


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"topics": ("/tekst",)}, "--topics: bag .* has no topic '/tekst'; did you mean '/text'?"),
        ({"exclude_topics": ("/zzzzzz",)}, "--exclude-topics: bag .* has no topic '/zzzzzz'; it has /map, /silent, /text"),
        ({"remap": ("/a:=/b",)}, "--remap: bag .* has no topic '/a'"),
        ({"topics": ("/clock",)}, "--topics has /clock, which is not played: --clock publishes the time"),
        ({"remap": ("/text:=/clock",)}, "--remap publishes /text as /clock"),
        ({"topics": ("/silent",)}, "nothing of bag .* is selected: topics with messages, apart from /clock, are /map, /text"),
    ],
)  # fmt: skip
def test_selection_that_cannot_be_played_is_refused(bag: BagReader, options: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        _selected(bag, **options)


def test_two_types_on_one_topic_are_refused(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as writer:
        writer.add_topic("/text", STRING)
        writer.add_topic("/odom", "nav_msgs/msg/Odometry")
        writer.write("/text", messages.text("x"), 1, 1)
        writer.write("/odom", messages.odometry(1, 0.0, 0.0), 1, 1)
    with BagReader(tmp_path / "bag") as reader, pytest.raises(ConfigError, match=r"/odom \(nav_msgs.* and /text .* as /odom"):
        _selected(reader, remap=("/text:=/odom",))


# QoS


def test_publisher_has_the_recorded_qos(bag: BagReader) -> None:
    topics = {topic.name: topic for topic in select_topics(bag, PlayOptions(str(bag.folder)))}
    assert topics["/map"].qos == TopicQos(depth=1, durability="transient_local")
    assert topics["/text"].qos == TopicQos()
    assert topics["/map"].is_latched and not topics["/text"].is_latched


def test_bag_without_qos_is_played_with_the_default() -> None:
    assert playback_qos([]) == TopicQos(depth=10, reliability="reliable", durability="volatile")


def test_one_queue_holds_the_latched_messages_of_all_publishers() -> None:
    assert playback_qos([TopicQos.latched()] * 3) == TopicQos.latched(depth=3)


def test_mixed_publishers_become_one_that_every_subscriber_can_match() -> None:
    weak, strong = TopicQos(depth=5, reliability="best_effort", deadline_ns=NS), TopicQos.latched()
    assert playback_qos([weak, strong]) == TopicQos(depth=6, reliability="reliable", durability="transient_local")
    assert playback_qos([weak, weak]).deadline_ns == NS, "equal publishers are kept in all policies"


# Messages


def test_messages_have_their_times_and_their_bytes(bag: BagReader, messages: Any) -> None:
    assert _played(bag, topics=("/text",)) == [(float(second), "/text", str(second)) for second in range(100, 111)]
    options = PlayOptions(str(bag.folder), topics=("/text",))
    first = next(messages_in_order(bag, select_topics(bag, options), played_span(bag, options)))
    assert first.data == messages.text("100")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_split_bag_is_played_from_all_its_files(tmp_path: Path, messages: Any, storage: str) -> None:
    folder = _write(tmp_path / "bag", messages, storage=storage, max_file_ns=3 * NS)
    assert len([path for path in folder.iterdir() if path.suffix in (".mcap", ".db3")]) > 2
    with BagReader(folder) as reader:
        assert [text for _, _, text in _played(reader, topics=("/text",))] == [str(second) for second in range(100, 111)]


def test_bag_whose_files_are_compressed_is_played(tmp_path: Path, messages: Any) -> None:
    folder = _write(tmp_path / "bag", messages, storage="sqlite3")
    (file,) = folder.glob("*.db3")
    (folder / f"{file.name}.zstd").write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    metadata = folder / "metadata.yaml"
    text = metadata.read_text().replace(file.name, f"{file.name}.zstd")
    text = text.replace("compression_format: ''", "compression_format: zstd").replace(
        "compression_mode: ''", "compression_mode: FILE"
    )
    metadata.write_text(text)
    with BagReader(folder) as reader:
        assert [text for _, _, text in _played(reader, topics=("/text",))] == [str(second) for second in range(100, 111)]


def test_offset_and_duration_select_a_span_whose_ends_are_included(bag: BagReader) -> None:
    assert [time for time, _, _ in _played(bag, topics=("/text",), start_offset=2.0, playback_duration=3.0)] == [
        102,
        103,
        104,
        105,
    ]


def test_offset_beyond_the_end_is_refused_with_the_length(bag: BagReader) -> None:
    with pytest.raises(ConfigError, match=r"--start-offset is 11 s, must be less than the length of the bag, 10\.0 s"):
        played_span(bag, PlayOptions(str(bag.folder), start_offset=11.0))


def test_latched_messages_that_are_valid_at_the_start_come_first(bag: BagReader) -> None:
    assert _played(bag, start_offset=3.0, playback_duration=2.0) == [
        (103.0, "/map", "map 101"),
        (103.0, "/text", "103"),
        (104.0, "/text", "104"),
        (105.0, "/map", "map 105"),
        (105.0, "/text", "105"),
    ]


def test_latched_topic_that_keeps_all_begins_with_all(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as writer:
        writer.add_topic("/notes", STRING, TopicQos(history="keep_all", depth=1, durability="transient_local"))
        for second in range(1, 5):
            writer.write("/notes", messages.text(str(second)), second * NS, second * NS)
    with BagReader(tmp_path / "bag") as reader:
        assert [(time, text) for time, _, text in _played(reader, start_offset=2.0)] == [(3, "1"), (3, "2"), (3, "3"), (4, "4")]


def test_clock_precedes_messages_of_its_time_and_ends_with_the_last(bag: BagReader) -> None:
    played = _played(bag, topics=("/text",), clock=0.8, start_offset=8.0)
    assert [(time, topic) for time, topic, _ in played] == [
        (108.0, CLOCK), (108.0, "/text"), (109.0, "/text"), (109.25, CLOCK), (110.0, "/text"), (110.0, CLOCK),
    ]  # fmt: skip


# Time


def test_rate_divides_the_recorded_time() -> None:
    pace = Pace(2.0, 100 * NS, 50.0)
    assert [pace.remaining_s(time_ns, 51.0) for time_ns in (100 * NS, 102 * NS, 110 * NS)] == [-1.0, 0.0, 4.0]


def test_pause_shifts_everything_after_it() -> None:
    pace = Pace(2.0, 100 * NS, 50.0)
    pace.toggle(51.0)  # at 102 s of the bag
    assert pace.paused and pace.remaining_s(102 * NS, 1e6) == math.inf
    pace.toggle(60.0)
    assert not pace.paused and pace.remaining_s(110 * NS, 60.0) == 4.0


def test_playback_can_start_paused() -> None:
    pace = Pace(1.0, 100 * NS, 50.0, paused=True)
    assert pace.remaining_s(100 * NS, 1e6) == math.inf
    pace.toggle(70.0)
    assert pace.remaining_s(101 * NS, 70.5) == 0.5


def test_span_has_a_length() -> None:
    assert Span(NS, 3 * NS).seconds == 2.0


def test_recorded_policies_that_are_unknown_have_their_defaults(write_drive: Callable[..., Path]) -> None:
    folder = write_drive()
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("history: keep_last", "history: unknown").replace("depth: 10", "depth: 0"))
    with BagReader(folder) as reader:
        assert reader.offered_qos()["/odom"] == [TopicQos()]
