"""Bags of photographs and of videos."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.images.from_files import CameraSettings, write_bag
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.video_file import write_frames
from gibson_sim.cli.main import main
from gibson_sim.errors import RecordError

NS = 1_000_000_000


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """Three images of 8 x 6 pixels, in reverse order of writing; each is red, by its number."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    for number in (10, 9, 1):
        cv2.imwrite(str(folder / f"frame{number}.png"), np.full((6, 8, 3), (0, 0, 10 * number), np.uint8))
    (folder / "notes.txt").write_text("not an image")
    return folder


def _messages(bag: Path) -> list[tuple[str, Any]]:
    with BagReader(bag) as reader:
        return [(topic, message) for topic, _, message in reader.messages()]


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * NS + int(message.header.stamp.nanosec)


def test_photographs_stand_in_the_order_of_their_numbers_at_the_given_rate(photographs: Path, tmp_path: Path) -> None:
    made = write_bag(photographs, tmp_path / "bag", CameraSettings(rate_hz=4.0))
    images = [message for topic, message in _messages(tmp_path / "bag") if topic == "/camera/image_raw"]
    assert [np.asarray(image.data).reshape(6, 8, 3)[0, 0].tolist() for image in images] == [[10, 0, 0], [90, 0, 0], [100, 0, 0]]
    assert [_stamp_ns(image) for image in images] == [NS, NS + NS // 4, NS + NS // 2]
    assert {(image.encoding, image.header.frame_id, image.step) for image in images} == {("rgb8", "camera_optical_frame", 24)}
    assert (made.images, made.width, made.height, made.seconds) == (3, 8, 6, 0.5)
    assert check_bag(tmp_path / "bag").ok


def test_each_image_comes_after_the_camera_info_that_receivers_need_for_it(photographs: Path, tmp_path: Path) -> None:
    write_bag(photographs, tmp_path / "bag", CameraSettings(rate_hz=4.0))
    order = [(topic, _stamp_ns(message)) for topic, message in _messages(tmp_path / "bag")]
    stamps = (NS, NS + NS // 4, NS + NS // 2)
    assert order == [(topic, stamp) for stamp in stamps for topic in ("/camera/camera_info", "/camera/image_raw")]


def test_camera_info_has_the_field_of_view_or_says_that_there_is_none(photographs: Path, tmp_path: Path) -> None:
    write_bag(photographs, tmp_path / "with", CameraSettings(topic="/front/image", hfov_deg=90.0))
    write_bag(photographs, tmp_path / "without")
    (info, *_) = [message for topic, message in _messages(tmp_path / "with") if topic == "/front/camera_info"]
    focal = 4.0 / math.tan(math.radians(45.0))
    assert np.allclose(info.k, [focal, 0, 3.5, 0, focal, 2.5, 0, 0, 1]) and np.allclose(
        info.p[[0, 2, 5, 6, 10]], info.k[[0, 2, 4, 5, 8]]
    )
    assert (info.width, info.height) == (8, 6)
    (info, *_) = [message for topic, message in _messages(tmp_path / "without") if topic == "/camera/camera_info"]
    assert not np.any(info.k)


def test_compressed_images_are_jpeg_beside_the_raw_topic(photographs: Path, tmp_path: Path) -> None:
    write_bag(photographs, tmp_path / "bag", CameraSettings(compressed=True))
    (first, *_) = [message for topic, message in _messages(tmp_path / "bag") if topic == "/camera/image_raw/compressed"]
    picture = cv2.imdecode(np.asarray(first.data), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == (6, 8, 3) and abs(int(picture[0, 0, 2]) - 10) <= 2
    assert "jpeg" in first.format


def test_a_video_keeps_its_time_and_gives_at_most_the_rate(tmp_path: Path) -> None:
    write_frames(tmp_path / "a.mp4", 20.0, [(1, np.full((32, 48, 3), 20 * k, np.uint8)) for k in range(10)])
    write_bag(tmp_path / "a.mp4", tmp_path / "all")
    write_bag(tmp_path / "a.mp4", tmp_path / "some", CameraSettings(rate_hz=5.0))
    stamps = {
        bag: [_stamp_ns(message) for topic, message in _messages(tmp_path / bag) if topic == "/camera/image_raw"]
        for bag in ("all", "some")
    }
    assert stamps["all"] == [NS + k * NS // 20 for k in range(10)]
    assert stamps["some"] == [NS, NS + NS // 5, NS + 2 * NS // 5]


def test_files_that_cannot_become_a_bag_are_refused_in_one_line_and_leave_none(photographs: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mp4").write_text("no video")
    for source, part in (("empty", "holds no image"), ("none", "neither a folder"), ("text.mp4", "cannot be decoded as a video")):
        with pytest.raises(RecordError, match=part):
            write_bag(tmp_path / source, bag)
    cv2.imwrite(str(photographs / "frame11.png"), np.zeros((6, 9, 3), np.uint8))
    with pytest.raises(RecordError, match=r"frame11\.png has 9x6 pixels, the first image 8x6"):
        write_bag(photographs, bag)
    (photographs / "frame11.png").write_bytes(b"broken")
    with pytest.raises(RecordError, match=r"frame11\.png cannot be decoded"):
        write_bag(photographs, bag)
    assert not bag.exists()


@pytest.mark.parametrize(
    ("values", "part"),
    [({"topic": "camera"}, "not a full topic name"), ({"frame": "a b"}, "not a frame name"), ({"rate_hz": 0.0}, "rate is 0 Hz"),
     ({"hfov_deg": 180.0}, "hfov is 180 degrees")],
)  # fmt: skip
def test_settings_are_checked(values: dict[str, Any], part: str) -> None:
    with pytest.raises(RecordError, match=part):
        CameraSettings(**values)


def test_the_command_reports_what_it_wrote(photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    with pytest.raises(SystemExit) as end:
        main(["bag", "from-images", str(photographs), "--output", str(bag), "--rate", "2", "--hfov", "60"])
    assert end.value.code == 0
    assert capsys.readouterr().out == (f"wrote {bag}: 3 images of 8x6 over 1.00 s on /camera/image_raw and /camera/camera_info\n")
