"""How the process of a node ends."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from rclpy.node import Node  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gibson_sim.processes.node_process import PARENT_VARIABLE  # noqa: E402
from gibson_sim.ros.nodes import node_main  # noqa: E402
from gibson_sim.ros.nodes.node_main import PARENT_ENDED, is_running, run_node  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_domain")]


class Talker(Node):
    """Gets a signal in the middle of what it does, publishes once more, and says whether it should go on."""

    def __init__(self) -> None:
        super().__init__("talker")
        self.number = signal.SIGINT
        self._publisher = self.create_publisher(String, "talk", 1)

    def spin(self) -> int:
        before = is_running()
        os.kill(os.getpid(), self.number)
        self._publisher.publish(String(data="late"))
        return 0 if before and not is_running() else 5

    def close(self) -> None:
        pass


class Terminated(Talker):
    """The same, with the other signal."""

    def __init__(self) -> None:
        super().__init__()
        self.number = signal.SIGTERM


class Stuck(Talker):
    """Does not look whether it should go on."""

    def spin(self) -> int:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        return 7


class Orphan(Talker):
    """Its launcher has ended: the kernel says so for each thread of it, the last time while the node cleans up."""

    def spin(self) -> int:
        os.kill(os.getpid(), PARENT_ENDED)
        os.kill(os.getpid(), PARENT_ENDED)
        return 0 if not is_running() else 5

    def close(self) -> None:
        os.kill(os.getpid(), PARENT_ENDED)
        print("cleaned up")


class Broken(Talker):
    """Does what rclpy refuses while all is well."""

    def spin(self) -> int:
        self.create_publisher(String, "not a topic", 1)
        return 0


def ended(make: Any) -> Any:
    with pytest.raises(SystemExit) as end:
        run_node(make, [])
    return end.value.code


def test_a_message_in_progress_during_a_signal_is_sent_before_the_node_ends() -> None:
    assert ended(Talker) == 0
    assert ended(Terminated) == 0


def test_second_signal_ends_a_node_at_once() -> None:
    assert ended(Stuck) == 0


def test_node_whose_launcher_ends_cleans_up_despite_repeated_signals(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(node_main, "end_with_parent", lambda: None)
    monkeypatch.setenv(PARENT_VARIABLE, str(os.getppid()))
    before = signal.getsignal(PARENT_ENDED)
    try:
        assert ended(Orphan) == 0
        os.kill(os.getpid(), PARENT_ENDED)  # while the process ends
    finally:
        signal.signal(PARENT_ENDED, before)
    assert capfd.readouterr().out == "cleaned up\n"


def test_signal_while_a_node_is_made_ends_it_at_once_and_handlers_are_put_back() -> None:
    before = signal.getsignal(signal.SIGINT)

    def make() -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("the signal did not end it")

    assert ended(make) == 0
    assert signal.getsignal(signal.SIGINT) is before


def test_rclpy_errors_are_not_swallowed() -> None:
    with pytest.raises(Exception, match="topic"):
        run_node(Broken, [])


def test_ros_start_up_failure_is_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        run_node(Talker, ["--ros-args", "--no-such-argument"])
    assert end.value.code == 1
    assert capfd.readouterr().err == "error: ROS cannot start: unknown arguments: ['--no-such-argument']\n"
