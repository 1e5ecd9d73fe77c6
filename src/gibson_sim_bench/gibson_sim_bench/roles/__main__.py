"""The processes that ``gibson-sim bench ros`` measures: one role each, told by JSON on the command line, answered by JSON on stdout."""

from __future__ import annotations

import json
import logging
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
from gibson_sim.ros import conversions
from gibson_sim.ros.nodes.node_main import end_with_parent, keep_large_blocks, make_executor
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.fast_publish import FastClock, FastSceneState, image_to_bytes
from gibson_sim.types import NS_PER_S, WORLD_FRAME, SceneState
from gibson_sim_bench.roles.lockstep import controller, one_process
from gibson_sim_bench.roles.table1 import exchange, exchange_back, soak_listener, table_free
from gibson_sim_bench.roles.waiting import PATIENCE_S, STRAGGLERS_S, settle, wait_until, waiter_of

PING, PONG, IMAGES = "gibson_sim_bench/ping", "gibson_sim_bench/pong", "gibson_sim_bench/images"
END = "end"
"""``frame_id`` of the last image."""
WARM_UP_S = 1.0


def pong(executor: str, form: str) -> None:
    """Sends every state back, until the process is ended."""
    node = Node("bench_pong")
    publisher = node.create_publisher(RosSceneState, PONG, qos.STATE)
    subscription = node.create_subscription(RosSceneState, PING, publisher.publish, qos.STATE, raw=form == "bytes")
    waiter = waiter_of(executor, node, subscription)
    while rclpy.ok():
        waiter.spin_once(timeout_sec=0.5)


def ping(executor: str, form: str, bodies: int, count: int) -> dict[str, Any]:
    """Sends states, each when the one before has come back. Returns ``us``: how long each took, microseconds."""
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
            # The very first may be lost while the peers match.
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
    """Sends images at a rate, as the render node does, after a second of others that do not count. Returns ``sent``."""
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
    """Takes images until the last. Returns ``ms``: how old each was, which carries the steady clock's time as its stamp."""
    node = Node("bench_image_sink")
    ages: dict[str, float] = {}

    def on_image(msg: Image) -> None:
        ages[msg.header.frame_id] = (time.monotonic_ns() - conversions.time_from_msg(msg.header.stamp)) / 1e6

    subscription = node.create_subscription(Image, IMAGES, on_image, qos.SENSOR)
    waiter = waiter_of(executor, node, subscription)
    wait_until(lambda: END in ages, waiter)
    return {"ms": [age for label, age in ages.items() if label not in ("", END)]}


def clock_source(hz: float) -> None:
    """Publishes /clock until the process is ended."""
    node = Node("bench_clock")
    publisher = node.create_publisher(Clock, names.CLOCK, qos.CLOCK)
    clock, start, number = FastClock(), time.monotonic(), 0
    while rclpy.ok():
        number += 1
        time.sleep(max(0.0, start + number / hz - time.monotonic()))
        publisher.publish(clock.serialize(round(number * NS_PER_S / hz)))


def listener(executor: str, use_sim_time: bool, parameter_services: bool, seconds: float) -> dict[str, Any]:
    """Does nothing. Returns ``cpu_percent``, ``seconds``, and ``clock_s``: how far its clock got meanwhile."""
    if executor == "polled":
        return _polling_listener(seconds)
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


def _polling_listener(seconds: float) -> dict[str, Any]:
    """Does nothing either, but takes the newest /clock when it wants to know the time: no executor is woken."""
    node = Node("bench_listener", start_parameter_services=False)
    profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    handle = node.create_subscription(Clock, names.CLOCK, lambda msg: None, profile).handle
    found: list[int] = []

    def look() -> bool:
        with handle:
            taken = handle.take_message(Clock, False)
        if taken is not None:
            found.append(conversions.time_from_msg(taken[0].clock))
        return taken is not None

    wait_until(look, None)
    time.sleep(WARM_UP_S)
    look()
    wall, cpu, first = time.monotonic(), _cpu_s(), found[-1]
    time.sleep(seconds)
    passed, used = time.monotonic() - wall, _cpu_s() - cpu
    look()
    return {"cpu_percent": 100.0 * used / passed, "seconds": passed, "clock_s": (found[-1] - first) / NS_PER_S}


def pipeline_sink(topics: list[str], seconds: float) -> dict[str, Any]:
    """Listens to a running simulation once all ``topics`` have had an image.

    Returns ``seconds`` of wall time; ``states``: [stamp, published, how many cameras are due]; ``images``: by topic [stamp,
    published, received]. Stamps are simulation time, others the system's clock, all nanoseconds. What was published when is what
    the writer's DDS wrote into the sample; it has that clock in common with this process, which is on the same machine.
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
    # The EventsExecutor gives no message info to callbacks.
    waiter = make_executor("standard")
    waiter.add_node(node)
    wait_until(lambda: all(images.values()), waiter)
    # Not before: physics holds the first tick until somebody listens to the state, and that is to be the renderer.
    node.create_subscription(RosSceneState, names.SCENE_STATE, on_state, qos.TF)
    wait_until(lambda: bool(states), waiter)
    started = time.monotonic()
    settle(waiter, seconds)
    passed = time.monotonic() - started
    last = states[-1][0]
    settle(waiter, STRAGGLERS_S)
    return {"seconds": passed, "states": [s for s in states if s[0] <= last], "images": images}


def _cpu_s() -> float:
    """Returns the processor time of this process with all its threads, seconds: what /proc/self/stat counts, but finer."""
    return time.process_time()


ROLES: dict[str, Callable[..., dict[str, Any] | None]] = {
    role.__name__: role
    for role in (
        *(ping, pong, image_source, image_sink, clock_source, listener, pipeline_sink, one_process, controller),
        *(exchange, exchange_back, table_free, soak_listener),
    )
}


def main() -> None:
    """Plays the role named first on the command line with the options in the JSON behind it; prints what it found."""
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
