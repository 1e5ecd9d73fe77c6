"""Spins the nodes of the benchmarks: with an executor or a bare wait set, for a duration or until a condition holds."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeAlias

import rclpy
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from gibson_sim.ros.nodes.node_main import make_executor
from gibson_sim.types import NS_PER_S

TIMEOUT_S = 60.0
"""Longest time for a publisher or subscriber to be discovered or a message to arrive, seconds of wall time; then the node fails."""

IN_TRANSIT_S = 0.5
"""Time that messages in transit are given to arrive, seconds of wall time."""


class WaitSet:
    """A minimal executor: one wait set with one subscription, created once."""

    def __init__(self, node: Node, subscription: Any) -> None:
        self._subscription = subscription
        self._set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Waits for a message, and calls the callback of the subscription for each that has arrived."""
        handle = self._subscription.handle
        with handle, self._set:
            self._set.clear_entities()
            self._set.add_subscription(handle)
            self._set.wait(-1 if timeout_sec is None else int(timeout_sec * NS_PER_S))
            while (message := handle.take_message(self._subscription.msg_type, self._subscription.raw)) is not None:
                self._subscription.callback(message[0])


Spinner: TypeAlias = "Executor | WaitSet"
"""What a node spins with."""


def make_spinner(kind: str, node: Node, subscription: Any) -> Spinner:
    """Returns an executor for a node with one subscription; its kind is ``standard``, ``events`` or ``wait set``."""
    if kind == "wait set":
        return WaitSet(node, subscription)
    executor = make_executor("events" if kind == "events" else "standard")
    executor.add_node(node)
    return executor


def spin_for(spinner: Spinner, seconds: float) -> None:
    """Spins for ``seconds`` of wall time."""
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0 and rclpy.ok():
        spinner.spin_once(timeout_sec=left)


def spin_until(condition: Callable[[], bool], spinner: Spinner | None, progress: Callable[[], int] = lambda: 0) -> None:
    """Spins until ``condition`` holds; without a spinner it polls.

    Raises:
        TimeoutError: it does not hold, and ``progress`` has not increased, for ``TIMEOUT_S``.
    """
    deadline, before = time.monotonic() + TIMEOUT_S, 0
    while not condition():
        if progress() > before:
            deadline, before = time.monotonic() + TIMEOUT_S, progress()
        if time.monotonic() > deadline:
            raise TimeoutError(f"no message within {TIMEOUT_S:.0f} s")
        if spinner is None:
            time.sleep(0.02)
        else:
            spinner.spin_once(timeout_sec=0.05)
