"""The executor that waits for messages, services and timers on behalf of a node."""

from __future__ import annotations

import logging
from typing import Literal

from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor

logger = logging.getLogger(__name__)

ExecutorKind = Literal["auto", "events", "standard"]


def make_executor(kind: ExecutorKind = "auto", *, context: Context | None = None) -> Executor:
    """Returns an executor of one thread.

    Args:
        kind: ``events`` reacts to what the middleware reports, and costs the same however much a node has; rclpy calls it
            experimental. ``standard`` is rclpy's SingleThreadedExecutor, which at every turn builds a wait set of all that the
            node has: a quarter of a millisecond in the physics node. ``auto`` is ``events`` where rclpy has it (7.1.4 and later).
        context: Of the nodes to come; None = the default one.

    Raises:
        ImportError: ``events`` is asked for and rclpy has none.
    """
    if kind == "standard":
        return SingleThreadedExecutor(context=context)
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        if kind == "events":
            raise
        logger.info("this rclpy has no EventsExecutor: the standard executor takes more of a processor")
        return SingleThreadedExecutor(context=context)
    executor: Executor = EventsExecutor(context=context)
    return executor
