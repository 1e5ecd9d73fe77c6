"""Services with deferred responses, on both executors of rclpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import pytest

from support.simulation import require

require("rclpy", "simulation_interfaces")

from rclpy.callback_groups import ReentrantCallbackGroup  # noqa: E402
from rclpy.node import Node  # noqa: E402
from simulation_interfaces.srv import StepSimulation  # noqa: E402

from gibson_sim.ros.nodes.node_main import make_executor  # noqa: E402
from gibson_sim.ros.services.deferred import DeferredResponse, DeferredService  # noqa: E402

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("kind", ["events", "standard"])
def test_answers_come_when_they_are_there_in_any_order(ros_context: Any, kind: Literal["events", "standard"]) -> None:
    waiting: dict[int, Callable[[], None]] = {}

    def step(request: Any, response: Any) -> Any:
        response.result.error_message = str(request.steps)
        if request.steps == 0:
            return response
        deferred = DeferredResponse()
        waiting[request.steps] = lambda: deferred.send(response)
        return deferred

    node = Node("deferred", context=ros_context, use_global_arguments=False, start_parameter_services=False)
    executor = make_executor(kind, context=ros_context)
    executor.add_node(node)
    name = f"deferred_{kind}"
    service = DeferredService(node, StepSimulation, name, step, callback_group=ReentrantCallbackGroup())
    client = node.create_client(StepSimulation, name)

    def spin_until(condition: Callable[[], bool]) -> None:
        for _ in range(600):
            if condition():
                return
            executor.spin_once(timeout_sec=0.1)
        raise AssertionError("still nothing after a minute")

    spin_until(client.service_is_ready)
    slow = [client.call_async(StepSimulation.Request(steps=n)) for n in (1, 2)]
    spin_until(lambda: len(waiting) == 2)
    quick = client.call_async(StepSimulation.Request(steps=0))
    spin_until(quick.done)
    assert not slow[0].done()
    for n in (2, 1):
        waiting[n]()
        spin_until(slow[n - 1].done)
        assert slow[n - 1].result().result.error_message == str(n)
    assert service is not None
    executor.shutdown(timeout_sec=10.0)
    node.destroy_node()
