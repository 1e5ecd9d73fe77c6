from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from gibson_sim.bags.film import write_film, write_film_strip
from gibson_sim.bags.writer import BagWriter
from gibson_sim.cli.main import main
from gibson_sim.errors import RecordError

TICK = 100_000_000
ROBOT, VIEW = "/robot_camera/image_raw", "/view_follow/image_raw"


@pytest.fixture
def bag(messages: Any, tmp_path: Path) -> Path:
    """Returns a bag with a robot's camera at 10 Hz, brighter from tick to tick, and a view of another aspect ratio at every second tick."""
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as writer:
        for topic in (VIEW, ROBOT):
            writer.add_topic(topic, "sensor_msgs/msg/Image")
        for tick in range(1, 10):
            now = tick * TICK
            writer.write(ROBOT, messages.image(now, np.full((48, 64, 3), 20 * tick, np.uint8), "rgb8"), now, now)
            if tick % 2 == 0:
                writer.write(VIEW, messages.image(now, np.full((32, 64, 3), (0, 0, 20 * tick), np.uint8), "rgb8"), now, now)
    return tmp_path / "bag"


def test_a_strip_has_a_row_a_topic_and_a_column_a_moment(bag: Path, tmp_path: Path) -> None:
    strip = cv2.imread(str(write_film_strip(bag, tmp_path / "a.png", columns=3, width=64)))
    assert strip.shape[1] == 3 * 64 + 2 * 4
    # Both have images at ticks 2, 4, 6 and 8; the strip shows the first, one in the middle and the last.
    assert strip[20, [30, 98, 166], 0].tolist() in ([40, 80, 160], [40, 120, 160])
    assert (strip[60, [30, 98, 166], 0] == strip[20, [30, 98, 166], 0]).all()
    assert strip[60, 30].tolist() == [40, 0, 0] and (strip[:, 65] == 255).all() and (strip[49, :] == 255).all()


def test_topics_are_shown_in_the_order_in_which_they_are_named(bag: Path, tmp_path: Path) -> None:
    strip = cv2.imread(str(write_film_strip(bag, tmp_path / "a.png", topics=["view_follow", ROBOT], columns=1, width=64)))
    assert strip[10, 30].tolist() == [40, 0, 0] and strip[60, 30].tolist() == [40, 40, 40]


def test_a_film_stacks_the_images_and_keeps_their_time(bag: Path, tmp_path: Path) -> None:
    with av.open(str(write_film(bag, tmp_path / "a.mp4", width=64, speed=2.0))) as film:
        stream = film.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]
    assert stream.codec_context.name == "h264" and float(stream.average_rate) == 10.0
    assert [frame.shape for frame in frames] == [(80, 64, 3)] * 4
    assert [round(int(frame[24, 32, 0]) / 20) for frame in frames] == [2, 4, 6, 8]


def test_a_part_of_the_run_is_selected_in_seconds(bag: Path, tmp_path: Path) -> None:
    strip = cv2.imread(str(write_film_strip(bag, tmp_path / "a.png", topics=[ROBOT], columns=9, width=64, begin=0.2, end=0.4)))
    assert strip.shape[1] == 3 * 64 + 2 * 4 and strip[20, 30, 0] == 60


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"topics": ["nose"]}, "no images on nose; it has them on: /robot_camera/image_raw, /view_follow/image_raw"),
        ({"begin": 5.0}, "no moment at which all have an image"),
        ({"columns": 0}, "must be 1 to 100"),
    ],
)
def test_invalid_requests_are_refused_with_a_reason(bag: Path, tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises(RecordError, match=words):
        write_film_strip(bag, tmp_path / "a.png", **change)


def test_the_command_makes_several_files_at_once(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(tmp_path / "new" / name) for name in ("a.jpg", "a.mp4")]
    with pytest.raises(SystemExit) as ended:
        main(["bag", "film", str(bag), *files, "--columns", "2"])
    assert ended.value.code == 0 and capsys.readouterr().out.split() == files
    with pytest.raises(SystemExit) as ended:
        main(["bag", "film", str(bag), str(tmp_path / "a.gif")])
    assert ended.value.code == 1 and "must end in .png" in capsys.readouterr().err
