"""Subscribes to a topic with a second type: cmd_vel as TwistStamped, in addition to cmd_vel as Twist."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Thread
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from gibson_sim.ros.topics import qos


class StampedCommands:
    """Queues the messages of topics that the owner's context uses with another type.

    A DDS participant cannot have one topic with two types, so this is a second context with its own thread. The thread only queues messages;
    only the main thread accesses the world.
    """

    def __init__(self, node: Node) -> None:
        self._owner = node
        self._arrived: deque[str] = deque()
        self.types: dict[str, type[Any]] = {}
        """Resolved topic -> message type in this context, for all topics of ``subscribe``."""
        self.on_arrival: Callable[[], Any] = lambda: None
        """Called in this class's thread after each message."""
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

    def subscribe(self, kind: type[Any], topic: str, commands: deque[tuple[str, Any]]) -> Any:
        """Returns a subscription to a topic of the owner that appends (topic, message) to ``commands``."""
        topic = self._owner.resolve_topic_name(topic)
        self.types[topic] = kind

        def receive(msg: Any) -> None:
            commands.append((topic, msg))
            self._arrived.append(topic)
            self.on_arrival()

        return self._node.create_subscription(kind, topic, receive, qos.COMMAND)

    def create_subscription(self, kind: type[Any], topic: str, profile: QoSProfile, callback: Callable[[Any], None]) -> Any:
        """Returns a subscription to a topic of the owner whose callback runs in this class's thread."""
        return self._node.create_subscription(kind, self._owner.resolve_topic_name(topic), callback, profile)

    def pop_arrived(self) -> list[str]:
        """Returns the topic of each message that arrived since the last call. Called by the main thread."""
        return [self._arrived.popleft() for _ in range(len(self._arrived))]

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
