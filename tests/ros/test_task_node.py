"""The task node and a running simulation: goals, results and resets, as a node that drives the robot sees them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from geometry_msgs.msg import PoseStamped  # noqa: E402
from simulation_interfaces import srv  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from gibson_sim.ros.client.simulation_client import SimulationClient  # noqa: E402
from gibson_sim.tasks.ground import ground_of  # noqa: E402
from gibson_sim.tasks.registry import task_of  # noqa: E402
from support.clients import LATCHED, LaunchedNode, client_of  # noqa: E402

pytestmark = pytest.mark.ros
TASK, SCENE, SEED = "point-goal", "arena", 7


@pytest.fixture
def sim(ros_domain: int) -> Iterator[Launched]:
    launched = Launched("run", "--no-render", "--scene", SCENE, "--rate", "4")
    launched.wait_for_line("collision shapes")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)


@pytest.fixture
def before(sim: Launched, listener: Listener) -> set[str]:
    """Bodies before the first episode."""
    return entities(client_of(listener))


@pytest.fixture
def node(before: set[str]) -> Iterator[LaunchedNode]:
    launched = LaunchedNode("task", "-p", f"task:={TASK}", "-p", f"scene:={SCENE}", "-p", f"seed:={SEED}")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)


def entities(control: SimulationClient) -> set[str]:
    return set(control.call("get_entities", srv.GetEntities.Request()).entities)


def robot_at(control: SimulationClient) -> Any:
    return control.call("get_entity_state", srv.GetEntityState.Request(entity="robot")).state.pose


def put_robot(control: SimulationClient, x: float, y: float, z: float) -> None:
    request = srv.SetEntityState.Request(entity="robot")
    request.state.pose.position.x, request.state.pose.position.y, request.state.pose.position.z = x, y, z
    result = control.call("set_entity_state", request).result
    assert result.result == result.RESULT_OK, result.error_message


@pytest.mark.usefixtures("node")
def test_episodes_are_announced_judged_and_reset(listener: Listener, before: set[str]) -> None:
    control = client_of(listener)
    texts: dict[str, list[dict[str, Any]]] = {"info": [], "result": []}
    for name, found in texts.items():
        listener.node.create_subscription(
            String, f"task/{name}", lambda msg, found=found: found.append(json.loads(msg.data)), LATCHED
        )
    goals = listener.collect(PoseStamped, "task/goal", LATCHED)

    def begun(seed: int) -> dict[str, Any]:
        """Waits until an episode is announced, and checks it against the generator's."""
        listener.spin_until(lambda: texts["info"] != [] and texts["info"][-1]["seed"] == seed, f"the episode of seed {seed}")
        info, expected = texts["info"][-1], task_of(TASK).generate(seed, ground_of(SCENE, "gibson_bot"))
        listener.spin_until(lambda: len(goals) == seed - SEED + 1, "its goal")
        at = goals[-1].pose.position
        assert (goals[-1].header.frame_id, (at.x, at.y, at.z)) == ("map", pytest.approx(expected.goal.position))
        assert (info["task"], info["text"], info["time_limit"]) == (TASK, expected.goal.text, expected.time_limit)
        assert info["start"][:3] == pytest.approx(expected.start.position)
        assert entities(control) - before == {item.name for item in expected.items}, "its things, and no others"
        there = robot_at(control).position
        assert (there.x, there.y) == pytest.approx(expected.start.position[:2], abs=0.02)
        return info

    begun(SEED)
    assert texts["result"] == []
    at = goals[-1].pose.position
    put_robot(control, at.x, at.y, at.z)
    listener.spin_until(lambda: len(texts["result"]) == 1, "a result")
    result = texts["result"][0]
    assert (result["seed"], result["success"]) == (SEED, True)
    assert result["goal_distance"] < 0.3

    answer = control.call("task/reset", Trigger.Request())
    assert (answer.success, answer.message) == (True, f"the episode of seed {SEED + 1} begins")
    begun(SEED + 1)
    control.call("task/reset", Trigger.Request())
    listener.spin_until(lambda: len(texts["result"]) == 2, "the result of an episode without commands")
    assert [(one["seed"], one["success"]) for one in texts["result"]] == [(SEED, True), (SEED + 1, False)]
    assert texts["result"][1]["path_length"] == pytest.approx(0.0, abs=0.05), "no node drove"
