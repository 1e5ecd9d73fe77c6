"""Nodes of ``gibson-sim bench table1`` and ``bench soak``: a subscriber that drives in a free-running simulation; messages without a simulation."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import Image

from gibson_msgs.msg import SceneState as RosSceneState
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.ros import conversions
from gibson_sim.ros.nodes.node_main import make_executor
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.fast_publish import FastSceneState, image_to_bytes
from gibson_sim.types import NS_PER_S, WORLD_FRAME, SceneState
from gibson_sim_bench.nodes.spinning import make_spinner, spin_for, spin_until
from gibson_sim_bench.protocol import SETTLE_S, STEP_HZ, RandomCommands

STATE, IMAGE = "gibson_sim_bench/state", "gibson_sim_bench/image"
WARM_UP = 20
"""Round trips of the warm-up, which do not count."""
FREE_WARM_UP_S = 0.5
"""Wall time of the warm-up of each case, which does not count, seconds."""
_PIXELS: dict[str, tuple[str, type[np.generic], tuple[int, ...]]] = {
    "rgb": ("rgb8", np.uint8, (3,)),
    "depth": ("32FC1", np.float32, ()),
    "semantic": ("16UC1", np.uint16, ()),
    "instance": ("16UC1", np.uint16, ()),
    "normal": ("32FC3", np.float32, (3,)),
    "normal_world": ("32FC3", np.float32, (3,)),
    "position": ("32FC3", np.float32, (3,)),
    "flow": ("32FC2", np.float32, (2,)),
    "hole": ("8UC1", np.uint8, ()),
}
"""Encoding, element type and shape of a pixel, by output."""


class ImageSetCounter:
    """Subscribes to the image topics of one case at a time, as bytes, and counts complete sets: one image per topic, with equal stamps."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscriptions: list[Any] = []
        self._stamps: dict[str, int] = {}
        self.sets: list[int] = []
        """Times at which sets became complete, steady clock, nanoseconds."""

    def subscribe(self, topics: Sequence[str]) -> None:
        """Subscribes to these topics and no others."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._stamps = dict.fromkeys(topics, -1)
        self.sets = []
        self._subscriptions = [
            self._node.create_subscription(Image, topic, partial(self._on_image, topic), qos.SENSOR, raw=True) for topic in topics
        ]

    @property
    def oldest_ns(self) -> float:
        """Stamp up to which all images have arrived; infinite without topics."""
        return min(self._stamps.values(), default=math.inf)

    def _on_image(self, topic: str, message: bytes) -> None:
        if topic not in self._stamps:
            return
        self._stamps[topic] = stamp_ns(message)
        if len(set(self._stamps.values())) == 1:
            self.sets.append(time.monotonic_ns())


class CommandPublisher:
    """Publishes the velocities of ``RandomCommands``."""

    def __init__(self, node: Node, substeps: int) -> None:
        self._publisher = node.create_publisher(Twist, names.CMD_VEL, qos.COMMAND)
        self._commands, self._twist = RandomCommands(substeps), Twist()

    def send(self) -> str:
        """Publishes the next command; returns its topic."""
        self._twist.linear.x, self._twist.angular.z = self._commands.next()
        self._publisher.publish(self._twist)
        return self._publisher.topic_name


def free_running_subscriber(cases: list[list[str]], seconds: float, substeps: int) -> dict[str, Any]:
    """Receives the images of each case for ``seconds`` of wall time, while the simulation runs as fast as possible.

    Returns, for each case, ``received``: times at which its sets became complete; ``ticks``: number of ticks of the simulation,
    from the stamps of the odometry.
    """
    node = Node("bench_controller")
    images, commands, ticks, stamps = ImageSetCounter(node), CommandPublisher(node, substeps), list[int](), list[int]()

    def on_odometry(msg: Odometry) -> None:
        ticks.append(time.monotonic_ns())
        stamps.append(conversions.time_from_msg(msg.header.stamp))
        if len(ticks) % max(1, 24 // substeps) == 0:
            commands.send()

    node.create_subscription(Odometry, names.ODOM, on_odometry, qos.STATE)
    spinner = make_executor()
    spinner.add_node(node)
    spin_until(lambda: bool(stamps) and stamps[-1] >= SETTLE_S * NS_PER_S, spinner, progress=lambda: len(ticks))
    found: dict[str, Any] = {"received": [], "ticks": []}
    for topics in cases:
        images.subscribe(topics)
        spin_until(lambda: bool(ticks and (images.sets or not topics)), spinner, progress=lambda: len(ticks))  # noqa: B023
        spin_for(spinner, FREE_WARM_UP_S)
        for samples in (ticks, stamps, images.sets):
            samples.clear()
        spin_for(spinner, seconds)
        found["received"].append(list(images.sets if topics else ticks))
        found["ticks"].append(round((stamps[-1] - stamps[0]) / NS_PER_S * STEP_HZ / substeps) + 1 if stamps else 0)
    return found


def soak_subscriber(topics: list[str], seconds: float, interval: float) -> dict[str, Any]:
    """Drives in a simulation and receives its images for ``seconds`` of wall time, in intervals.

    Returns, for each interval, ``sets``: number of sets of images received; ``factors``: the real-time factor.
    """
    node = Node("bench_soak")
    images, commands, stamp = ImageSetCounter(node), CommandPublisher(node, 4), [0]

    def on_odometry(msg: Odometry) -> None:
        stamp[0] = conversions.time_from_msg(msg.header.stamp)
        commands.send()

    node.create_subscription(Odometry, names.ODOM, on_odometry, qos.STATE)
    spinner = make_executor()
    spinner.add_node(node)
    images.subscribe(topics)
    spin_until(lambda: bool(images.sets and stamp[0]), spinner)
    found: dict[str, Any] = {"sets": [], "factors": []}
    for _ in range(max(1, round(seconds / interval))):
        before, began = stamp[0], time.monotonic()
        images.sets.clear()
        spin_for(spinner, interval)
        found["sets"].append(len(images.sets))
        found["factors"].append((stamp[0] - before) / NS_PER_S / (time.monotonic() - began))
    return found


def image_pong(outputs: list[list[str]]) -> None:
    """Replies to each set of images with a state until the process ends; images and states are bytes."""
    node = Node("bench_image_pong")
    publisher = node.create_publisher(RosSceneState, STATE, qos.STATE)
    reply = FastSceneState(WORLD_FRAME, 1).serialize(_state(1), ())
    missing: dict[int, int] = {}

    def on_image(case: int, count: int, _: bytes) -> None:
        missing[case] = missing.get(case, count) - 1
        if not missing[case]:
            missing[case] = count
            publisher.publish(reply)

    for case, kinds in enumerate(outputs):
        for k in range(max(1, len(kinds))):
            callback = partial(on_image, case, max(1, len(kinds)))
            node.create_subscription(Image, f"{IMAGE}_{case}_{k}", callback, qos.SENSOR, raw=True)
    spinner = make_executor()
    spinner.add_node(node)
    while rclpy.ok():
        spinner.spin_once(timeout_sec=0.5)


def image_ping(outputs: list[list[str]], width: int, height: int, bodies: int, count: int) -> dict[str, Any]:
    """Publishes sets of images, each after a state has replied to the previous one.

    Returns ``rows``: for each set of outputs the median milliseconds of ``convert`` (a state to bytes and back), ``encode`` (images to
    bytes), ``publish`` and ``transport`` (until the reply arrives). Without outputs one image of one pixel is published.
    """
    node = Node("bench_image_ping")
    replies: list[Any] = []
    subscription = node.create_subscription(RosSceneState, STATE, replies.append, qos.STATE, raw=True)
    spinner = make_spinner("events", node, subscription)
    return {
        "rows": [_message_ms(node, spinner, replies, k, kinds, (width, height), bodies, count) for k, kinds in enumerate(outputs)]
    }


def _message_ms(
    node: Node, spinner: Any, replies: list[Any], case: int, kinds: list[str], size: tuple[int, int], bodies: int, count: int
) -> dict[str, float]:
    images = [_blank_image(kind, size) for kind in kinds] or [("rgb8", np.zeros((1, 1, 3), dtype=np.uint8))]
    publishers = [node.create_publisher(Image, f"{IMAGE}_{case}_{k}", qos.SENSOR) for k in range(len(images))]
    spin_until(lambda: all(p.get_subscription_count() for p in publishers) and bool(node.count_publishers(STATE)), spinner)
    spin_for(spinner, 0.2)
    state, fast = _state(bodies), FastSceneState(WORLD_FRAME, bodies)
    received = conversions.scene_state_to_msg(state, (0,))
    found = []
    for number in range(count + WARM_UP):
        began = time.perf_counter_ns()
        fast.serialize(state, (0,))
        conversions.scene_state_from_msg(received, state.links)
        converted = time.perf_counter_ns()
        messages = [image_to_bytes(pixels, encoding, number, "camera") for encoding, pixels in images]
        encoded = time.perf_counter_ns()
        for publisher, message in zip(publishers, messages, strict=True):
            publisher.publish(message)
        published = time.perf_counter_ns()
        spin_until(lambda: bool(replies), spinner)
        replied = time.perf_counter_ns()
        replies.clear()
        found.append((converted - began, encoded - converted, published - encoded, replied - published))
    medians = np.median(np.array(found[WARM_UP:]), axis=0) / 1e6
    return dict(zip(("convert", "encode", "publish", "transport"), np.round(medians, 5).tolist(), strict=True))


def _blank_image(kind: str, size: tuple[int, int]) -> tuple[str, NDArray[Any]]:
    """Returns the encoding and the zeroed pixels of an output; ``size`` is width and height."""
    encoding, dtype, channels = _PIXELS[kind]
    return encoding, np.zeros((size[1], size[0], *channels), dtype=dtype)


def _state(bodies: int) -> SceneState:
    links = tuple(f"body_{i}/base" for i in range(bodies))
    return SceneState(0, 0, 1, links, *(np.zeros((bodies, width)) for width in (3, 4, 6)))
