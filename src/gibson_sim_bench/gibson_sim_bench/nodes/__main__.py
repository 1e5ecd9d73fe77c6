"""Runs one node of the benchmarks: ``python -m gibson_sim_bench.nodes NAME OPTIONS``, options and result as JSON, the result on stdout."""

from __future__ import annotations

import json
import logging
import math
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from gibson_msgs.msg import SceneState as RosSceneState
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.ros import conversions
from gibson_sim.ros.nodes.node_main import end_with_parent, keep_large_blocks, make_executor
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.fast_publish import FastClock, FastSceneState, image_to_bytes
from gibson_sim.types import NS_PER_S, WORLD_FRAME, SceneState
from gibson_sim_bench.nodes.lockstep import controller, one_process
from gibson_sim_bench.nodes.spinning import IN_TRANSIT_S, TIMEOUT_S, make_spinner, spin_for, spin_until
from gibson_sim_bench.nodes.table1 import free_running_subscriber, image_ping, image_pong, soak_subscriber

PING, PONG, IMAGES = "gibson_sim_bench/ping", "gibson_sim_bench/pong", "gibson_sim_bench/images"
END = "end"
"""``frame_id`` of the last image."""
WARM_UP_S = 1.0
"""Wall time of the warm-up, which does not count, seconds."""


def pong(executor: str, form: str) -> None:
    """Publishes every received state again until the process ends."""
    node = Node("bench_pong")
    publisher = node.create_publisher(RosSceneState, PONG, qos.STATE)
    subscription = node.create_subscription(RosSceneState, PING, publisher.publish, qos.STATE, raw=form == "bytes")
    spinner = make_spinner(executor, node, subscription)
    while rclpy.ok():
        spinner.spin_once(timeout_sec=0.5)


def ping(executor: str, form: str, bodies: int, count: int) -> dict[str, Any]:
    """Publishes states, each after the previous one has come back. Returns ``us``: the round-trip times, microseconds."""
    node = Node("bench_ping")
    publisher = node.create_publisher(RosSceneState, PING, qos.STATE)
    back: list[Any] = []
    subscription = node.create_subscription(RosSceneState, PONG, back.append, qos.STATE, raw=form == "bytes")
    spinner = make_spinner(executor, node, subscription)
    rng = np.random.default_rng(0)
    links = tuple(f"body_{i}/base" for i in range(bodies))
    arrays = [rng.normal(size=(bodies, width)) for width in (3, 4, 6)]
    fast = FastSceneState(WORLD_FRAME, bodies)
    spin_until(lambda: bool(publisher.get_subscription_count() and node.count_publishers(PONG)), spinner)

    def round_trip(step: int) -> float:
        started = time.monotonic_ns()
        state = SceneState(step, step, 0, links, *arrays)
        sent = fast.serialize(state, ()) if form == "bytes" else conversions.scene_state_to_msg(state, ())
        publisher.publish(sent)
        deadline = time.monotonic() + TIMEOUT_S
        while not back:
            spinner.spin_once(timeout_sec=0.5)
            # The first one may be lost during discovery.
            if not back and step == 0:
                publisher.publish(sent)
            if time.monotonic() > deadline:
                raise TimeoutError(f"state {step} did not return within {TIMEOUT_S:.0f} s")
        elapsed = (time.monotonic_ns() - started) / 1e3
        back.clear()
        return elapsed

    round_trip(0)
    spin_for(spinner, 0.5)
    back.clear()
    microseconds = [round_trip(step) for step in range(1, count + count // 10 + 1)]
    return {"us": microseconds[-count:]}


def image_source(width: int, height: int, hz: float, count: int) -> dict[str, Any]:
    """Publishes RGB images at a rate, as the render node does, after a warm-up of ``WARM_UP_S``. Returns ``sent``: how many."""
    node = Node("bench_image_source")
    publisher = node.create_publisher(Image, IMAGES, qos.SENSOR)
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    spin_until(lambda: publisher.get_subscription_count() > 0, None)
    warm_up = int(hz * WARM_UP_S)
    start = time.monotonic()
    for number in range(warm_up + count + 1):
        time.sleep(max(0.0, start + number / hz - time.monotonic()))
        label = END if number == warm_up + count else "" if number < warm_up else str(number - warm_up)
        publisher.publish(image_to_bytes(pixels, "rgb8", time.monotonic_ns(), label))
    deadline = time.monotonic() + TIMEOUT_S
    while publisher.get_subscription_count() and time.monotonic() < deadline:
        time.sleep(0.05)
    return {"sent": count}


def image_sink(executor: str) -> dict[str, Any]:
    """Receives images until the last. Returns ``ms``: the latency of each, from its stamp, which is taken from the steady clock."""
    node = Node("bench_image_sink")
    latencies: dict[str, float] = {}

    def on_image(msg: Image) -> None:
        latencies[msg.header.frame_id] = (time.monotonic_ns() - conversions.time_from_msg(msg.header.stamp)) / 1e6

    subscription = node.create_subscription(Image, IMAGES, on_image, qos.SENSOR)
    spinner = make_spinner(executor, node, subscription)
    spin_until(lambda: END in latencies, spinner)
    return {"ms": [ms for label, ms in latencies.items() if label not in ("", END)]}


def clock_source(hz: float) -> None:
    """Publishes /clock until the process ends."""
    node = Node("bench_clock")
    publisher = node.create_publisher(Clock, names.CLOCK, qos.CLOCK)
    clock, start, number = FastClock(), time.monotonic(), 0
    while rclpy.ok():
        number += 1
        time.sleep(max(0.0, start + number / hz - time.monotonic()))
        publisher.publish(clock.serialize(round(number * NS_PER_S / hz)))


def clock_arrivals(seconds: float) -> dict[str, Any]:
    """Returns ``offset_s``: the smallest difference between wall time of arrival and stamp of a /clock message, within ``seconds``."""
    node, smallest = Node("bench_clock_arrivals"), [math.inf]

    def on_clock(data: bytes) -> None:
        smallest[0] = min(smallest[0], time.time() - stamp_ns(data) / NS_PER_S)

    spinner = make_spinner("events", node, node.create_subscription(Clock, names.CLOCK, on_clock, qos.CLOCK, raw=True))
    spin_for(spinner, seconds)
    if not math.isfinite(smallest[0]):
        raise TimeoutError(f"no {names.CLOCK} within {seconds:.0f} s")
    return {"offset_s": smallest[0]}


def idle_node(executor: str, use_sim_time: bool, parameter_services: bool, seconds: float) -> dict[str, Any]:
    """Only spins. Returns ``cpu_percent`` of one core, ``seconds`` of wall time, and ``clock_s``: the advance of the node's clock, seconds."""
    if executor == "polled":
        return _polling_idle_node(seconds)
    node = Node(
        "bench_listener",
        parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        start_parameter_services=parameter_services,
    )
    spinner = make_executor("events" if executor == "events" else "standard")
    spinner.add_node(node)
    spin_until(lambda: not use_sim_time or node.get_clock().now().nanoseconds > 0, spinner)
    spin_for(spinner, WARM_UP_S)
    wall, cpu, clock = time.monotonic(), _cpu_s(), node.get_clock().now().nanoseconds
    spin_for(spinner, seconds)
    passed = time.monotonic() - wall
    return {
        "cpu_percent": 100.0 * (_cpu_s() - cpu) / passed,
        "seconds": passed,
        "clock_s": (node.get_clock().now().nanoseconds - clock) / NS_PER_S if use_sim_time else 0.0,
    }


def _polling_idle_node(seconds: float) -> dict[str, Any]:
    """Only sleeps, and takes the newest /clock on demand: messages wake no executor. Returns what ``idle_node`` returns."""
    node = Node("bench_listener", start_parameter_services=False)
    profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    handle = node.create_subscription(Clock, names.CLOCK, lambda msg: None, profile).handle
    stamps: list[int] = []

    def poll() -> bool:
        with handle:
            message = handle.take_message(Clock, False)
        if message is not None:
            stamps.append(conversions.time_from_msg(message[0].clock))
        return message is not None

    spin_until(poll, None)
    time.sleep(WARM_UP_S)
    poll()
    wall, cpu, first = time.monotonic(), _cpu_s(), stamps[-1]
    time.sleep(seconds)
    passed, used = time.monotonic() - wall, _cpu_s() - cpu
    poll()
    return {"cpu_percent": 100.0 * used / passed, "seconds": passed, "clock_s": (stamps[-1] - first) / NS_PER_S}


def pipeline_sink(topics: list[str], seconds: float) -> dict[str, Any]:
    """Receives the states and images of a running simulation once every topic of ``topics`` has published an image.

    Returns ``seconds`` of wall time; ``states``: [stamp, published, number of due cameras]; ``images``: by topic [stamp, published,
    received]. Stamps are simulation time, other times the system's clock, all nanoseconds. The time of publication is the source timestamp
    of the DDS sample; publisher and subscriber are on one machine and share its clock.
    """
    node = Node("bench_pipeline_sink")
    states: list[tuple[int, int, int]] = []
    images: dict[str, list[tuple[int, int, int]]] = {topic: [] for topic in topics}

    def on_image(topic: str, msg: Image, info: dict[str, int]) -> None:
        received = time.time_ns()
        images[topic].append((conversions.time_from_msg(msg.header.stamp), info["source_timestamp"], received))

    def on_state(msg: RosSceneState, info: dict[str, int]) -> None:
        states.append((conversions.time_from_msg(msg.header.stamp), info["source_timestamp"], len(msg.due_cameras)))

    for topic in topics:
        node.create_subscription(Image, topic, partial(on_image, topic), qos.SENSOR)
    # The EventsExecutor passes no message info to callbacks.
    spinner = make_executor("standard")
    spinner.add_node(node)
    spin_until(lambda: all(images.values()), spinner)
    # Not earlier: physics holds the first tick until the state has a subscriber, which must be the render node.
    node.create_subscription(RosSceneState, names.SCENE_STATE, on_state, qos.TF)
    spin_until(lambda: bool(states), spinner)
    started = time.monotonic()
    spin_for(spinner, seconds)
    passed = time.monotonic() - started
    last = states[-1][0]
    spin_for(spinner, IN_TRANSIT_S)
    return {"seconds": passed, "states": [s for s in states if s[0] <= last], "images": images}


def _cpu_s() -> float:
    """Returns the processor time of all threads of this process, seconds: as /proc/self/stat, but with finer resolution."""
    return time.process_time()


NODES: dict[str, Callable[..., dict[str, Any] | None]] = {
    node.__name__: node
    for node in (
        *(ping, pong, image_source, image_sink, clock_source, clock_arrivals, idle_node, pipeline_sink, one_process, controller),
        *(image_ping, image_pong, free_running_subscriber, soak_subscriber),
    )
}


def main() -> None:
    """Runs the node that the first argument names, with the options of the second, JSON; prints its result."""
    name, options = sys.argv[1], json.loads(sys.argv[2])
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    end_with_parent()
    keep_large_blocks()
    rclpy.init(args=[])
    try:
        found = NODES[name](**options)
        if found is not None:
            sys.stdout.write(json.dumps(found) + "\n")
            sys.stdout.flush()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except TimeoutError as error:
        sys.exit(f"error: {name}: {error}")
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
