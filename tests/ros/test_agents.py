"""A session of a coding agent over stdin and stdout, with the client of the MCP SDK: all tests share one simulation."""

from __future__ import annotations

import base64
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.scenes import write_room
from support.simulation import PATIENCE_S, require

require("rclpy", "gibson_msgs", "simulation_interfaces", "mcp")

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from anyio.from_thread import start_blocking_portal  # noqa: E402
from mcp import Client  # noqa: E402
from mcp.client.stdio import StdioServerParameters  # noqa: E402

from gibson_sim.agents.tools import TOOLS  # noqa: E402
from gibson_sim.bags.reader import BagReader  # noqa: E402
from gibson_sim.errors import AlreadyRunningError  # noqa: E402
from gibson_sim.processes.domain_lock import DomainLock  # noqa: E402

pytestmark = pytest.mark.ros
STACKS = Path(__file__).parents[1] / "support" / "stacks"
TRIAL = """
scenes: room
robots: gibson_bot
runs: 1
starts: '0,0,0'
goals: '0.4,0,0'
stack: {{command: [python, {stack}], status: {{topic: status}}, lockstep: cmd_vel after ground_truth/odom}}
verdicts: {{reached: 0.2, collisions: 0}}
"""


class Agent:
    """Calls tools, as an agent does."""

    def __init__(self, portal: Any, client: Any, folder: Path) -> None:
        self._portal, self._client, self.folder = portal, client, folder

    def result(self, tool: str, /, **arguments: Any) -> Any:
        return self._portal.call(lambda: self._client.call_tool(tool, arguments))

    def ask(self, tool: str, /, **arguments: Any) -> Any:
        """Returns the JSON of a tool that succeeds."""
        result = self.result(tool, **arguments)
        assert not result.is_error, result.content[0].text
        return json.loads(result.content[0].text)

    def error(self, tool: str, /, **arguments: Any) -> str:
        """Returns the error of a tool that fails: one line, and the server goes on."""
        result = self.result(tool, **arguments)
        assert result.is_error, result.content[0].text[:300]
        text = str(result.content[0].text)
        assert text.isprintable()
        assert len(text) < 1500
        assert "Traceback" not in text
        assert self.ask("list_names", kind="scenes")["scenes"]
        return text

    def look(self, camera: str = "camera", **arguments: Any) -> np.ndarray:
        """Returns the image of a camera, (H, W, 3) BGR."""
        result = self.result("get_image", camera=camera, **arguments)
        assert not result.is_error, result.content[0].text
        image = result.content[1]
        assert (image.type, image.mime_type) == ("image", "image/png")
        return cv2.imdecode(np.frombuffer(base64.b64decode(image.data), np.uint8), cv2.IMREAD_COLOR)

    def tools(self) -> Any:
        return self._portal.call(self._client.list_tools).tools


@pytest.fixture(scope="module")
def agent(ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Agent]:
    folder = tmp_path_factory.mktemp("work")
    (folder.parent / "secret.yaml").write_text("scenes: secret")
    (folder / "link.yaml").symlink_to(folder.parent / "secret.yaml")
    write_room(folder / "room")
    (folder / "trial.yaml").write_text(TRIAL.format(stack=STACKS / "drive.py"))
    words = ["-m", "gibson_sim.cli.main", "mcp", "--folder", str(folder), "--domains", str(ros_domain)]
    server = StdioServerParameters(command=sys.executable, args=words, env=dict(os.environ))
    with start_blocking_portal() as portal, portal.wrap_async_context_manager(Client(server)) as client:
        yield Agent(portal, client, folder)
    deadline = time.monotonic() + PATIENCE_S
    while True:  # the simulation ends with its server
        try:
            DomainLock(ros_domain).close()
            break
        except AlreadyRunningError:
            assert time.monotonic() < deadline
            time.sleep(0.1)


@pytest.fixture(scope="module")
def running(agent: Agent) -> Agent:
    state = agent.ask("start_simulation", scene="flat", start="1.0,4.7,0")
    assert state["cameras"] == ["camera", "view_follow", "view_top"]
    assert (state["time"], state["ros_domain_id"]) == ("stepped", int(os.environ["ROS_DOMAIN_ID"]))
    return agent


def test_each_tool_reports_that_no_simulation_runs(agent: Agent) -> None:
    assert agent.ask("get_state") == {"simulation": "none", "folders": [str(agent.folder)]}
    for name, arguments in {"get_image": {}, "drive": {"seconds": 1.0}, "stop_simulation": {}, "start_recording": {}}.items():
        assert agent.error(name, **arguments) == "no simulation runs: call start_simulation first"
    assert agent.error("stop_recording") == "no simulation runs: call start_simulation first"
    assert agent.error("get_trial") == "no trial was started: call run_trial first"


def test_the_client_gets_all_tools_with_schemas(agent: Agent) -> None:
    listed = {tool.name: tool for tool in agent.tools()}
    assert list(listed) == list(TOOLS)
    assert listed["drive"].input_schema["properties"]["linear"]["description"] == "Forward velocity, m/s"
    assert [name for name, tool in listed.items() if tool.annotations.read_only_hint] == [
        "get_state", "list_names", "get_entities", "get_image", "read_topic",
    ]  # fmt: skip


def test_the_robot_drives_as_commanded_and_time_passes_only_in_calls(running: Agent) -> None:
    running.ask("reset")
    before = running.ask("get_state")
    assert running.ask("get_state") == before
    driven = running.ask("drive", linear=0.3, seconds=1.0)
    assert driven["time_s"] == pytest.approx(before["time_s"] + 1.0, abs=0.05)
    after = running.ask("step", seconds=1.0)["robots"]["robot"]
    assert driven["collisions"] == []
    assert (after["x"], after["y"], after["yaw"]) == pytest.approx((1.3, 4.7, 0.0), abs=0.01)


def test_pictures_show_the_scene_and_what_was_spawned(running: Agent) -> None:
    running.ask("reset")
    empty = running.look()
    assert empty.shape == (480, 640, 3)
    assert empty.std() > 20
    assert len(np.unique(empty.reshape(-1, 3), axis=0)) > 1000
    assert running.ask("spawn", model="box_cardboard", x=2.0, y=4.7, name="box")["spawned"] == "box"
    entities = running.ask("get_entities")["entities"]
    assert list(entities) == ["robot", "box"], "the nearest first"
    with_box = running.look()
    changed = np.abs(with_box.astype(int) - empty.astype(int)).max(axis=2) > 30
    assert 0.02 < changed.mean() < 0.5
    assert running.look("view_top", width=160).shape == (120, 160, 3)
    result = running.result("get_image", output="depth")
    assert json.loads(result.content[0].text)["middle_m"] < 1.2, "the box"
    running.ask("move", name="box", x=2.0, y=2.0)
    running.ask("delete", name="box")
    assert list(running.ask("get_entities")["entities"]) == ["robot"]


def test_doors_open_and_close(running: Agent) -> None:
    running.ask("reset")
    assert running.ask("list_names", kind="doors")["doors"] == {}
    running.ask("spawn", model="fridge_body", x=3.0, y=4.7, yaw=3.14, name="fridge")
    assert running.ask("list_names", kind="doors")["doors"] == {"fridge/door": pytest.approx(0.0, abs=0.02)}
    for opening in (0.5, 0.0):
        assert running.ask("open_door", door="fridge/door", opening=opening)["opening"] == pytest.approx(opening, abs=0.05)


def test_topics_are_read_and_recorded(running: Agent) -> None:
    running.ask("reset")
    scan = running.result("read_topic", topic="scan")
    assert "ranges: [" in scan.content[0].text
    assert running.ask("list_names", kind="topics")["topics"]["/odom"] == "nav_msgs/msg/Odometry"
    running.ask("start_recording", folder="bags/one")
    assert "runs already: call stop_recording first" in running.error("start_recording")
    end = running.ask("step", seconds=0.5)["time_s"]
    recorded = Path(running.ask("stop_recording")["recorded"])
    assert recorded == running.folder / "bags" / "one"
    with BagReader(recorded) as bag:
        stamps = [log_ns for topic, log_ns, *_ in bag.messages() if topic == "/odom"]
    assert len(stamps) > 10
    assert np.diff(stamps) == pytest.approx(1e9 / 60, abs=1e7), "none is missing"
    assert 1e-9 * stamps[-1] == pytest.approx(end, abs=0.01)
    assert "already exists" in running.error("start_recording", folder="bags/one")


def test_a_trial_that_cannot_run_is_one_line(agent: Agent) -> None:
    (agent.folder / "bad.yaml").write_text("scenes: nowhere")
    error = agent.error("run_trial", file="bad.yaml")
    assert "the trial has no results" in error
    assert "'nowhere'" in error
    assert agent.ask("get_state")["trial"]["trial"] == "failed"


def test_a_trial_has_its_verdict(agent: Agent) -> None:
    status = agent.ask("run_trial", file="trial.yaml")
    while status["trial"] == "running":
        status = agent.ask("get_trial", wait=50.0)
    assert (status["trial"], status["verdict"]) == ("finished", "passed"), status
    assert status["rate"].startswith("1 of 1 passed")
    assert Path(status["page"]).is_relative_to(agent.folder / "trials")


@pytest.mark.parametrize(
    ("name", "arguments", "error"),
    [
        ("start_simulation", {}, "a simulation of flat runs already: call stop_simulation first, or reset"),
        ("drive", {"linear": "nan", "seconds": 1}, "argument 'linear' is 'nan' (str), must be of type float"),
        ("drive", {"linear": 0.1, "seconds": 1e9}, "argument 'seconds' is 1000000000.0, must be 0.01 to 30 s"),
        ("step", {"seconds": -1}, "argument 'seconds' is -1.0, must be 0.001 to 30 s"),
        ("drive", {"seconds": 1, "robot": "r2"}, "robot 'r2' is not in this simulation; it has: robot"),
        ("spawn", {"model": "/etc/passwd", "x": 2, "y": 4.7}, "model '/etc/passwd' is outside of the folders of this server"),
        ("spawn", {"model": "package://a/../../etc/passwd", "x": 2, "y": 4.7}, "model 'package://a/../../etc/passwd' is "),
        ("spawn", {"model": "x" * 1_000_000, "x": 2, "y": 4.7}, "(1000000 characters), must be at most 512 printable characters"),
        ("spawn", {"model": "chair_woden", "x": 2, "y": 4.7}, "did you mean 'chair_wooden'?"),
        ("move", {"name": "nothing", "x": 2, "y": 4.7}, "'nothing'"),
        ("run_trial", {"file": "link.yaml"}, "trial 'link.yaml' is outside of the folders of this server"),
        ("start_recording", {"folder": "../bag"}, "folder '../bag' is outside of the folders of this server"),
        (
            "get_image",
            {"camera": "camra"},
            "camera 'camra' does not exist; did you mean 'camera'?; known: camera, view_follow, view_top",
        ),
        ("get_image", {"camera": "view_top", "output": "depth"}, "camera view_top has no depth, but: rgb"),
        ("read_topic", {"topic": "scn"}, "topic '/scn' has no publisher; did you mean '/scan'?"),
        ("read_topic", {"topic": "not a topic"}, "not a topic"),
        ("open_door", {"door": "a/b"}, "'a/b' is not a door or drawer of this simulation"),
        ("drive_to", {"x": 1e6, "y": 0}, "1000000.00"),
        ("fly", {}, "tool 'fly' is unknown"),
    ],
    ids=lambda value: value if isinstance(value, str) and len(value) < 40 else "",
)
def test_hostile_calls_are_one_line_each(running: Agent, name: str, arguments: dict[str, Any], error: str) -> None:
    assert error in running.error(name, **arguments)
    assert running.ask("get_state")["simulation"] == "running"


def test_a_paused_simulation_says_what_to_do(running: Agent) -> None:
    running.ask("reset")
    assert running.ask("pause")["paused"]
    assert "call pause with paused false first" in running.error("drive", seconds=1.0)
    assert running.look().std() > 20
    begin = running.ask("get_state")["time_s"]
    assert running.ask("step", seconds=0.1)["time_s"] == pytest.approx(begin + 0.1, abs=0.005)
    assert not running.ask("pause", paused=False)["paused"]


def test_stop_simulation_ends_the_simulation(running: Agent) -> None:
    assert running.ask("stop_simulation")["stopped"] == "flat"
    assert running.ask("get_state")["simulation"] == "none"
    DomainLock(int(os.environ["ROS_DOMAIN_ID"])).close()
