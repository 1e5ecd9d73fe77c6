"""Waiting of the processes of measurements: for messages, for a time, for a condition."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from gibson_sim.ros.nodes.node_main import make_executor
from gibson_sim.types import NS_PER_S

PATIENCE_S = 60.0
"""Longest time for a peer to appear or a message to arrive, seconds; then the role gives up."""

STRAGGLERS_S = 0.5
"""Time for messages in transit to arrive, seconds."""


class WaitSet:
    """The smallest possible executor: one wait set with one subscription, created once."""

    def __init__(self, node: Node, subscription: Any) -> None:
        self._subscription = subscription
        self._set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Waits for messages, and passes all that have arrived to the callback of the subscription."""
        handle = self._subscription.handle
        with handle, self._set:
            self._set.clear_entities()
            self._set.add_subscription(handle)
            self._set.wait(-1 if timeout_sec is None else int(timeout_sec * NS_PER_S))
            while (message := handle.take_message(self._subscription.msg_type, self._subscription.raw)) is not None:
                self._subscription.callback(message[0])


def waiter_of(kind: str, node: Node, subscription: Any) -> Executor | WaitSet:
    """Returns an executor of a kind, ``standard``, ``events`` or ``wait set``, for the one subscription of a node."""
    if kind == "wait set":
        return WaitSet(node, subscription)
    executor = make_executor("events" if kind == "events" else "standard")
    executor.add_node(node)
    return executor


def settle(waiter: Executor | WaitSet, seconds: float) -> None:
    """Spins for some seconds."""
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0 and rclpy.ok():
        waiter.spin_once(timeout_sec=left)


def wait_until(condition: Callable[[], bool], waiter: Executor | WaitSet | None, progress: Callable[[], int] = lambda: 0) -> None:
    """Spins until ``condition`` holds.

    Raises:
        TimeoutError: it does not hold, and ``progress`` has not increased, for ``PATIENCE_S`` seconds.
    """
    deadline, before = time.monotonic() + PATIENCE_S, 0
    while not condition():
        if progress() > before:
            deadline, before = time.monotonic() + PATIENCE_S, progress()
        if time.monotonic() > deadline:
            raise TimeoutError(f"nothing came within {PATIENCE_S:.0f} s")
        if waiter is None:
            time.sleep(0.02)
        else:
            waiter.spin_once(timeout_sec=0.05)
