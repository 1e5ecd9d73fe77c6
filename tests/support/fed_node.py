"""A node that a test feeds by hand, by the names of its topics and services: without discovery and without waiting."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from support.simulation import PATIENCE_S


class FedNode:
    """A node in simulation time, and what it publishes and logs from its first line on.

    Args:
        kind: class of the node.
        context: the ROS context that it lives in.
        cli_args: arguments of ROS, such as a renamed topic.
        parameters: values of its parameters.
    """

    def __init__(self, kind: type[Any], context: Any, cli_args: tuple[str, ...] = (), **parameters: Any) -> None:
        self.lines: list[str] = []
        """Warnings and errors, without throttling."""
        self.infos: list[str] = []
        self._sent: list[tuple[str, Any]] = []
        overrides = [Parameter(name, value=value) for name, value in {"use_sim_time": True, **parameters}.items()]
        self.node: Any = self._recorded(kind)(
            context=context, use_global_arguments=False, cli_args=list(cli_args), parameter_overrides=overrides
        )

    def _recorded(self, kind: type[Any]) -> type[Any]:
        """Returns the class, with notes of what its instance publishes and logs."""
        fed = self

        class Recorded(kind):  # type: ignore[misc]
            def create_publisher(self, *args: Any, **kwargs: Any) -> Any:
                publisher = super().create_publisher(*args, **kwargs)
                topic, publish = publisher.topic_name, publisher.publish

                def note(msg: Any) -> None:
                    fed._sent.append((topic, msg))
                    publish(msg)

                publisher.publish = note
                return publisher

            def get_logger(self) -> Any:
                logger = super().get_logger()
                logger.info = lambda text, **_: fed.infos.append(text)
                logger.warning = logger.error = lambda text, **_: fed.lines.append(text)
                return logger

        return Recorded

    def sent(self, *topics: str) -> list[Any]:
        """Returns the messages that it has published on some topics, in their order."""
        names = {self.node.resolve_topic_name(topic) for topic in topics}
        return [msg for topic, msg in self._sent if topic in names]

    def forget(self) -> None:
        """Forgets what it has published."""
        self._sent.clear()

    def subscription(self, topic: str) -> Any:
        """Returns its subscription to a topic; None = it has none now."""
        name = self.node.resolve_topic_name(topic)
        return next((each for each in self.node.subscriptions if each.topic_name == name), None)

    def receive(self, topic: str, msg: Any) -> None:
        """Brings a message, as the executor would."""
        subscription = self.subscription(topic)
        assert isinstance(msg, subscription.msg_type), f"{topic} is {subscription.msg_type}"
        subscription.callback(msg)

    def call(self, service: str, request: Any = None) -> Any:
        """Returns the response of one of its services."""
        name = self.node.resolve_service_name(service)
        (found,) = (each for each in self.node.services if self.node.resolve_service_name(each.srv_name) == name)
        return found.callback(found.srv_type.Request() if request is None else request, found.srv_type.Response())

    @property
    def now_ns(self) -> int:
        """Simulation time, ns, as /clock gives it; timers wait for ``expire_timers``."""
        return int(self.node.get_clock().now().nanoseconds)

    @now_ns.setter
    def now_ns(self, value: int) -> None:
        msg = Clock()
        msg.clock.sec, msg.clock.nanosec = divmod(value, 1_000_000_000)
        self.receive("/clock", msg)

    def expire_timers(self, period_s: float) -> None:
        """Calls what its timers of this period call."""
        timers = [timer for timer in self.node.timers if timer.timer_period_ns == round(period_s * 1e9)]
        assert timers, f"no timer has a period of {period_s} s"
        for timer in timers:
            timer.callback()

    def spin_until(self, condition: Callable[[], bool], what: str) -> None:
        """Lets an executor work until ``condition`` holds."""
        executor = SingleThreadedExecutor(context=self.node.context)
        executor.add_node(self.node)
        deadline = time.monotonic() + PATIENCE_S
        try:
            while not condition():
                assert time.monotonic() < deadline, f"still no {what} after {PATIENCE_S:.0f} s"
                executor.spin_once(timeout_sec=0.05)
        finally:
            executor.shutdown(timeout_sec=PATIENCE_S)

    def close(self) -> None:
        self.node.destroy_node()
