"""Conversion of messages for the live page: numbers to plot, images to draw, topics to record."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

import cv2  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image, JointState, LaserScan  # noqa: E402

from gibson_sim.ros.web.message_fields import number_at, number_fields, parse_path  # noqa: E402
from gibson_sim.ros.web.plot_subscriptions import plottable  # noqa: E402
from gibson_sim.ros.web.video_subscriptions import VideoSubscriptions, bgr_image  # noqa: E402
from support.exif import jpeg_with_orientation  # noqa: E402

pytestmark = pytest.mark.ros


def test_numbers_of_a_message_are_listed_with_units_and_names() -> None:
    fields = {f.path: (f.unit, f.label) for f in number_fields(Odometry())}
    assert fields["twist.twist.linear.x"] == ("m/s", "") and fields["twist.twist.angular.z"] == ("rad/s", "")
    assert fields["pose.pose.position.y"] == ("m", "") and fields["header.stamp.sec"] == ("s", "")
    assert "pose.covariance[35]" in fields and "child_frame_id" not in fields
    joints = {f.path: (f.unit, f.label) for f in number_fields(JointState(name=["left", "right"], position=[1.0, 2.0]))}
    assert joints["position[1]"] == ("rad or m", "right") and "velocity[0]" not in joints
    assert len(number_fields(LaserScan(ranges=[1.0] * 5000))) < 100


def test_a_number_is_found_by_its_path_and_nothing_else_is() -> None:
    scan = LaserScan(ranges=[1.0, 2.5])
    assert number_at(scan, parse_path("ranges[1]")) == 2.5
    for path in ("ranges[2]", "ranges", "header.frame_id", "header", "nothing", "get_fields_and_field_types", "angle_min[0]"):
        assert number_at(scan, parse_path(path)) is None, path
    for path in ("", "__class__", "ranges[-1]", "a..b", "a[0][1]", "ranges[1", "x." * 20 + "x", "A"):
        with pytest.raises(ValueError, match="is not a field path"):
            parse_path(path)


def test_plotting_skips_the_command_topic_and_large_messages() -> None:
    graph = [
        ("/odom", ["nav_msgs/msg/Odometry"]), ("/cmd_vel", ["geometry_msgs/msg/Twist"]), ("/a", ["x/msg/A", "x/msg/B"]),
        ("/left/cmd_vel", ["geometry_msgs/msg/TwistStamped"]), ("/image", ["sensor_msgs/msg/Image"]),
    ]  # fmt: skip
    assert plottable(graph) == {"/odom": "nav_msgs/msg/Odometry"}


def test_messages_without_numbers_besides_stamps_are_not_plotted() -> None:
    numeric = [
        "nav_msgs/msg/Odometry",
        "sensor_msgs/msg/JointState",
        "nav_msgs/msg/Path",
        "std_msgs/msg/Bool",
        "tf2_msgs/msg/TFMessage",
    ]
    others = [
        "std_msgs/msg/String",
        "std_msgs/msg/Empty",
        "std_msgs/msg/Header",
        "rosgraph_msgs/msg/Clock",
        "nowhere_msgs/msg/Thing",
    ]
    assert list(plottable([(f"/{kind}", [kind]) for kind in numeric + others]).values()) == sorted(numeric)


def _filtered(encoding: str, color: tuple[int, int, int], kind: type, scale: int) -> Image:
    """Returns an image of one colour (red, green, blue) as a sensor with a Bayer filter sees it."""
    pattern = np.array(["rgb".index(letter) for letter in encoding.removeprefix("bayer_")[:4]]).reshape(2, 2)
    data = (np.tile(np.array(color)[pattern], (4, 4)) * scale).astype(kind)
    return Image(encoding=encoding, width=8, height=8, step=8 * data.itemsize, data=data.tobytes())


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_drawn_in_their_colours(pattern: str) -> None:
    for bits, kind, scale in ((8, np.uint8, 1), (16, np.uint16, 256)):
        picture = bgr_image(_filtered(f"bayer_{pattern}{bits}", (200, 100, 40), kind, scale))
        assert picture is not None and picture[4, 4].tolist() == [40, 100, 200]


@pytest.mark.parametrize(
    ("encoding", "order"), [("yuv422", (1, 0, 3, 2)), ("yuv422_yuy2", (0, 1, 2, 3)), ("nv12", ()), ("nv21", ())]
)
def test_yuv_is_drawn_in_its_colours(encoding: str, order: tuple[int, ...]) -> None:
    y, u, v = cv2.cvtColor(np.full((1, 1, 3), (40, 100, 200), np.uint8), cv2.COLOR_BGR2YUV)[0, 0].tolist()
    y, u, v = (
        round(16 + y * 219 / 255),
        round(128 + (u - 128) * 0.89),
        round(128 + (v - 128) * 0.72),
    )  # as cameras send it, BT.601
    if order:
        data = np.tile(np.array([y, u, y, v], np.uint8)[list(order)], 8 * 4)
        image = Image(encoding=encoding, width=8, height=8, step=16, data=data.tobytes())
    else:
        chroma = np.tile(np.array([u, v] if encoding == "nv12" else [v, u], np.uint8), 16)
        image = Image(encoding=encoding, width=8, height=8, step=8, data=bytes([y]) * 64 + chroma.tobytes())
    picture = bgr_image(image)
    assert picture is not None and np.abs(picture[4, 4].astype(int) - (40, 100, 200)).max() < 12, picture[4, 4]


def test_images_with_too_few_bytes_or_an_odd_size_are_not_drawn() -> None:
    for encoding in ("bayer_rggb8", "yuv422", "nv12", "bayer_rggb16"):
        assert bgr_image(Image(encoding=encoding, width=8, height=8, step=8, data=b"1234")) is None
        assert bgr_image(Image(encoding=encoding, width=7, height=7, step=32, data=b"1" * 1000)) is None


def test_compressed_images_are_shown_as_the_sensor_saw_them_whatever_their_exif_orientation() -> None:
    shown: list[bytes] = []
    videos = VideoSubscriptions(None, lambda image: shown.append(image.jpeg))  # type: ignore[arg-type]
    videos._on_compressed("/a", CompressedImage(format="jpeg", data=jpeg_with_orientation(np.zeros((6, 10, 3), np.uint8))))
    assert cv2.imdecode(np.frombuffer(shown[0], np.uint8), cv2.IMREAD_COLOR).shape == (6, 10, 3)
