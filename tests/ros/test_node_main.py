"""How the process of a node ends."""

from __future__ import annotations

from typing import Any

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

import rclpy  # noqa: E402
from rclpy.node import Node  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gibson_sim.ros.node_main import run_node  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_domain")]


class Talker(Node):
    """Publishes once more after something has ended the context, as a callback does that a signal interrupts."""

    def __init__(self) -> None:
        super().__init__("talker")
        self._publisher = self.create_publisher(String, "talk", 1)

    def spin(self) -> int:
        rclpy.shutdown()
        self._publisher.publish(String(data="late"))
        return 0

    def close(self) -> None:
        pass


class Broken(Talker):
    """Does what rclpy refuses while all is well."""

    def spin(self) -> int:
        self.create_publisher(String, "not a topic", 1)
        return 0


def ended(make: Any) -> Any:
    with pytest.raises(SystemExit) as end:
        run_node(make, [])
    return end.value.code


def test_a_message_that_a_signal_overtakes_is_no_error() -> None:
    assert ended(Talker) == 0


def test_what_rclpy_refuses_is_not_swallowed() -> None:
    with pytest.raises(Exception, match="topic"):
        run_node(Broken, [])
