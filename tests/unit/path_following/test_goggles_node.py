"""The node ``goggles``, fed by hand: the newest image, its camera_info, and topics that cannot be its input."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from support.exif import jpeg_with_orientation
from support.simulation import require

require("rclpy", "sensor_msgs")

from rclpy.node import Node  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image  # noqa: E402

from gibson_path_following.errors import SettingError, ViewError  # noqa: E402
from gibson_path_following.nodes import conversions  # noqa: E402
from gibson_path_following.nodes.camera_infos import CameraInfos  # noqa: E402
from gibson_path_following.nodes.goggles import GogglesNode  # noqa: E402
from gibson_path_following.nodes.image_watch import ImageWatch  # noqa: E402
from support.fed_node import FedNode  # noqa: E402

pytestmark = pytest.mark.ros
K = [5.0, 0.0, 5.0, 0.0, 5.0, 3.0, 0.0, 0.0, 1.0]


def _image(second: int, size: tuple[int, int] = (10, 6)) -> Image:
    width, height = size
    msg = Image(height=height, width=width, encoding="rgb8", step=3 * width, data=bytes([100] * 3 * width * height))
    msg.header.frame_id, msg.header.stamp.sec = "front_optical", second
    return msg


def _info(second: int, width: int = 10, fx: float = 5.0) -> CameraInfo:
    msg = CameraInfo(width=width, height=6, k=[fx, *K[1:]])
    msg.header.frame_id, msg.header.stamp.sec = "info_optical", second
    return msg


Make = Callable[..., FedNode]
OUTPUTS = ("goggles/image_raw", "goggles/camera_info")


@pytest.fixture
def make(feed: Make) -> Make:
    """Makes the node."""
    return lambda **parameters: feed(GogglesNode, **{"mode": "histogram", **parameters})


def _see(fed: FedNode, *seconds: int, size: tuple[int, int] = (10, 6)) -> None:
    for second in seconds:
        fed.receive("camera/image_raw", _image(second, size=size))


def _stamps(fed: FedNode) -> list[tuple[str, int, str]]:
    """Returns type, stamp and frame of what was published, in its order."""
    return [(type(msg).__name__, msg.header.stamp.sec, msg.header.frame_id) for msg in fed.sent(*OUTPUTS)]


# camera_info


def test_the_camera_info_of_an_image_is_the_one_with_its_stamp_as_it_came() -> None:
    infos = CameraInfos(5)
    for second in (1, 2, 3):
        infos.add(_info(second, fx=float(second)))
    assert infos.of_image(_image(2).header, 10, 6) == _info(2, fx=2.0)


def test_without_a_camera_info_of_its_stamp_an_image_gets_the_newest_one_of_its_size() -> None:
    infos = CameraInfos(5)
    for info in (_info(1, fx=1.0), _info(2, fx=2.0), _info(3, width=20)):
        infos.add(info)
    found = infos.of_image(_image(7).header, 10, 6)
    assert found is not None and found.header == _image(7).header and found.k[0] == 2.0
    assert infos.of_image(_image(2).header, 10, 6) == _info(2, fx=2.0), "the message that was copied is unchanged"
    assert infos.of_image(_image(7).header, 30, 6) is None


def test_a_camera_info_of_another_size_or_an_older_one_is_not_that_of_the_image() -> None:
    infos = CameraInfos(5)
    for info in (_info(1), _info(2, width=20)):
        infos.add(info)
    assert infos.of_image(_image(2).header, 10, 6) is None
    assert infos.of_image(_image(2).header, 20, 6) == _info(2, width=20)


def test_the_camera_info_of_the_whole_sensor_is_that_of_a_region_and_of_binned_images() -> None:
    infos = CameraInfos(5)
    region = _info(1, width=40)
    region.roi.width, region.roi.height, region.binning_x, region.binning_y = 20, 6, 2, 1
    uncalibrated = CameraInfo()
    uncalibrated.header.stamp.sec = 2
    for info in (region, uncalibrated):
        infos.add(info)
    assert infos.of_image(_image(1).header, 10, 6) == region
    assert infos.of_image(_image(1).header, 20, 6) is None
    assert infos.of_image(_image(2).header, 10, 6) == uncalibrated


def test_only_the_newest_camera_infos_are_kept() -> None:
    infos = CameraInfos(2)
    for second in (1, 2, 3):
        infos.add(_info(second, fx=float(second)))
    found = infos.of_image(_image(1).header, 10, 6)
    assert found is not None and found.k[0] == 3.0


def test_every_image_is_published_with_a_camera_info_of_its_stamp(make: Make) -> None:
    fed = make()
    fed.receive("camera/camera_info", _info(1))
    _see(fed, 1, 2)
    assert _stamps(fed) == [
        ("CameraInfo", 1, "info_optical"), ("Image", 1, "front_optical"), ("CameraInfo", 2, "front_optical"), ("Image", 2, "front_optical"),
    ]  # fmt: skip


def test_a_camera_info_without_an_image_is_not_published_and_one_of_another_size_is_one_line(make: Make) -> None:
    fed = make()
    fed.receive("camera/camera_info", _info(1, width=20))
    assert _stamps(fed) == []
    _see(fed, 2)
    assert _stamps(fed) == [("Image", 2, "front_optical")]
    assert fed.lines == [
        "an image has 10x6 pixels, /camera/camera_info is of 20x6: such images are published without camera_info; publish that of the same "
        "camera and size"
    ]


def _infos_that_come_late(monkeypatch: pytest.MonkeyPatch, fed: FedNode, *late: list[CameraInfo]) -> None:
    """Lets the node find camera_infos at the n-th look into their queue, at ``late[n]``."""
    queue = iter(late)
    monkeypatch.setattr(
        "gibson_path_following.nodes.goggles.pop_queue",
        lambda of: next(queue, ()) if of is fed.subscription("camera/camera_info") else (),
    )
    monkeypatch.setattr(fed.node, "count_publishers", lambda topic: topic == "/camera/camera_info")


def test_the_first_image_of_each_size_waits_for_its_camera_info(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    fed = make()
    fed.receive("camera/camera_info", _info(1, width=20))
    _see(fed, 1, size=(20, 6))
    _infos_that_come_late(monkeypatch, fed, [], [_info(2, fx=7.0)])
    _see(fed, 2)
    assert fed.sent("goggles/camera_info")[-1] == _info(2, fx=7.0)
    assert _stamps(fed)[2:] == [("CameraInfo", 2, "info_optical"), ("Image", 2, "front_optical")] and fed.lines == []


def test_an_image_does_not_wait_longer_than_allowed_nor_a_second_one_of_its_size(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    fed, slept = make(), list[float]()
    monkeypatch.setattr(
        "gibson_path_following.nodes.goggles.time",
        SimpleNamespace(monotonic=lambda: sum(slept), sleep=slept.append),
    )
    _infos_that_come_late(monkeypatch, fed)
    _see(fed, 1)
    assert 0.05 <= sum(slept) < 0.06 and _stamps(fed) == [("Image", 1, "front_optical")]
    slept.clear()
    _see(fed, 2)
    assert slept == []


def test_an_image_does_not_wait_if_no_camera_info_is_published(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    fed = make()
    monkeypatch.setattr("gibson_path_following.nodes.goggles.time.sleep", lambda _: pytest.fail("it has waited"))
    _see(fed, 1)
    assert _stamps(fed) == [("Image", 1, "front_optical")]


# Images


def test_the_newest_waiting_image_is_adapted_and_counts_are_logged(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    fed = make()
    waiting = [_image(2), _image(3)]
    monkeypatch.setattr(
        "gibson_path_following.nodes.goggles.pop_queue", lambda of: waiting if of is fed.subscription("camera/image_raw") else ()
    )
    _see(fed, 1)
    assert _stamps(fed) == [("Image", 3, "front_optical")]
    waiting.clear()
    fed.expire_timers(10.0)
    fed.expire_timers(10.0)
    _see(fed, 4)
    fed.node.stop()
    assert fed.infos == [
        "images in 10 s: 3 received, 1 adapted, 2 skipped, 0 unusable",
        "images in all: 4 received, 2 adapted, 2 skipped, 0 unusable",
    ]


def test_with_a_longer_queue_all_images_are_received_reliably_and_adapted_in_their_order(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    fed = make(queue_size=100)
    assert fed.subscription("camera/image_raw").qos_profile.reliability == ReliabilityPolicy.RELIABLE
    waiting = [_image(2), _image(3)]
    monkeypatch.setattr(
        "gibson_path_following.nodes.goggles.pop_queue", lambda of: waiting if of is fed.subscription("camera/image_raw") else ()
    )
    _see(fed, 1)
    waiting.clear()
    fed.expire_timers(10.0)
    assert fed.infos == ["images in 10 s: 3 received, 1 adapted, 0 skipped, 0 unusable, 2 waiting"]
    fed.spin_until(lambda: len(_stamps(fed)) == 3, "third image")
    assert [second for _, second, _ in _stamps(fed)] == [1, 2, 3]


def test_a_best_effort_publisher_is_named_where_images_must_be_reliable(make: Make) -> None:
    fed = make(queue_size=7)
    camera = Node("camera", context=fed.node.context)
    camera.create_publisher(Image, "camera/image_raw", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    fed.spin_until(lambda: fed.lines != [], "line about the publisher")
    camera.destroy_node()
    assert fed.lines == [
        "the images on /camera/image_raw are published best effort, and queue_size 7 needs reliable ones; set it to 1, or the publisher's "
        "reliability to reliable"
    ]


def _png(levels: Any, encoding: str) -> CompressedImage:
    return CompressedImage(format=f"{encoding}; png compressed", data=cv2.imencode(".png", levels)[1].tobytes())


GREY_16 = np.full((6, 10), 1000, np.uint16)
DEEP = [
    (Image(height=6, width=10, encoding="16UC1", step=20, data=GREY_16.tobytes()), "'16UC1'"),
    (Image(height=6, width=10, encoding="32FC1", step=40, data=bytes(240)), "'32FC1'"),
    (_png(GREY_16, "16UC1"), "'16UC1'"),
    (_png(GREY_16, "mono16"), "'mono16'"),
    (CompressedImage(format="png", data=_png(GREY_16, "").data), "'mono16'"),
    (CompressedImage(format="32FC1; compressedDepth png", data=bytes(12) + bytes(_png(GREY_16, "").data)), "'32FC1'"),
    (CompressedImage(format="16UC1; jpeg compressed mono8", data=cv2.imencode(".jpg", GREY_16 // 256)[1].tobytes()), "'16UC1'"),
]  # fmt: skip


@pytest.mark.parametrize(("msg", "encoding"), DEEP)
def test_depth_and_labels_are_refused_raw_and_compressed_alike(msg: Any, encoding: str) -> None:
    line = f"^an image has the encoding {encoding}, that of depth and labels; choose the topic of the colour images$"
    with pytest.raises(ViewError, match=line):
        conversions.rgb_of(msg)


def test_another_encoding_is_one_that_the_driver_can_change() -> None:
    deep_colour = np.full((6, 10, 3), 1000, np.uint16)
    for msg in (Image(height=6, width=10, encoding="rgb16", step=60, data=deep_colour.tobytes()), _png(deep_colour, "rgb16")):
        with pytest.raises(
            ViewError, match=r"an image has the encoding 'rgb16', must be one of .*; set it in the camera's driver"
        ):
            conversions.rgb_of(msg)


def test_a_compressed_image_of_8_bits_is_used() -> None:
    assert conversions.rgb_of(_png(np.full((6, 10, 3), (1, 2, 3), np.uint8), "bgr8"))[0, 0].tolist() == [3, 2, 1]
    assert conversions.rgb_of(_png(np.full((6, 10), 7, np.uint8), "mono8"))[0, 0].tolist() == [7, 7, 7]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_compressed_image_keeps_its_geometry_whatever_its_exif_orientation(orientation: int) -> None:
    pixels = np.zeros((16, 32, 3), np.uint8)
    pixels[:, :16] = 200
    found = conversions.rgb_of(CompressedImage(format="jpeg", data=jpeg_with_orientation(pixels, orientation)))
    assert found.shape == (16, 32, 3) and found[8, 4].min() > 190 and found[8, 28].max() < 10


# Topics


@pytest.mark.parametrize(
    ("topic", "name"),
    [("goggles/image_raw", "image_raw"), ("/goggles/image_raw", "image_raw"), ("goggles/other", "camera_info")],
)
def test_its_own_output_is_refused_as_its_input(make: Make, topic: str, name: str) -> None:
    with pytest.raises(
        SettingError, match=f"image_topic is '{topic}', but /goggles/{name} is an output of this node; choose the topic of"
    ):
        make(image_topic=topic)


def test_its_own_output_is_refused_when_it_is_remapped(make: Make) -> None:
    with pytest.raises(SettingError, match="is 'camera/image_raw', but /goggles/image_raw is an output of this node"):
        make(cli_args=("--ros-args", "-r", "camera/image_raw:=goggles/image_raw"))


def test_a_topic_of_compressed_images_is_one_when_it_is_remapped(make: Make) -> None:
    def type_of(topic: str, **parameters: Any) -> Any:
        return make(**parameters).subscription(topic).msg_type

    remapped = ("--ros-args", "-r", "camera/image_raw:=front/image_raw/compressed")
    assert type_of("camera/image_raw", cli_args=remapped) is CompressedImage
    assert type_of("front/image_raw/compressed", image_topic="front/image_raw/compressed") is CompressedImage
    assert type_of("camera/image_raw") is Image


class WatchNode(Node):
    def __init__(self, **kwargs: Any) -> None:
        super().__init__("watch", **kwargs)


def test_a_topic_of_another_type_is_named(feed: Make) -> None:
    fed = feed(WatchNode)
    fed.node.create_publisher(CompressedImage, "front", 1)
    watch = ImageWatch(fed.node, {"front": Image}, "parameter image_topic")
    fed.expire_timers(5.0)
    watch.close()
    assert fed.lines == [
        "/front is published as sensor_msgs/msg/CompressedImage, this node subscribes to sensor_msgs/msg/Image there; choose another topic "
        "with parameter image_topic: names that end in /compressed are sensor_msgs/msg/CompressedImage"
    ]
