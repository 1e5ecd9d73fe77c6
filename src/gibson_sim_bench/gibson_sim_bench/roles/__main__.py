"""Processes of the benchmarks: one role each, with options as JSON on the command line and the answer as JSON on stdout."""

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
from gibson_sim_bench.roles.lockstep import controller, one_process
from gibson_sim_bench.roles.table1 import exchange, exchange_back, soak_subscriber, table_free
from gibson_sim_bench.roles.waiting import PATIENCE_S, STRAGGLERS_S, settle, wait_until, waiter_of

PING, PONG, IMAGES = "gibson_sim_bench/ping", "gibson_sim_bench/pong", "gibson_sim_bench/images"
END = "end"
"""``frame_id`` of the last image."""
WARM_UP_S = 1.0
"""Time at the start that does not count, seconds."""


def pong(executor: str, form: str) -> None:
    """Sends every state back until the process ends."""
    node = Node("bench_pong")
    publisher = node.create_publisher(RosSceneState, PONG, qos.STATE)
    subscription = node.create_subscription(RosSceneState, PING, publisher.publish, qos.STATE, raw=form == "bytes")
    waiter = waiter_of(executor, node, subscription)
    while rclpy.ok():
        waiter.spin_once(timeout_sec=0.5)


def ping(executor: str, form: str, bodies: int, count: int) -> dict[str, Any]:
    """Sends states, each after the previous one has come back. Returns ``us``: the round-trip times, microseconds."""
    node = Node("bench_ping")
    publisher = node.create_publisher(RosSceneState, PING, qos.STATE)
    back: list[Any] = []
    subscription = node.create_subscription(RosSceneState, PONG, back.append, qos.STATE, raw=form == "bytes")
    waiter = waiter_of(executor, node, subscription)
    rng = np.random.default_rng(0)
    links = tuple(f"body_{i}/base" for i in range(bodies))
    arrays = [rng.normal(size=(bodies, width)) for width in (3, 4, 6)]
    fast = FastSceneState(WORLD_FRAME, bodies)
    wait_until(lambda: bool(publisher.get_subscription_count() and node.count_publishers(PONG)), waiter)

    def round_trip(step: int) -> float:
        started = time.monotonic_ns()
        state = SceneState(step, step, 0, links, *arrays)
        sent = fast.serialize(state, ()) if form == "bytes" else conversions.scene_state_to_msg(state, ())
        publisher.publish(sent)
        deadline = time.monotonic() + PATIENCE_S
        while not back:
            waiter.spin_once(timeout_sec=0.5)
            # The first one may be lost during discovery.
            if not back and step == 0:
                publisher.publish(sent)
            if time.monotonic() > deadline:
                raise TimeoutError(f"state {step} did not come back within {PATIENCE_S:.0f} s")
        elapsed = (time.monotonic_ns() - started) / 1e3
        back.clear()
        return elapsed

    round_trip(0)
    settle(waiter, 0.5)
    back.clear()
    microseconds = [round_trip(step) for step in range(1, count + count // 10 + 1)]
    return {"us": microseconds[-count:]}


def image_source(width: int, height: int, hz: float, count: int) -> dict[str, Any]:
    """Publishes images at a rate, as the render node does, after a warm-up of a second. Returns ``sent``."""
    node = Node("bench_image_source")
    publisher = node.create_publisher(Image, IMAGES, qos.SENSOR)
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    wait_until(lambda: publisher.get_subscription_count() > 0, None)
    warm_up = int(hz * WARM_UP_S)
    start = time.monotonic()
    for number in range(warm_up + count + 1):
        time.sleep(max(0.0, start + number / hz - time.monotonic()))
        label = END if number == warm_up + count else "" if number < warm_up else str(number - warm_up)
        publisher.publish(image_to_bytes(pixels, "rgb8", time.monotonic_ns(), label))
    deadline = time.monotonic() + PATIENCE_S
    while publisher.get_subscription_count() and time.monotonic() < deadline:
        time.sleep(0.05)
    return {"sent": count}


def image_sink(executor: str) -> dict[str, Any]:
    """Receives images until the last. Returns ``ms``: the age of each; its stamp is the time of the steady clock."""
    node = Node("bench_image_sink")
    ages: dict[str, float] = {}

    def on_image(msg: Image) -> None:
        ages[msg.header.frame_id] = (time.monotonic_ns() - conversions.time_from_msg(msg.header.stamp)) / 1e6

    subscription = node.create_subscription(Image, IMAGES, on_image, qos.SENSOR)
    waiter = waiter_of(executor, node, subscription)
    wait_until(lambda: END in ages, waiter)
    return {"ms": [age for label, age in ages.items() if label not in ("", END)]}


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
    """Returns ``offset_s``: the least difference of wall time to the stamp of a /clock message, as it arrives. It is taken over ``seconds``."""
    node, least = Node("bench_clock_arrivals"), [math.inf]

    def on_clock(data: bytes) -> None:
        least[0] = min(least[0], time.time() - stamp_ns(data) / NS_PER_S)

    waiter = waiter_of("events", node, node.create_subscription(Clock, names.CLOCK, on_clock, qos.CLOCK, raw=True))
    settle(waiter, seconds)
    if not math.isfinite(least[0]):
        raise TimeoutError(f"no {names.CLOCK} within {seconds:.0f} s")
    return {"offset_s": least[0]}


def idle_node(executor: str, use_sim_time: bool, parameter_services: bool, seconds: float) -> dict[str, Any]:
    """Only waits. Returns ``cpu_percent``, ``seconds``, and ``clock_s``: the advance of its clock."""
    if executor == "polled":
        return _polling_idle_node(seconds)
    node = Node(
        "bench_listener",
        parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        start_parameter_services=parameter_services,
    )
    waiter = make_executor("events" if executor == "events" else "standard")
    waiter.add_node(node)
    wait_until(lambda: not use_sim_time or node.get_clock().now().nanoseconds > 0, waiter)
    settle(waiter, WARM_UP_S)
    wall, cpu, clock = time.monotonic(), _cpu_s(), node.get_clock().now().nanoseconds
    settle(waiter, seconds)
    passed = time.monotonic() - wall
    return {
        "cpu_percent": 100.0 * (_cpu_s() - cpu) / passed,
        "seconds": passed,
        "clock_s": (node.get_clock().now().nanoseconds - clock) / NS_PER_S if use_sim_time else 0.0,
    }


def _polling_idle_node(seconds: float) -> dict[str, Any]:
    """Only waits, and reads the newest /clock on demand: messages wake no executor."""
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

    wait_until(poll, None)
    time.sleep(WARM_UP_S)
    poll()
    wall, cpu, first = time.monotonic(), _cpu_s(), stamps[-1]
    time.sleep(seconds)
    passed, used = time.monotonic() - wall, _cpu_s() - cpu
    poll()
    return {"cpu_percent": 100.0 * used / passed, "seconds": passed, "clock_s": (stamps[-1] - first) / NS_PER_S}


def pipeline_sink(topics: list[str], seconds: float) -> dict[str, Any]:
    """Receives the states and images of a running simulation once all ``topics`` have had an image.

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
    waiter = make_executor("standard")
    waiter.add_node(node)
    wait_until(lambda: all(images.values()), waiter)
    # Not before: physics holds the first tick until the state has a subscriber, which must be the render node.
    node.create_subscription(RosSceneState, names.SCENE_STATE, on_state, qos.TF)
    wait_until(lambda: bool(states), waiter)
    started = time.monotonic()
    settle(waiter, seconds)
    passed = time.monotonic() - started
    last = states[-1][0]
    settle(waiter, STRAGGLERS_S)
    return {"seconds": passed, "states": [s for s in states if s[0] <= last], "images": images}


def _cpu_s() -> float:
    """Returns the processor time of all threads of this process, seconds: as /proc/self/stat, but with finer resolution."""
    return time.process_time()


ROLES: dict[str, Callable[..., dict[str, Any] | None]] = {
    role.__name__: role
    for role in (
        *(ping, pong, image_source, image_sink, clock_source, clock_arrivals, idle_node, pipeline_sink, one_process, controller),
        *(exchange, exchange_back, table_free, soak_subscriber),
    )
}


def main() -> None:
    """Runs the role named by the first argument with the options in the second, JSON; prints its answer."""
    role, options = sys.argv[1], json.loads(sys.argv[2])
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    end_with_parent()
    keep_large_blocks()
    rclpy.init(args=[])
    try:
        found = ROLES[role](**options)
        if found is not None:
            sys.stdout.write(json.dumps(found) + "\n")
            sys.stdout.flush()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except TimeoutError as error:
        sys.exit(f"error: {role}: {error}")
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
