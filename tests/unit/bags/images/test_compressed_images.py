"""Images are recorded as image_transport compresses them, and read like raw ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.export.read import camera_images, find_cameras
from gibson_sim.bags.film import film_topics
from gibson_sim.bags.images.compress import ImageCompressor, ImageStream, size_line
from gibson_sim.bags.images.decode import COMPRESSED, base_topic, raw_image
from gibson_sim.bags.reader import BagReader, image_to_array
from gibson_sim.bags.video import image_topics, write_contact_sheet
from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import RecordError

NS, TICK = 1_000_000_000, 100_000_000


def compressed(messages: Any, encoding: str, pixels: np.ndarray, topic: str = "/camera/image_raw") -> tuple[str, Any]:
    """Returns topic and message of an image after the compressor."""
    with ImageCompressor() as compressor:
        compressor.add_topic(topic)
        ((to, data, original),) = compressor.compress([(topic, messages.image(7 * NS + 1, pixels, encoding))])
    assert original == topic
    return to, messages.store.deserialize_cdr(data, COMPRESSED if to != topic else "sensor_msgs/msg/Image")


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8"])
def test_colours_become_a_jpeg_of_the_same_picture(messages: Any, encoding: str) -> None:
    """Red on the left, green on the right: swapped channels would make it blue."""
    rgb = np.zeros((48, 64, 3), dtype=np.uint8)
    rgb[:, :32], rgb[:, 32:] = (200, 20, 20), (20, 200, 20)
    topic, msg = compressed(messages, encoding, rgb if encoding == "rgb8" else rgb[..., ::-1])
    assert (topic, msg.format) == ("/camera/image_raw/compressed", f"{encoding}; jpeg compressed bgr8")
    assert bytes(msg.data[:2]) == b"\xff\xd8"
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (7, 1, "camera_optical_frame")
    image = raw_image(msg)
    assert image.encoding == "bgr8"
    assert np.abs(image_to_array(image)[..., ::-1].astype(int) - rgb)[:, [5, 60]].max() < 12


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
def test_labels_stay_exactly_what_they_were(messages: Any, encoding: str) -> None:
    labels = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 21
    topic, msg = compressed(messages, encoding, labels, "/camera/semantic/image_raw")
    assert topic == "/camera/semantic/image_raw/compressed"
    image = raw_image(msg)
    assert (image.encoding, image.width, image.height) == (encoding, 64, 48)
    np.testing.assert_array_equal(image_to_array(image), labels)


def test_depth_keeps_its_metres_but_for_steps_that_grow_with_the_square(messages: Any) -> None:
    depth = np.geomspace(0.2, 90.0, 48 * 64).astype(np.float32).reshape(48, 64)
    depth[0, :3] = np.inf, np.nan, 120.0
    topic, msg = compressed(messages, "32FC1", depth, "/camera/depth/image_raw")
    assert (topic, msg.format) == ("/camera/depth/image_raw/compressedDepth", "32FC1; compressedDepth png")
    image = raw_image(msg)
    found = image_to_array(image)
    assert image.encoding == "32FC1"
    assert np.isnan(found[0, :3]).all(), "no depth beyond 100 m, and none where there was none"
    error = np.abs(found - depth).ravel()[3:]
    assert (error <= 0.51 * depth.ravel()[3:] ** 2 / 10_100 + 1e-4).all(), "half a step of d^2 / 10,100"


def test_grey_images_stay_grey(messages: Any) -> None:
    _, msg = compressed(messages, "mono8", np.full((48, 64), 77, dtype=np.uint8))
    image = raw_image(msg)
    assert (image.encoding, image_to_array(image)[3, 3]) == ("mono8", 77)


def test_images_without_a_compressed_form_stay_raw(messages: Any) -> None:
    normals = np.ones((4, 6, 3), dtype=np.float32)
    topic, msg = compressed(messages, "32FC3", normals, "/camera/normal/image_raw")
    assert topic == "/camera/normal/image_raw"
    np.testing.assert_array_equal(image_to_array(msg), normals)


def test_messages_keep_their_order_and_others_their_bytes(messages: Any) -> None:
    """The first image takes by far the longest."""
    large, small = np.zeros((2000, 2000, 3), np.uint8), np.zeros((2, 2, 3), np.uint8)
    sent = [("/a", messages.image(0, large, "rgb8")), ("/odom", b"1"), ("/a", messages.image(1, small, "rgb8")), ("/odom", b"2")]
    with ImageCompressor() as compressor:
        compressor.add_topic("/a")
        found = list(compressor.compress(sent))
    assert [topic for topic, _, _ in found] == ["/a/compressed", "/odom", "/a/compressed", "/odom"]
    assert [data for topic, data, _ in found if topic == "/odom"] == [b"1", b"2"]
    assert len(found[0][1]) > len(found[2][1])


def test_image_with_too_few_bytes_is_recorded_as_it_came(messages: Any) -> None:
    message = messages.types["sensor_msgs/msg/Image"](
        header=messages.header(0), height=100, width=100, encoding="rgb8", is_bigendian=0, step=300, data=np.zeros(3, np.uint8)
    )
    data = messages.cdr(message)
    with ImageCompressor() as compressor:
        compressor.add_topic("/a")
        assert list(compressor.compress([("/a", data)])) == [("/a", data, "/a")]


def test_damaged_compressed_image_is_an_error(messages: Any) -> None:
    _, msg = compressed(messages, "rgb8", np.zeros((48, 64, 3), np.uint8))
    msg.data = msg.data[:20]
    with pytest.raises(RecordError, match="cannot be decoded"):
        raw_image(msg)
    _, depth = compressed(messages, "32FC1", np.ones((48, 64), np.float32))
    depth.data = depth.data[:30]
    with pytest.raises(RecordError, match="cannot be decoded"):
        raw_image(depth)


@pytest.fixture
def compressed_drive(messages: Any, tmp_path: Path) -> Path:
    """A bag with compressed colour, depth and labels of one camera, five of each."""
    with BagWriter(tmp_path / "drive", reserve_bytes=0) as bag, ImageCompressor() as compressor:
        for folder in ("/camera", "/camera/depth", "/camera/semantic"):
            compressor.add_topic(f"{folder}/image_raw")
            bag.add_topic(f"{folder}/camera_info", "sensor_msgs/msg/CameraInfo")
        for topic in (
            "/camera/image_raw/compressed",
            "/camera/depth/image_raw/compressedDepth",
            "/camera/semantic/image_raw/compressed",
        ):
            bag.add_topic(topic, COMPRESSED)
        for i in range(5):
            now = i * TICK
            pixels = {
                "/camera": (np.full((48, 64, 3), (220, 30, 30), np.uint8), "rgb8"),
                "/camera/depth": (np.full((48, 64), 2.0, np.float32), "32FC1"),
                "/camera/semantic": (np.full((48, 64), 3, np.uint16), "16UC1"),
            }
            for folder, (values, encoding) in pixels.items():
                bag.write(f"{folder}/camera_info", messages.camera_info(now, 64, 48), now, now)
                for topic, data, _ in compressor.compress([(f"{folder}/image_raw", messages.image(now, values, encoding))]):
                    bag.write(topic, data, now, now)
    return tmp_path / "drive"


def test_contact_sheet_shows_compressed_colour_above_its_depth(compressed_drive: Path, tmp_path: Path) -> None:
    sheet = cv2.imread(str(write_contact_sheet(compressed_drive, tmp_path / "sheet.png", 1, 1, width=64)))
    assert sheet is not None
    blue, green, red = (int(value) for value in sheet[20, 20])
    assert red > 180 and max(blue, green) < 70
    assert sheet[60, 20].any(), "depth in false colours below"


def test_film_finds_a_camera_by_its_name(compressed_drive: Path) -> None:
    with BagReader(compressed_drive) as bag:
        assert film_topics(bag, ["camera", "camera/depth"]) == [
            "/camera/image_raw/compressed",
            "/camera/depth/image_raw/compressedDepth",
        ]
        assert film_topics(bag) == ["/camera/image_raw/compressed"]


def test_export_groups_compressed_outputs_into_one_camera(compressed_drive: Path) -> None:
    with BagReader(compressed_drive) as bag:
        cameras, notes = find_cameras(bag)
        (camera,) = cameras
        found = {image.output: image for image in camera_images(bag, cameras)}
    assert (camera.name, set(camera.streams), notes) == ("camera", {"rgb", "depth", "semantic"}, ())
    assert camera.lens is not None, "its camera_info"
    assert found["rgb"].encoded() is not None and found["depth"].encoded() is None
    assert found["depth"].metres()[5, 5] == pytest.approx(2.0, abs=0.001)
    assert (found["semantic"].array() == 3).all()


def test_check_compares_compressed_images_with_their_camera_info(compressed_drive: Path, messages: Any) -> None:
    report = check_bag(compressed_drive)
    assert report.ok
    assert not any("camera_info of it" in note for note in report.notes)
    rates = {topic.info.name: topic.rate_hz for topic in report.topics}
    assert rates["/camera/depth/image_raw/compressedDepth"] == pytest.approx(10.0)


def test_raw_form_comes_before_the_compressed_one_of_the_same_images(
    write_drive: Callable[..., Path], messages: Any, tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "both", reserve_bytes=0) as bag:
        for topic, kind in (
            ("/c/image_raw", "sensor_msgs/msg/Image"),
            ("/c/image_raw/compressed", COMPRESSED),
            ("/d/x/compressed", COMPRESSED),
        ):
            bag.add_topic(topic, kind)
            bag.write(topic, messages.image(0, np.zeros((2, 2, 3), np.uint8), "rgb8"), 0, 0)
    with BagReader(tmp_path / "both") as bag:
        assert image_topics(bag) == ["/c/image_raw", "/d/x/compressed"]
    assert base_topic("/d/x/compressedDepth") == "/d/x"


def test_size_line_reports_rate_free_space_and_the_other_form() -> None:
    """640x480 at 30 Hz: 27.6 MB/s of colour and 36.9 MB/s of depth; 10 GB are full after 155 s."""
    streams = [ImageStream("rgb", 640, 480, 30.0), ImageStream("depth", 640, 480, 30.0)]
    raw = size_line(streams, "raw", 10_000_000_000)
    assert raw == (
        "images are recorded raw: up to 3.9 GB per minute (the disk has room for 3 min); "
        "`--record-images compressed` takes about 192 MB, `none` nothing"
    )
    small = size_line(streams, "compressed", 10_000_000_000)
    assert (
        small
        == "images are recorded compressed: about 192 MB per minute (the disk has room for 52 min); raw ones would be 3.9 GB"
    )
    assert "before --compression zstd" in size_line(streams, "raw", 10**10, "zstd")
