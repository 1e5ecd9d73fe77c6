"""Checks that camera-sized images arrive complete over DDS on this machine, and measures their latency, between two participants."""

from __future__ import annotations

import sys
import time
from statistics import median

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image

from gibson_sim.ros.conversions import image_to_msg
from gibson_sim.ros.topics import qos

IMAGES, WIDTH, HEIGHT, TIMEOUT_S = 20, 640, 480, 10.0


def main() -> None:
    """Prints one line; exits with 0 if all images arrived complete and in order, otherwise with 1."""
    contexts = [rclpy.Context() for _ in range(2)]
    for context in contexts:
        context.init()
    sender, receiver = (Node(f"dds_check_{i}", context=c, use_global_arguments=False) for i, c in enumerate(contexts))
    topic = f"/gibson_sim_dds_check_{time.time_ns()}"
    publisher = sender.create_publisher(Image, topic, qos.SENSOR)
    received: list[tuple[int, int]] = []
    receiver.create_subscription(Image, topic, lambda msg: received.append((msg.header.stamp.sec, len(msg.data))), qos.SENSOR)
    executor = SingleThreadedExecutor(context=contexts[1])
    executor.add_node(receiver)
    pixels = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    latencies_ms = []
    deadline = time.monotonic() + TIMEOUT_S
    while publisher.get_subscription_count() == 0 and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
    for number in range(1, IMAGES + 1):
        start = time.monotonic()
        publisher.publish(image_to_msg(pixels, "rgb8", number * 1_000_000_000, "x"))
        while len(received) < number and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.05)
        latencies_ms.append((time.monotonic() - start) * 1e3)
    is_complete = received == [(n, pixels.nbytes) for n in range(1, IMAGES + 1)]
    for node, context in zip((sender, receiver), contexts, strict=True):
        node.destroy_node()
        context.try_shutdown()
    if is_complete:
        print(f"{IMAGES} images of {WIDTH}x{HEIGHT} arrived whole and in order, {median(latencies_ms):.1f} ms each (median)")
    else:
        print(f"{len(received)} of {IMAGES} images of {WIDTH}x{HEIGHT} arrived within {TIMEOUT_S:.0f} s", file=sys.stderr)
    sys.exit(0 if is_complete else 1)
