from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.bags.reader import BagReader, image_to_array
from gibson_sim.bags.stamps import nominal_period_ns, stamp_ns
from gibson_sim.errors import RecordError

NS = 1_000_000_000


def _image(messages: Any, *args: Any, **options: Any) -> Any:
    return messages.store.deserialize_cdr(messages.image(*args, **options), "sensor_msgs/msg/Image")


def test_topics_have_type_count_and_durability(write_drive: Callable[..., Path]) -> None:
    with BagReader(write_drive(skip_images=(3,))) as bag:
        topics = bag.topics()
    assert (topics["/camera/image_raw"].type_name, topics["/camera/image_raw"].count) == ("sensor_msgs/msg/Image", 10)
    assert [name for name, info in topics.items() if info.latched] == ["/tf_static"]
    assert not topics["/tf"].stamped and topics["/odom"].stamped


def test_messages_are_decoded_in_order_of_time(write_drive: Callable[..., Path]) -> None:
    with BagReader(write_drive()) as bag:
        got = [(t, msg.pose.pose.position.x) for _, t, msg in bag.messages(["/odom"])]
    assert got == [(NS + i * 100_000_000, pytest.approx(0.1 * i)) for i in range(11)]


def test_own_message_type_is_decoded_from_the_definition_in_the_bag(write_drive: Callable[..., Path]) -> None:
    with BagReader(write_drive()) as bag:
        _, _, state = next(bag.messages(["/scene_state"]))
    assert list(state.poses) == [0, 1, 2, 3, 4, 5, 6]
    assert list(state.due_cameras) == [0]


def test_time_range_includes_its_start_and_excludes_its_stop(write_drive: Callable[..., Path]) -> None:
    with BagReader(write_drive()) as bag:
        times = [t for _, t, _ in bag.raw_messages(["/odom"], start_ns=NS + 200_000_000, stop_ns=NS + 400_000_000)]
    assert times == [NS + 200_000_000, NS + 300_000_000]


def test_unknown_topic_is_named_with_the_known_ones(write_drive: Callable[..., Path]) -> None:
    with BagReader(write_drive()) as bag, pytest.raises(RecordError, match=r"no topic /scan; it has .*/odom"):
        next(bag.messages(["/scan"]))


def test_no_topics_give_no_messages(write_drive: Callable[..., Path]) -> None:
    with BagReader(write_drive()) as bag:
        assert list(bag.messages([])) == []


def test_missing_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="there is no bag at"):
        BagReader(tmp_path / "none")


def test_truncated_bag_suggests_repair(write_drive: Callable[..., Path]) -> None:
    folder = write_drive()
    file = folder / "drive_0.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(RecordError, match="gibson-sim bag repair"):
        BagReader(folder)


def test_closed_bag_cannot_be_read(write_drive: Callable[..., Path]) -> None:
    bag = BagReader(write_drive())
    bag.close()
    bag.close()
    with pytest.raises(RecordError, match="closed"):
        bag.topics()


def test_stamp_is_read_in_both_byte_orders() -> None:
    assert stamp_ns(b"\0\1\0\0" + struct.pack("<iI", 3, 4)) == 3_000_000_004
    assert stamp_ns(b"\0\0\0\0" + struct.pack(">iI", 3, 4)) == 3_000_000_004


@pytest.mark.parametrize("size", [0, 1, 4, 11])
def test_message_that_ends_before_its_stamp_is_refused(size: int) -> None:
    with pytest.raises(RecordError, match=f"a message of {size} bytes ends before its stamp"):
        stamp_ns((b"\0\1\0\0" + struct.pack("<iI", 3, 4))[:size])


def test_rgb_image_keeps_rows_columns_and_colours(messages: Any) -> None:
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    array = image_to_array(_image(messages, 0, pixels, "rgb8"))
    assert array[1, 0].tolist() == [9, 10, 11]
    assert array.shape == (2, 3, 3)


def test_padding_of_rows_is_removed(messages: Any) -> None:
    pixels = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert np.array_equal(image_to_array(_image(messages, 0, pixels, "32FC1", padding=4)), pixels)


def test_sixteen_bit_depth_in_big_endian_is_byte_swapped(messages: Any) -> None:
    message = _image(messages, 0, np.array([[0x0102]], dtype=np.uint16), "16UC1")
    message.is_bigendian = 1
    assert image_to_array(message).tolist() == [[0x0201]]


@pytest.mark.parametrize("side", ["width", "height"])
def test_image_without_pixels_is_an_error(messages: Any, side: str) -> None:
    message = _image(messages, 0, np.zeros((2, 3), dtype=np.uint8), "mono8")
    setattr(message, side, 0)
    with pytest.raises(RecordError, match="has no pixels"):
        image_to_array(message)


def test_short_image_is_an_error(messages: Any) -> None:
    message = _image(messages, 0, np.zeros((2, 3), dtype=np.uint8), "mono8")
    message.data = message.data[:-1]
    with pytest.raises(RecordError, match="5 bytes, must have at least 3 and 6"):
        image_to_array(message)


def test_unknown_encoding_is_an_error(messages: Any) -> None:
    with pytest.raises(RecordError, match="'bayer_rggb8' cannot be read"):
        image_to_array(_image(messages, 0, np.zeros((2, 3), dtype=np.uint8), "bayer_rggb8"))


def test_period_ignores_gaps_and_averages_quantised_steps() -> None:
    # 25 Hz on ticks of 60 Hz: steps of 2 and 3 ticks; one frame is lost.
    ticks = np.array([0, 2, 5, 7, 10, 12, 17, 19, 22])
    assert nominal_period_ns(ticks * 1000) == pytest.approx((2 + 3 + 2 + 3 + 2 + 2 + 3) / 7 * 1000)


def test_period_of_one_stamp_is_zero() -> None:
    assert nominal_period_ns(np.array([5])) == 0.0


def test_damaged_chunk_is_an_error_when_it_is_read(write_drive: Callable[..., Path]) -> None:
    folder = write_drive()
    file = folder / "drive_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(content)
    with BagReader(folder) as bag, pytest.raises(RecordError, match=r"is damaged \(Chunk checksum mismatch"):
        list(bag.raw_messages())
