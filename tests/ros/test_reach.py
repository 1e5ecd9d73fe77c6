"""Which clients reach a simulation, from this machine and from another one."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.hosts import Hosts, plain_environment
from support.simulation import Launched, require

require("rclpy", "gibson_msgs", "pybullet")

VISITOR = Path(__file__).resolve().parents[1] / "support" / "visitor.py"
NOTHING = {"nodes": [], "topics": [], "clocks": 0, "service": False, "answers": [], "moved": False}
LOOK_S = 6
"""Wall time in which a client must find nothing, s: one that can reach the simulation finds it in two seconds."""
FIND_S = 60


@pytest.fixture(scope="module")
def hosts() -> Iterator[Hosts]:
    """Two machines on one network."""
    made = Hosts()
    yield made
    made.close()


class _Simulation(Launched):
    """A simulation on the machine ``here``, with no variables of ROS but those given."""

    def __init__(self, hosts: Hosts, *arguments: str, **variables: str) -> None:
        command = [sys.executable, "-m", "gibson_sim.cli.main", "run", "--scene", "flat", "--no-render", *arguments]
        self._start(hosts.on("here", command), plain_environment(variables))
        self.wait_for_line("reach: ")


def _visit(hosts: Hosts, host: str, *arguments: str, **variables: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(hosts.python(host, str(VISITOR), *arguments, **variables).stdout.splitlines()[-1])
    return found


def _open_addresses(hosts: Hosts) -> set[str]:
    """Returns the addresses that UDP sockets of the machine ``here`` are bound to."""
    rows = [line.split()[1] for line in hosts.read("here", "/proc/net/udp").splitlines()[1:]]
    return {".".join(str(byte) for byte in reversed(bytes.fromhex(row.partition(":")[0]))) for row in rows}


@pytest.mark.parametrize("variables", [{}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}], ids=["default", "localhost"])
def test_local_simulation_is_closed_to_other_machines_and_open_to_plain_clients_of_its_own(
    hosts: Hosts, variables: dict[str, str]
) -> None:
    simulation = _Simulation(hosts, **variables)
    try:
        assert any("reach: processes of this machine alone" in line for line in simulation.lines)
        assert _open_addresses(hosts) == {"127.0.0.1"}
        peer = {"ROS_STATIC_PEERS": hosts.addresses["here"]}
        assert _visit(hosts, "there", str(LOOK_S), "end") == NOTHING
        assert _visit(hosts, "there", str(LOOK_S), "end", **peer) == NOTHING
        assert _visit(hosts, "there", str(LOOK_S), "end", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", **peer) == NOTHING
        assert simulation.process.poll() is None
        # A plain client beside it, in the open, does not open it either.
        found = _visit(hosts, "here", str(FIND_S))
        assert (found["topics"], found["clocks"] > 0, found["moved"]) == (["/scan", "/scene", "/tf"], True, True)
        assert "physics" in found["nodes"]
        alone = _visit(hosts, "here", str(FIND_S), "end", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        assert (alone["moved"], alone["answers"]) == (True, [1])
        assert simulation.wait() == 0
    finally:
        simulation.stop()


def test_simulation_of_the_subnet_is_open_to_other_machines_and_reports_it(hosts: Hosts) -> None:
    simulation = _Simulation(hosts, "--reach", "subnet")
    try:
        assert any("reach: every machine of this network may see and command it" in line for line in simulation.lines)
        found = _visit(hosts, "there", str(FIND_S), "end")
        assert (found["moved"], found["answers"]) == (True, [1])
        assert simulation.wait() == 0
    finally:
        simulation.stop()


def test_variables_of_ros_decide_where_no_reach_is_given_and_are_overruled_where_it_is(hosts: Hosts) -> None:
    peers = {"ROS_STATIC_PEERS": hosts.addresses["there"]}
    simulation = _Simulation(hosts, **peers)
    try:
        assert any(f"reach: as ROS_STATIC_PEERS={peers['ROS_STATIC_PEERS']} says" in line for line in simulation.lines)
    finally:
        simulation.stop()
    simulation = _Simulation(hosts, "--reach", "local", ROS_LOCALHOST_ONLY="0", FASTDDS_BUILTIN_TRANSPORTS="UDPv4", **peers)
    try:
        assert _open_addresses(hosts) == {"127.0.0.1"}
        assert _visit(hosts, "there", str(LOOK_S), "end", ROS_STATIC_PEERS=hosts.addresses["here"]) == NOTHING
    finally:
        simulation.stop()


def test_missing_loopback_interface_is_reported(hosts: Hosts) -> None:
    command = ["unshare", "--net", sys.executable, "-m", "gibson_sim.cli.main", "run", "--scene", "flat", "--no-render"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "127.0.0.1 cannot be reached (Network is unreachable), which the nodes need for discovery" in done.stderr


def test_our_client_that_finds_nothing_on_this_machine_says_how_to_search_on_others(hosts: Hosts) -> None:
    simulation = _Simulation(hosts, "--reach", "subnet")
    try:
        drive = ["-m", "gibson_sim.cli.main", "drive", "forward", "--length", "0.2", "--timeout"]
        command = hosts.on("there", [sys.executable, *drive, "4"])
        launched = Launched.__new__(Launched)
        launched._start(command, plain_environment({}))
        assert launched.wait() == 1
        assert any("or look for one on other machines with --reach subnet" in line for line in launched.lines)
        assert "commands" in hosts.python("there", *drive, "60", "--reach", "subnet").stderr
    finally:
        simulation.stop()
