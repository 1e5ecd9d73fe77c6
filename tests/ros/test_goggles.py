"""The node ``goggles``: images in, images out, with stamp, frame and calibration; unusable images are one line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from support.simulation import Listener, require

require("rclpy", "sensor_msgs", "gibson_path_following")

from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402

from gibson_path_following.images.goggles import ColourReference, make_goggles  # noqa: E402
from gibson_path_following.nodes.goggles import GogglesNode  # noqa: E402

pytestmark = pytest.mark.ros
SEEN = np.random.default_rng(2).integers(0, 120, (6, 10, 3)).astype(np.uint8)


def _message(encoding: str = "bgr8") -> Image:
    msg = Image(height=6, width=10, encoding=encoding, step=30, data=SEEN[..., ::-1].tobytes())
    msg.header.frame_id, msg.header.stamp.sec, msg.header.stamp.nanosec = "front_optical", 7, 250
    return msg


@pytest.fixture
def node(listener: Listener) -> Iterator[Any]:
    made = GogglesNode(
        context=listener.node.context, use_global_arguments=False, parameter_overrides=[Parameter("mode", value="histogram")]
    )
    listener._executor.add_node(made)
    yield made
    listener._executor.remove_node(made)
    made.destroy_node()


def test_an_image_comes_out_adapted_with_its_stamp_and_frame_and_the_camera_info_of_that_stamp(
    listener: Listener, node: Any
) -> None:
    images = listener.collect(Image, "goggles/image_raw", qos_profile_sensor_data)
    infos = listener.collect(CameraInfo, "goggles/camera_info", qos_profile_sensor_data)
    publishers = [
        listener.node.create_publisher(kind, f"camera/{name}", 1)
        for kind, name in ((Image, "image_raw"), (CameraInfo, "camera_info"))
    ]
    sent, info = (
        _message(),
        CameraInfo(width=10, height=6, k=[5.0, 0.0, 5.0, 0.0, 5.0, 3.0, 0.0, 0.0, 1.0], header=_message().header),
    )

    def arrived() -> bool:
        for publisher, msg in zip(publishers, (sent, info), strict=True):
            publisher.publish(msg)
        return bool(images and infos)

    listener.spin_until(arrived, "image and calibration")
    out = images[0]
    assert out.header == sent.header and infos[0] == info
    assert (out.encoding, out.height, out.width, out.step) == ("rgb8", 6, 10, 30)
    adapted = make_goggles("histogram", reference=ColourReference.load())(SEEN)
    assert bytes(out.data) == adapted.tobytes() and adapted.mean() > SEEN.mean() + 20


def test_an_image_that_cannot_be_used_is_one_line_and_the_next_one_passes(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    passed: list[Any] = []
    monkeypatch.setattr(node.get_logger(), "error", lambda text, **_: lines.append(text))
    node._image_pub.publish = passed.append
    for msg in (_message("jpeg2000"), Image(encoding="rgb8"), _message()):
        node._on_image(msg)
    assert [line.partition(",")[0] for line in lines] == [
        "camera/image_raw: an image has the encoding 'jpeg2000'",
        "camera/image_raw: an image of 0x0 rgb8 pixels has 0 bytes in rows of 0",
    ]
    assert len(passed) == 1
    assert str(node._queue.counts) == "3 received, 1 adapted, 0 skipped, 2 unusable"


def test_the_images_that_arrive_while_one_is_adapted_are_skipped_except_for_the_newest(
    listener: Listener, node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = listener.collect(Image, "goggles/image_raw", qos_profile_sensor_data)
    publisher = listener.node.create_publisher(Image, "camera/image_raw", 10)
    listener.spin_until(
        lambda: publisher.get_subscription_count() > 0 and node._image_pub.get_subscription_count() > 0, "subscribers"
    )

    def send(*seconds: int) -> None:
        for second in seconds:
            msg = _message()
            msg.header.stamp.sec = second
            publisher.publish(msg)

    def adapt(image: Any) -> Any:
        """Is slow the first time: three more images arrive meanwhile."""
        monkeypatch.setattr(node, "_goggles", lambda image: image)
        send(2, 3, 4)
        return image

    monkeypatch.setattr(node, "_goggles", adapt)
    send(1)
    listener.spin_until(lambda: len(images) == 2, "the first and the newest image")
    assert [msg.header.stamp.sec for msg in images] == [1, 4]
    assert str(node._queue.counts) == "4 received, 2 adapted, 2 skipped, 0 unusable"
