"""The command line for machines without ``ros2``, against a running simulation."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from support.completion import completions
from support.simulation import PATIENCE_S, Launched, require

require("rclpy", "gibson_msgs")

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module", autouse=True)
def simulation(ros_domain: int) -> Iterator[Launched]:
    launched = Launched("run", "--no-render")
    launched.wait_for_line("is ready")
    yield launched
    launched.stop()


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a shell keeps names between two presses of TAB."""
    return tmp_path_factory.mktemp("cache")


def _run(*words: str) -> tuple[int, str]:
    """Returns the exit code and all that is printed."""
    done = subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", *words], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def _run_together(*commands: str) -> list[tuple[int, str]]:
    """Returns the same for several commands that do not depend on each other: each mostly waits for discovery.

    Fast DDS reports ports of its shared memory that processes open at the same instant, and takes others; a busy machine takes long enough for
    the notice of what a tool waits for. These lines are left out.
    """
    with ThreadPoolExecutor(len(commands)) as pool:
        found = list(pool.map(lambda command: _run(*shlex.split(command)), commands))
    return [
        (
            code,
            "".join(line for line in text.splitlines(keepends=True) if not re.search("RTPS_TRANSPORT_SHM|^waiting for /", line)),
        )
        for code, text in found
    ]


def test_topics_are_listed_described_and_echoed() -> None:
    names, with_types, info, echo = _run_together(
        "topic list", "topic list -t", "topic info odom", "topic echo --once --field header.frame_id /scan"
    )
    assert {"/odom", "/scan", "/clock"} <= set(names[1].split())
    assert "/odom [nav_msgs/msg/Odometry]\n" in with_types[1]
    assert info == (0, "Type: nav_msgs/msg/Odometry\nPublisher count: 1\nSubscription count: 0\n")
    assert echo == (0, "base_scan\n---\n")


def test_nodes_are_listed_and_described() -> None:
    listed, info, missing = _run_together("node list", "node info physics", "node info /physic")
    assert listed[0] == 0 and "/physics" in listed[1].split() and "_gibson_sim_tool" not in listed[1]
    assert info[0] == 0 and info[1].startswith("/physics\n  Subscribers:\n    /cmd_vel: geometry_msgs/msg/Twist")
    assert "    /odom: nav_msgs/msg/Odometry\n" in info[1].partition("  Publishers:\n")[2]
    assert "    /simulate_steps: simulation_interfaces/action/SimulateSteps\n" in info[1].partition("  Action Servers:\n")[2]
    assert missing == (1, "error: node '/physic' does not exist; did you mean '/physics'?\n")


def test_a_measurement_that_is_interrupted_before_its_end_fails() -> None:
    command = [sys.executable, "-m", "gibson_sim.cli.main", "topic", "hz", "/odom"]
    for options, code in ((("--seconds", "600"), -signal.SIGINT), ((), 0)):
        process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            if "std dev" in line:
                break
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=PATIENCE_S)[0] == "" and process.returncode == code


def test_a_reader_that_ends_ends_a_tool_silently() -> None:
    command = [sys.executable, "-m", "gibson_sim.cli.main", "topic", "echo", "/odom"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == "" and process.wait(PATIENCE_S) == 0


def test_latched_topics_are_echoed_to_late_subscribers() -> None:
    code, text = _run("topic", "echo", "--once", "/map")
    assert code == 0 and "  frame_id: map\n" in text


def test_rate_bandwidth_and_delay_are_measured() -> None:
    rate, bandwidth, delay, without = _run_together(
        "topic hz /odom --seconds 2",
        "topic bw /scan --seconds 2",
        "topic delay /odom --seconds 2",
        "topic delay /clock --seconds 1",
    )
    assert rate[0] == 0 and re.search(r"average rate: \d+\.\d{3}\n\tmin: \d", rate[1])
    assert re.search(r"KB/s from \d+ messages\n\tMessage size mean: ", bandwidth[1])
    assert "average delay: " in delay[1]
    assert without[0] == 1 and "have no header" in without[1]


def test_a_name_that_does_not_exist_is_one_line_with_the_nearest() -> None:
    code, text = _run("topic", "echo", "/odm")
    assert (code, text.count("\n")) == (1, 1) and "did you mean '/odom'?" in text


def test_services_are_listed_and_called() -> None:
    names, kind, entities, missing, *misspelt = _run_together(
        "service list -t",
        "service type /get_entities",
        "service call /get_entities",
        "service call /delete_entity simulation_interfaces/srv/DeleteEntity '{entity: nothing}'",
        "service call /delete_entity '' '{entty: x}'",
        "service call /delete_entity '{entty: x}'",
    )
    assert "/spawn_entity [simulation_interfaces/srv/SpawnEntity]\n" in names[1]
    assert kind[1] == "simulation_interfaces/srv/GetEntities\n"
    assert entities[0] == 0 and "response:\n" in entities[1] and "- robot\n" in entities[1]
    assert missing[0] == 1 and "'nothing'" in missing[1]
    assert all("did you mean 'entity'?" in text for _, text in misspelt)


def test_a_type_that_a_service_or_an_action_does_not_have_is_refused() -> None:
    other = "simulation_interfaces/srv/DeleteEntity"
    service, action, crossed = _run_together(
        f"service call /get_entities {other}",
        "action send_goal simulate_steps control_msgs/action/GripperCommand",
        f"action send_goal /simulate_steps {other}",
    )
    assert service[0] == 1
    assert service[1].endswith(f"error: /get_entities has the type simulation_interfaces/srv/GetEntities, not {other}\n")
    assert action[0] == 1 and "/simulate_steps has the type simulation_interfaces/action/SimulateSteps, not control_" in action[1]
    assert crossed[0] == 1 and f"error: type '{other}' is a service; an action type such as " in crossed[1]


def test_an_empty_name_is_refused_in_one_line() -> None:
    commands = (
        "topic echo ''", "topic info ''", "service type ''", "service call ''", "action send_goal '' x", "param get '' x",
        "param list ''", "node info ''",
    )  # fmt: skip
    words = [("topic", 2), ("service", 2), ("action", 1), ("node", 3)]
    expected = [(1, f"error: the name of the {kind} is empty\n") for kind, count in words for _ in range(count)]
    assert _run_together(*commands) == expected


def test_hidden_names_are_listed_only_on_request() -> None:
    action = "/simulate_steps/_action"
    visible = _run_together("topic list", "service list", "node info /physics", "action list")
    assert all(code == 0 and action not in text for code, text in visible)
    assert visible[-1] == (0, "/simulate_steps\n")
    topics, services, info = _run_together(
        "topic list --include-hidden-topics", "service list --include-hidden-services", "node info /physics --include-hidden"
    )
    assert {f"{action}/feedback", f"{action}/status"} <= set(topics[1].split())
    assert {f"{action}/cancel_goal", f"{action}/get_result", f"{action}/send_goal"} <= set(services[1].split())
    assert f"    {action}/status: action_msgs/msg/GoalStatusArray\n" in info[1].partition("  Publishers:\n")[2]


def test_parameters_are_read_and_changed() -> None:
    assert _run("param", "set", "/physics", "rate", "2")[1] == "Set parameter successful\n"
    names, value, mistyped, fixed, misspelt, foreign, stranger = _run_together(
        "param list /physics", "param get /physics rate", "param set /physics rate fast", "param set /physics step_hz 1000",
        "param set /physics step_hx 1000", "param get /physics jpeg_quality", "param get physic rate",
    )  # fmt: skip
    assert "  rate\n" in names[1]
    assert value[1] == "Double value is: 2.0\n"
    assert mistyped[0] == 1 and "must be of type double: a number" in mistyped[1]
    assert fixed == (
        1,
        "error: parameter 'step_hz' of node /physics is read-only: set it when the node starts, "
        "with `--step-hz` of `gibson-sim run`, `-p step_hz:=...` of `ros2 run`\n",
    )
    assert misspelt == (1, "error: node /physics has no parameter 'step_hx'; did you mean 'step_hz'?\n")
    assert foreign[0] == 1 and foreign[1].startswith("error: node /physics has no parameter 'jpeg_quality'; ")
    assert stranger == (1, "error: node '/physic' does not exist; did you mean '/physics'?\n")
    _run("param", "set", "/physics", "rate", "1.0")


def test_an_action_makes_steps() -> None:
    _run("pause")
    words = ("action", "send_goal", "/simulate_steps", "simulation_interfaces/action/SimulateSteps", "{steps: 5}")
    code, text = _run(*words)
    assert code == 0 and "Goal finished with status: SUCCEEDED" in text
    _run("play")


def test_ctrl_c_cancels_the_goal_of_an_action() -> None:
    _run("pause")
    command = [sys.executable, "-m", "gibson_sim.cli.main", "action", "send_goal", "-f"]
    command += ["/simulate_steps", "simulation_interfaces/action/SimulateSteps", "{steps: 1000000000}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line == "Feedback:\n":
            break
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert "Canceling goal...\n" in output and output.endswith("Goal canceled.\n")
    assert process.returncode == -signal.SIGINT
    assert _run("step", "1") == (0, "executed 1 step\n"), "no steps are being executed"
    _run("play")


def test_a_tool_that_waits_while_time_is_paused_reports_it() -> None:
    _run("pause")
    code, text = _run("topic", "hz", "/scan", "--seconds", "9")
    _run("play")
    assert code == 1 and text.count("the simulation is paused") == 1 and "`gibson-sim play`" in text


def test_the_short_verbs_do_what_they_say() -> None:
    assert _run("spawn", "bottle_water", "--at", "2,4", "--name", "drink") == (0, "spawned drink at 2,4\n")
    assert _run("move", "drink", "--at", "2.2,4.1,90") == (0, "moved drink to 2.2,4.1\n")
    code, text = _run("delete", "drnk")
    assert code == 1 and "did you mean 'drink'?" in text
    assert _run("delete", "drink") == (0, "deleted drink\n")
    assert [_run(*words)[1] for words in (("pause",), ("pause",), ("step", "10"), ("play",), ("reset",))] == [
        "paused\n", "already paused\n", "executed 10 steps\n", "playing\n", "reset: time, poses and spawned entities\n",
    ]  # fmt: skip
    code, text = _run("spawn", "bottel_water", "--at", "1,1")
    assert code == 1 and "did you mean" in text
    assert "goal_pose has no subscriber" in _run("goal", "1,2")[1]
    assert _run("spawn", "ball", "--at", "here")[0] == 2


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("gibson-sim topic echo /od", {"/odom"}),
        ("gibson-sim topic hz od", {"odom"}),
        ("gibson-sim service call /spawn_entity", {"/spawn_entity"}),
        ("gibson-sim action send_goal ", {"/simulate_steps"}),
        ("gibson-sim param set /phys", {"/physics"}),
        ("gibson-sim param get /physics publish_", {"publish_hz", "publish_map_tf"}),
        ("gibson-sim move rob", {"robot"}),
    ],
)
def test_a_shell_completes_names_of_the_simulation(line: str, found: set[str], cache: Path) -> None:
    deadline = time.monotonic() + 60.0
    names: set[str] = set()
    while not found <= names and time.monotonic() < deadline:  # on a busy machine a press of TAB may be too short
        names, printed = completions(line, cache)
        assert printed == ""
    assert found <= names and all(name.startswith(line.split()[-1]) for name in names if line[-1] != " ")
