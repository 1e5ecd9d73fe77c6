"""The command line for machines without ``ros2`` where no simulation runs, and where one is starting."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from support.simulation import PATIENCE_S, Launched, require

require("rclpy", "gibson_msgs")

import rclpy  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from gibson_msgs.msg import RunInfo  # noqa: E402
from gibson_sim.errors import GibsonSimError  # noqa: E402
from gibson_sim.processes.domain_lock import DomainLock  # noqa: E402
from gibson_sim.ros.nodes.physics_node import PhysicsNode  # noqa: E402
from gibson_sim.ros.services import simulation_services  # noqa: E402
from gibson_sim.ros.tools import nodes, params, topics  # noqa: E402
from gibson_sim.ros.tools.hints import PHYSICS  # noqa: E402
from gibson_sim.ros.tools.tool import PATIENCE_S as TOPIC_PATIENCE_S, USUAL_DISCOVERY_S, Tool  # noqa: E402
from gibson_sim.ros.topics.discovery import DISCOVERY_S  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_domain")]


class Counting(Tool):
    """Counts the seconds that it would wait in vain, and does not wait."""

    waited_s = 0.0

    def _discover_usually(self) -> None:
        pass

    def spin_until(self, timeout_s: float, condition: Callable[[], bool] = lambda: False) -> bool:
        holds = condition()
        self.waited_s += 0.0 if holds else timeout_s
        return holds


@pytest.fixture
def tool(ros_domain: int) -> Iterator[Counting]:
    """A tool in this process."""
    rclpy.init(args=[])
    tool = Counting(lambda tool: 0)
    yield tool
    tool.close()
    tool.destroy_node()
    rclpy.try_shutdown()


def _start(*words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "gibson_sim.cli.main", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _run(words: str) -> tuple[int, str, str]:
    """Returns the exit code, stdout and stderr."""
    process = _start(*words.split())
    output, errors = process.communicate(timeout=PATIENCE_S)
    return process.returncode, output, errors


def test_all_tools_say_in_one_line_that_no_simulation_runs(ros_domain: int) -> None:
    reading = (
        "topic list", "topic info /scan", "topic echo /scan", "node list", "node info /physics", "service list", "param list", "action list",
    )  # fmt: skip
    calling = (
        "param list /physics",
        "param get /physics rate",
        "pause",
    )  # later: service list contains services that have clients only
    results = {}
    for commands in (reading, calling):
        with ThreadPoolExecutor(4) as pool:
            results |= dict(zip(commands, pool.map(_run, commands), strict=True))
    hint = f"no simulation runs in ROS domain {ros_domain}; start one with `gibson-sim run`"
    assert [
        (command, result)
        for command, result in results.items()
        if result[:2] != (1, "") or hint not in result[2] or result[2].count("\n") != 1
    ] == []


def test_a_request_is_printed_when_it_is_sent_not_while_its_service_is_awaited() -> None:
    code, output, errors = _run("service call /nothing std_srvs/srv/Trigger")
    assert (code, output) == (1, "") and errors.startswith("waiting for the service '/nothing'\nerror: no ")
    code, output, errors = _run("action send_goal /nothing simulation_interfaces/action/SimulateSteps")
    assert (code, output) == (1, "") and errors.startswith("waiting for the action '/nothing'\nerror: no ")


def test_ctrl_c_while_a_tool_waits_prints_nothing_more_and_is_no_result() -> None:
    process = _start("service", "call", "/nothing")
    assert process.stderr is not None and process.stderr.readline() == "waiting for the service '/nothing'\n"
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, output, errors) == (-signal.SIGINT, "", "")


def test_a_missing_topic_is_awaited_once(tool: Counting) -> None:
    with pytest.raises(GibsonSimError, match="topic '/nothing' has no publisher"):
        topics.topic_info(tool, "/nothing")
    assert tool.waited_s == TOPIC_PATIENCE_S


def test_a_node_that_is_known_but_has_no_parameter_services_offers_no_parameters(
    tool: Counting, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tool, "known_nodes", lambda: ["/bare"])
    with pytest.raises(GibsonSimError, match="node '/bare' offers no parameters"):
        params.param_list(tool, "bare")


def test_a_node_is_not_awaited_because_its_name_begins_like_that_of_a_simulation(
    tool: Counting, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool, "known_nodes", lambda: ["/physics_watch"])
    nodes.node_list(tool)
    assert tool.waited_s == pytest.approx(DISCOVERY_S - USUAL_DISCOVERY_S)
    assert capsys.readouterr() == ("/physics_watch\n", "")


def test_a_simulation_that_loads_its_scene_is_awaited(
    tool: Counting, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool, "known_nodes", lambda: ["/physics", "/render"])
    topics.topic_list(tool)
    errors = capsys.readouterr().err
    assert errors.startswith("waiting for /physics, /render: the simulation is starting\n") and "names may be missing" in errors
    with pytest.raises(GibsonSimError, match="the simulation is starting, waiting for /physics, /render: try again"):
        topics.topic_info(tool, "/camera/image_raw")


def test_the_physics_node_is_awaited_until_its_subscriptions_are_discovered(
    tool: Counting, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tool.create_publisher(RunInfo, "run_info", 1)
    (endpoint,) = tool.get_publishers_info_by_topic(info.topic_name)
    endpoint.node_name = "physics"
    monkeypatch.setattr(tool, "get_publishers_info_by_topic", lambda topic: [endpoint])
    monkeypatch.setattr(tool, "known_nodes", lambda: ["/physics"])
    services: list[tuple[str, list[str]]] = [("/pause", ["std_srvs/srv/Trigger"])]
    monkeypatch.setattr(tool, "get_service_names_and_types_by_node", lambda name, namespace: services)
    assert tool.loading(PHYSICS) == "/physics"
    services.append(("/get_simulation_state", ["simulation_interfaces/srv/GetSimulationState"]))
    assert tool.loading(PHYSICS) == ""


def test_get_simulation_state_is_the_last_subscription_of_the_physics_node(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """DDS announces subscriptions in the order in which they were made: once it is discovered, all are."""
    made: list[str] = []

    def record(owner: Any, method: str, position: int) -> None:
        make = getattr(owner, method)

        def recorded(*args: Any, **kwargs: Any) -> Any:
            made.append(args[position])
            return make(*args, **kwargs)

        monkeypatch.setattr(owner, method, recorded)

    record(Node, "create_subscription", 2)
    record(Node, "create_service", 2)
    record(simulation_services, "ActionServer", 2)
    rclpy.init(args=[])
    parameters = [
        Parameter(name, value=value) for name, value in (("scene", "flat"), ("robot", "gibson_bot"), ("lockstep", True))
    ]
    node = PhysicsNode(use_global_arguments=False, parameter_overrides=parameters)
    node.close()
    node.destroy_node()
    rclpy.try_shutdown()
    assert {"cmd_vel", "simulate_steps", "get_current_world"} <= {name.removeprefix("/") for name in made}
    assert made[-1] == "get_simulation_state"


def test_a_simulation_that_is_not_discovered_yet_is_awaited(
    ros_domain: int, tool: Counting, capsys: pytest.CaptureFixture[str]
) -> None:
    lock = DomainLock(ros_domain)
    try:
        with pytest.raises(GibsonSimError, match="no simulation runs"):
            topics.topic_list(tool)
    finally:
        lock.close()
    assert capsys.readouterr().err.startswith("waiting for the physics node: the simulation is starting\n")


@pytest.mark.egl
def test_the_list_of_topics_is_complete_while_a_simulation_starts() -> None:
    launched = Launched("run")
    try:
        launched.wait_for_line("reach:")  # the launcher runs, its nodes start
        code, output, _ = _run("topic list")
    finally:
        launched.stop()
    assert code == 0 and {"/scan", "/camera/image_raw"} <= set(output.split())
