"""Subscribes to a topic with a second type: cmd_vel as TwistStamped, in addition to cmd_vel as Twist."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from threading import Thread
from typing import Any

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile


class StampedCommands:
    """Subscribes a node to topics that its own context uses with another type.

    A DDS participant cannot have one topic with two types, so this is a second context with its own thread. That thread calls no callback: it
    hands each message to the executor of the node, which calls the callback in the node's thread. A command therefore has the same way in,
    whatever its type, and arrives between two iterations of the node's loop.
    """

    def __init__(self, node: Node) -> None:
        """Creates the context; callbacks are called from ``start`` on."""
        self._owner = node
        self._arrived: deque[tuple[Callable[[Any], None], Any]] = deque()
        """Callback and message of each message that was not delivered yet."""
        self._wake: Callable[[], Any] = lambda: None
        """Lets the node's executor call ``_deliver``; thread-safe."""
        self.types: dict[str, type[Any]] = {}
        """Resolved topic -> message type in this context, for all topics of ``subscribe``."""
        self._context = rclpy.Context()
        self._context.init(domain_id=node.context.get_domain_id())
        self._node = Node(
            f"{node.get_name()}_stamped_commands",
            namespace=node.get_namespace(),
            context=self._context,
            use_global_arguments=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin, name="stamped-commands", daemon=True)
        self._thread.start()

    def subscribe(self, kind: type[Any], topic: str, callback: Callable[[Any], None], profile: QoSProfile) -> Any:
        """Returns a subscription to a topic of the owner; the owner's executor calls ``callback`` with each message, in the order of arrival."""
        topic = self._owner.resolve_topic_name(topic)
        self.types[topic] = kind
        return self._node.create_subscription(kind, topic, partial(self._hand_over, callback), profile)

    def start(self, executor: Executor) -> None:
        """Delivers messages in an executor of the owner from now on, beginning with those that have arrived already."""
        self._wake = partial(executor.create_task, self._deliver)
        self._wake()

    def _hand_over(self, callback: Callable[[Any], None], msg: Any) -> None:
        """Queues a message for the owner. Called by the thread of this context."""
        self._arrived.append((callback, msg))
        self._wake()

    def _deliver(self) -> None:
        """Calls the callbacks of all messages that have arrived. Called by the owner's executor."""
        while self._arrived:
            callback, msg = self._arrived.popleft()
            callback(msg)

    def unsubscribe(self, subscription: Any) -> None:
        """Ends a subscription."""
        self.types.pop(subscription.topic_name, None)
        self._node.destroy_subscription(subscription)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass

    def close(self) -> None:
        """Ends the thread and the context."""
        self._executor.shutdown(timeout_sec=2.0)
        self._context.try_shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()
