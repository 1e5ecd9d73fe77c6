"""Parameter requests at which rclpy itself raises: one of them ended the whole simulation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.simulation import require

require("rclpy")

from rcl_interfaces.msg import Parameter, ParameterValue  # noqa: E402
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically  # noqa: E402
from rclpy.node import Node  # noqa: E402

from gibson_sim.ros.nodes.node_main import guard_parameters  # noqa: E402

pytestmark = pytest.mark.ros
NO_TYPE = Parameter(name="rate", value=ParameterValue(type=77))
GOOD = Parameter(name="rate", value=ParameterValue(type=3, double_value=2.0))


@pytest.fixture
def node(ros_context: Any) -> Iterator[Node]:
    made = Node("guarded", context=ros_context, use_global_arguments=False)
    made.declare_parameter("rate", 1.0)
    guard_parameters(made)
    yield made
    made.destroy_node()


def _ask(node: Node, kind: Any, request: Any) -> Any:
    (service,) = [service for service in node.services if service.srv_type is kind]
    return service.callback(request, kind.Response())


def test_type_that_does_not_exist_is_refused_and_the_others_are_set(node: Node) -> None:
    wrong, good = _ask(node, SetParameters, SetParameters.Request(parameters=[NO_TYPE, GOOD])).results
    assert not wrong.successful and "77" in wrong.reason
    assert good.successful
    assert node.get_parameter("rate").value == 2.0


def test_atomic_set_changes_nothing_if_one_value_is_invalid(node: Node) -> None:
    response = _ask(node, SetParametersAtomically, SetParametersAtomically.Request(parameters=[GOOD, NO_TYPE]))
    assert not response.result.successful and "77" in response.result.reason
    assert node.get_parameter("rate").value == 1.0


def test_valid_requests_are_answered_as_usual(node: Node) -> None:
    assert _ask(node, GetParameters, GetParameters.Request(names=["rate"])).values[0].double_value == 1.0
