"""Distribution of images to pages."""

from __future__ import annotations

import struct

from gibson_sim.web.videos import IN_FLIGHT, Image, Viewer


def _image(number: int, topic: str = "/a") -> Image:
    return Image(topic, float(number), b"jpeg")


def test_a_page_that_is_slow_gets_the_newest_image_once_it_is_ready() -> None:
    sent: list[float] = []
    viewer = Viewer(lambda image: sent.append(image.stamp_s))
    viewer.watch(("/a",))
    for number in range(10):
        viewer.offer(_image(number))
    assert sent == list(range(IN_FLIGHT))
    viewer.shown("/a")
    assert sent == [*range(IN_FLIGHT), 9]
    viewer.shown("/a")
    assert sent == [*range(IN_FLIGHT), 9]  # nothing newer waits


def test_a_page_gets_only_the_topics_that_it_watches() -> None:
    sent: list[str] = []
    viewer = Viewer(lambda image: sent.append(image.topic))
    viewer.watch(("/a", "/b"))
    for topic in ("/a", "/b", "/c"):
        viewer.offer(_image(0, topic))
    viewer.watch(())
    viewer.offer(_image(1))
    viewer.shown("/a")
    assert sent == ["/a", "/b"]


def test_unexpected_acknowledgements_open_no_window() -> None:
    sent: list[float] = []
    viewer = Viewer(lambda image: sent.append(image.stamp_s))
    viewer.watch(("/a",))
    for _ in range(5):
        viewer.shown("/a")
    for number in range(5):
        viewer.offer(_image(number))
    assert len(sent) == IN_FLIGHT


def test_an_image_goes_over_the_link_with_its_topic_and_stamp() -> None:
    message = Image("/cam", 1.5, b"\xff\xd8").message()
    assert message == struct.pack("<BBHd", 1, 0, 4, 1.5) + b"/cam" + b"\xff\xd8"
