"""The outputs that are drawn for the requested messages."""

from __future__ import annotations

from support.simulation import require

require("rclpy", "gibson_msgs")

import pytest  # noqa: E402

from gibson_sim.config import RenderConfig  # noqa: E402
from gibson_sim.ros.topics import names  # noqa: E402
from gibson_sim.ros.topics.camera_messages import COMPRESSED, COMPRESSED_DEPTH, POINTS, CameraMessages  # noqa: E402
from gibson_sim.types import OUTPUTS, CameraSpec  # noqa: E402

CAMERA = CameraSpec("camera", "r/base_link", outputs=("rgb", "depth", "normal"))


@pytest.mark.parametrize(
    ("wanted", "outputs"),
    [
        ({"depth"}, ("depth",)),
        ({"normal", "rgb"}, ("rgb", "normal")),
        ({COMPRESSED}, ("rgb",)),
        ({COMPRESSED_DEPTH, "rgb_info"}, ("depth",)),
        ({POINTS}, ("rgb", "depth")),
    ],
)
def test_only_outputs_needed_for_the_messages_are_drawn(wanted: set[str], outputs: tuple[str, ...]) -> None:
    drawn = CameraMessages(CAMERA, RenderConfig()).to_draw(frozenset(wanted))
    assert drawn is not None
    assert drawn.outputs == outputs


@pytest.mark.parametrize("wanted", [set(), {"rgb_info"}])
def test_nothing_is_drawn_for_no_message_nor_for_a_calibration(wanted: set[str]) -> None:
    assert CameraMessages(CAMERA, RenderConfig()).to_draw(frozenset(wanted)) is None


def test_the_same_messages_are_made_of_the_same_camera_whose_numbers_a_renderer_remembers() -> None:
    messages = CameraMessages(CAMERA, RenderConfig())
    first = messages.to_draw(frozenset({"rgb", "depth"}))
    assert messages.to_draw(frozenset({"depth"})) is not first
    assert messages.to_draw(frozenset({"depth", "rgb"})) is first


def test_topics_of_images_are_those_that_a_camera_publishes_but_for_its_calibrations() -> None:
    camera = CameraSpec("camera", "r/base_link", outputs=OUTPUTS)
    published = {
        topic for kind, _, topic in CameraMessages(camera, RenderConfig(), camera).topics() if not kind.endswith("_info")
    }
    assert set(names.image_topics("camera", OUTPUTS)) == published
    assert names.image_topics("camera", ("normal",)) == ("camera/normal/image_raw",)
