"""Shows and runs a task for a page: its episode, its goal, its result."""

from __future__ import annotations

import json
import math
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from gibson_msgs.msg import RunInfo
from gibson_sim.errors import GibsonSimError
from gibson_sim.reading import parse_yaml
from gibson_sim.ros.client.simulation_client import SimulationClient
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.web.child_nodes import TaskRunner
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import RunTask

_GOAL, _INFO, _RESULT, _RESET = "task/goal", "task/info", "task/result", "task/reset"
_MAX_LENGTH = 65_536
"""Maximum length of a text that is parsed, characters."""
_SHOWN = ("task", "seed", "text", "time_limit")
"""Keys of ``task/info`` that a page shows."""


class TaskView:
    """The state of a task node, started by a page or otherwise.

    Subscribes:
        task/goal (geometry_msgs/PoseStamped), task/info and task/result (std_msgs/String, JSON): from any task node.
        run_info (gibson_msgs/RunInfo): scene and robot of the simulation, which a task needs.

    Services used:
        task/reset (std_srvs/Trigger): the next episode.
    """

    def __init__(self, node: Any, simulation: SimulationClient) -> None:
        self._node, self._simulation, self._runner = node, simulation, TaskRunner()
        self._run: dict[str, Any] = {}
        self._goal: dict[str, float] | None = None
        self._info: dict[str, Any] = {}
        self._result: dict[str, Any] = {}
        latched: QoSProfile = qos.LATCHED
        node.subscribe(PoseStamped, _GOAL, self._on_goal, latched)
        node.subscribe(String, _INFO, self._on_info, latched)
        node.subscribe(String, _RESULT, self._on_result, latched)
        node.subscribe(RunInfo, names.RUN_INFO, self._on_run, qos.RUN_INFO)
        simulation.prepare(_RESET, Trigger)

    def ask(self, request: RunTask, answer: Answer) -> None:
        """Starts a task, begins its next episode, or ends the task."""
        if request.action == "stop":
            self._runner.stop()
            answer(True, "")
        elif request.action == "next":
            self._simulation.begin(_RESET, Trigger.Request(), partial(_reset, answer), partial(answer, False))
        elif self._runner.running or self._node.count_publishers(_INFO):
            answer(False, "a task runs already: end it first")
        else:
            self._info, self._result, self._goal = {}, {}, None
            try:
                self._runner.start(request.task, request.baseline, request.seed, self._run)
            except GibsonSimError as error:
                answer(False, str(error))
            else:
                answer(True, f"{request.task} is being set up")

    def page_values(self) -> dict[str, Any]:
        """Returns the values for the page."""
        running = self._node.count_publishers(_INFO) > 0
        info = self._info if running or self._result else {}
        return {
            **self._runner.page_values(), "there": running, "goal": self._goal if running else None,
            "info": {key: info[key] for key in _SHOWN if key in info}, "result": self._result,
        }  # fmt: skip

    def close(self) -> None:
        """Ends the task that a page has started."""
        self._runner.close()

    def _on_goal(self, msg: PoseStamped) -> None:
        p = msg.pose.position
        self._goal = {"x": p.x, "y": p.y, "z": p.z} if math.isfinite(p.x + p.y + p.z) else None

    def _on_info(self, msg: String) -> None:
        self._info, self._result = _values(msg.data), {}

    def _on_result(self, msg: String) -> None:
        self._result = _values(msg.data)

    def _on_run(self, msg: RunInfo) -> None:
        if msg.kind == "physics" and len(msg.settings) <= _MAX_LENGTH:
            settings = parse_yaml(msg.settings)
            self._run = settings if isinstance(settings, dict) else {}


def _values(text: str) -> dict[str, Any]:
    """Returns the values of a JSON object that a page can show: strings, shortened to 500 characters, booleans and finite numbers.

    Raises:
        ValueError: the text is too long, or not a JSON object.
    """
    values = json.loads(text) if len(text) <= _MAX_LENGTH else None
    if not isinstance(values, dict):
        raise ValueError("it is not a JSON object")
    return {
        key: value[:500] if isinstance(value, str) else value
        for key, value in values.items()
        if isinstance(value, (str, bool)) or (isinstance(value, (int, float)) and math.isfinite(value))
    }


def _reset(answer: Answer, response: Any) -> None:
    if response is None:
        answer(False, f"no node offers {_RESET}: no task runs")
    else:
        answer(bool(response.success), "the next episode begins" if response.success else str(response.message))
