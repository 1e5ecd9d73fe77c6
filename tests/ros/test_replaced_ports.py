"""A port in shared memory whose file another process has removed is opened anew: its reader would receive nothing any more."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from std_msgs.msg import String

from gibson_sim.processes.shared_memory import FOLDER, reopen_replaced_ports
from support.simulation import Listener

_WRITER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("test_writer")
publisher = node.create_publisher(String, "chatter", 10)
node.create_timer(0.05, lambda: publisher.publish(String(data="here")))
rclpy.spin(node)
"""


@pytest.fixture
def writer(ros_domain: int) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", _WRITER], stderr=subprocess.DEVNULL) as process:
        yield process
        process.kill()


def _own_ports() -> list[Path]:
    """Returns the files of the ports in shared memory that this process has open."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return sorted(
        {FOLDER / line.split()[5].rpartition("/")[2] for line in lines if "/fastrtps_port" in line and "(deleted)" not in line}
    )


def test_reader_of_a_replaced_port_receives_again(listener: Listener, request: pytest.FixtureRequest) -> None:
    received = listener.collect(String, "chatter", 10)
    assert reopen_replaced_ports() == [], "all are as they were made"
    for port in _own_ports():
        port.unlink()
    request.getfixturevalue("writer")
    assert reopen_replaced_ports(), "those of this process are gone"
    assert reopen_replaced_ports() == [], "each is marked once"
    listener.spin_until(lambda: bool(received), "a message after the ports were opened anew")
