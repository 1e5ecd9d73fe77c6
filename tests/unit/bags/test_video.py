from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gibson_sim.bags.video import image_to_bgr, write_contact_sheet, write_video
from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import RecordError

TICK = 100_000_000


def _frames(path: Path) -> tuple[list[np.ndarray], float]:
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        ok, frame = capture.read()
        if not ok:
            break
        frames.append(frame)
    return frames, capture.get(cv2.CAP_PROP_FPS)


@pytest.fixture
def write_images(messages: Any, tmp_path: Path) -> Callable[..., Path]:
    """Returns a function that writes colour images of 64 x 48 pixels at ticks, each of one (red, green, blue)."""

    def write(images: dict[int, tuple[int, int, int]], depth: dict[int, float] | None = None) -> Path:
        with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
            bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
            if depth is not None:
                bag.add_topic("/camera/depth/image_raw", "sensor_msgs/msg/Image")
            for tick in sorted({*images, *(depth or {})}):
                now = tick * TICK
                if depth is not None and tick in depth:
                    metres = np.full((48, 64), depth[tick], np.float32)
                    bag.write("/camera/depth/image_raw", messages.image(now, metres, "32FC1"), now, now)
                if tick in images:
                    pixels = np.full((48, 64, 3), images[tick], np.uint8)
                    bag.write("/camera/image_raw", messages.image(now, pixels, "rgb8"), now, now)
        return tmp_path / "bag"

    return write


RED, GREEN, BLUE = (200, 0, 0), (0, 200, 0), (0, 0, 200)


def _is(frame: np.ndarray, rgb: tuple[int, int, int]) -> bool:
    """Returns whether the middle of the left half has about this colour, BGR; compression changes it a little."""
    return bool(np.abs(frame[24, 32, ::-1].astype(int) - rgb).max() < 40)


def test_video_decodes_to_the_frames_of_the_bag(write_images: Callable[..., Path], tmp_path: Path) -> None:
    path = write_video(write_images({0: RED, 1: GREEN, 2: BLUE, 3: RED}), tmp_path / "a.mp4")
    frames, fps = _frames(path)
    assert fps == pytest.approx(10.0)
    assert [_is(f, c) for f, c in zip(frames, (RED, GREEN, BLUE, RED), strict=True)] == [True] * 4
    assert frames[0].shape == (48, 64, 3)


def test_depth_is_to_the_right_of_colour(write_images: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_images({0: GREEN, 1: GREEN}, {0: 0.8, 1: np.inf})
    frames, _ = _frames(write_video(folder, tmp_path / "a.mp4"))
    assert frames[0].shape == (48, 128, 3)
    assert _is(frames[0], GREEN)
    blue, green, red = frames[0][24, 96].astype(int)
    assert red > 150 > green and red > blue
    assert frames[1][24, 96].max() < 30


def test_depth_that_arrives_later_is_paired_by_stamp(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        for topic in ("/camera/image_raw", "/camera/depth/image_raw"):
            bag.add_topic(topic, "sensor_msgs/msg/Image")
        for i in range(3):
            bag.write("/camera/image_raw", messages.image(i * TICK, np.full((48, 64, 3), 50 * i, np.uint8), "rgb8"), 0, 0)
        for i in range(3):
            depth = np.full((48, 64), 0.5 if i == 1 else np.nan, np.float32)
            bag.write("/camera/depth/image_raw", messages.image(i * TICK, depth, "32FC1"), 1, 1)
    frames, _ = _frames(write_video(tmp_path / "bag", tmp_path / "a.mp4"))
    assert [int(f[24, 96].max()) > 100 for f in frames] == [False, True, False]


def test_lost_depth_image_is_black_and_delays_nothing(write_images: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_images(dict.fromkeys(range(4), RED), {0: 1.0, 1: 1.0, 3: 1.0})
    frames, _ = _frames(write_video(folder, tmp_path / "a.mp4"))
    assert [int(f[24, 96].max()) > 100 for f in frames] == [True, True, False, True]


def test_lost_frames_do_not_change_the_time(write_images: Callable[..., Path], tmp_path: Path) -> None:
    """Two of seven frames are lost: the frames beside the gap are shown longer."""
    folder = write_images({0: RED, 1: RED, 2: GREEN, 5: BLUE, 6: BLUE})
    frames, fps = _frames(write_video(folder, tmp_path / "a.mp4"))
    assert fps == pytest.approx(10.0)
    assert [_is(f, GREEN) for f in frames] == [False, False, True, True, False, False, False]


def test_twice_the_speed_takes_half_the_time(write_images: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_images(dict.fromkeys(range(21), RED))
    frames, fps = _frames(write_video(folder, tmp_path / "a.mp4", speed=2.0))
    assert (len(frames), fps) == (21, pytest.approx(20.0))


def test_given_rate_drops_frames(write_images: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_images(dict.fromkeys(range(21), RED))
    frames, fps = _frames(write_video(folder, tmp_path / "a.mp4", fps=5.0))
    assert (len(frames), fps) == (11, pytest.approx(5.0))


def test_single_image_makes_a_video_of_one_frame(write_images: Callable[..., Path], tmp_path: Path) -> None:
    frames, _ = _frames(write_video(write_images({3: BLUE}), tmp_path / "a.mp4"))
    assert len(frames) == 1


def test_odd_sizes_are_padded(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/image", "sensor_msgs/msg/Image")
        bag.write("/image", messages.image(0, np.full((33, 51, 3), 128, np.uint8), "bgr8"), 0, 0)
    frames, _ = _frames(write_video(tmp_path / "bag", tmp_path / "a.mp4"))
    assert frames[0].shape == (34, 52, 3)


def test_bag_without_images_is_an_error(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/odom", "nav_msgs/msg/Odometry")
        bag.write("/odom", messages.odometry(0, 0.0, 0.0), 0, 0)
    for make in (write_video, write_contact_sheet):
        with pytest.raises(RecordError, match="has no images: record while the render node runs"):
            make(tmp_path / "bag", tmp_path / "a.mp4")
    with pytest.raises(RecordError, match="/odom holds no images"):
        write_video(tmp_path / "bag", tmp_path / "a.mp4", topics=["/odom"])


def test_video_is_h264_which_browsers_play(write_images: Callable[..., Path], tmp_path: Path) -> None:
    assert _codec(write_video(write_images({0: RED, 1: BLUE}), tmp_path / "a.mp4")) in ("avc1", "h264", "H264")


def _codec(path: Path) -> str:
    code = int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FOURCC))
    return code.to_bytes(4, "little").decode()


def test_folder_of_a_video_is_created(write_images: Callable[..., Path], tmp_path: Path) -> None:
    assert write_video(write_images({0: RED}), tmp_path / "new" / "a.mp4").stat().st_size > 0


# The header of the file, its images, and its index, which is moved before them at the end.
@pytest.mark.parametrize("limit", [0, 700, 1100])
def test_full_disk_ends_a_video_in_one_line(write_images: Callable[..., Path], tmp_path: Path, limit: int) -> None:
    folder = write_images({tick: RED for tick in range(10)})
    whole = write_video(folder, tmp_path / "whole.mp4").stat().st_size
    assert whole > limit
    (tmp_path / "out").mkdir()
    # In a separate process: FFmpeg crashed with SIGSEGV when it could not write the header. -B: byte code would be cut off by the limit, too.
    command = [sys.executable, "-B", "-m", "gibson_sim.cli.main", "bag", "video", str(folder), str(tmp_path / "out/a.mp4")]
    done = subprocess.run(
        command,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, (done.returncode, done.stderr)
    assert done.stderr.startswith(f"gibson-sim: error: cannot write {tmp_path / 'out/a.mp4'}: File too large")
    assert done.stderr.count("\n") == 1
    assert list((tmp_path / "out").iterdir()) == []


def test_size_that_changes_leaves_no_video(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/image", "sensor_msgs/msg/Image")
        for number, width in enumerate((64, 80)):
            bag.write(
                "/image", messages.image(number * TICK, np.zeros((48, width, 3), np.uint8), "bgr8"), number * TICK, number * TICK
            )
    with pytest.raises(RecordError, match="changes its size to 80x48"):
        write_video(tmp_path / "bag", tmp_path / "out/a.mp4")
    assert list((tmp_path / "out").iterdir()) == []


def test_colours_become_bgr(messages: Any) -> None:
    raw = messages.image(0, np.full((1, 1, 3), (1, 2, 3), np.uint8), "rgb8")
    assert image_to_bgr(messages.store.deserialize_cdr(raw, "sensor_msgs/msg/Image"))[0, 0].tolist() == [3, 2, 1]


def test_contact_sheet_shows_evenly_spaced_images_in_reading_order(write_images: Callable[..., Path], tmp_path: Path) -> None:
    colours = {i: (20 * i, 0, 0) for i in range(10)}
    sheet = cv2.imread(str(write_contact_sheet(write_images(colours), tmp_path / "a.png", columns=2, rows=2, width=64)))
    height = sheet.shape[0] // 2
    assert sheet.shape[1] == 128
    middles = [int(sheet[24 + height * (i // 2), 32 + 64 * (i % 2), 2]) for i in range(4)]
    assert middles == [0, 60, 120, 180]


def test_contact_sheet_of_few_images_has_fewer_cells(write_images: Callable[..., Path], tmp_path: Path) -> None:
    sheet = cv2.imread(str(write_contact_sheet(write_images({0: RED, 1: RED}), tmp_path / "a.png", columns=4, rows=4, width=64)))
    assert sheet.shape[1] == 128
    assert 48 < sheet.shape[0] < 64


def test_contact_sheet_puts_depth_below_colour_and_text_below_both(write_drive: Callable[..., Path], tmp_path: Path) -> None:
    sheet = cv2.imread(str(write_contact_sheet(write_drive(), tmp_path / "a.png", columns=1, rows=1, width=320)))
    assert sheet.shape[:2] == (2 * 240 + 40, 320)
    assert sheet[120, 160].tolist() == [0, 100, 200]
    assert sheet[240 + 10, 160].max() == 0  # the upper row has no depth
    assert sheet[240 + 120, 160].max() > 100
    assert sheet[480:, :].max() == 255  # text


def test_stamps_that_span_years_are_refused_before_allocation(write_images: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_images({0: RED, 1: GREEN, 20_000_000_000: BLUE})
    with pytest.raises(RecordError, match=r"the stamps of the images span 2e\+09 s, a video of more than 5,000,000 frames"):
        write_video(folder, tmp_path / "a.mp4")
    assert not (tmp_path / "a.mp4").exists()
