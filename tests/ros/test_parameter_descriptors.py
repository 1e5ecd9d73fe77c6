"""Parameter descriptors of real nodes: ranges for sliders, choices, what may be set while a node runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from support.simulation import require

require("rclpy")

from rcl_interfaces.msg import ParameterDescriptor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from gibson_sim.client_config import DriveConfig, RecordConfig, ReplayConfig, SnapshotConfig, TaskConfig  # noqa: E402
from gibson_sim.config import PhysicsConfig, RenderConfig  # noqa: E402
from gibson_sim.errors import ConfigError  # noqa: E402
from gibson_sim.ros.nodes.params import config_from_parameters  # noqa: E402
from gibson_sim.settings import setting_fields  # noqa: E402

pytestmark = pytest.mark.ros
Make = Callable[..., Node]


@pytest.fixture
def make(ros_context: Any) -> Iterator[Make]:
    """Makes nodes whose parameters have these values."""
    nodes: list[Node] = []

    def one(**values: Any) -> Node:
        given = [Parameter(name, value=value) for name, value in values.items()]
        node = Node("described", context=ros_context, use_global_arguments=False, parameter_overrides=given)
        nodes.append(node)
        return node

    yield one
    for node in nodes:
        node.destroy_node()


def _described(node: Node, cls: type[Any], *names: str) -> tuple[ParameterDescriptor, ...]:
    config_from_parameters(node, cls, changeable=("rate",))
    return tuple(node.describe_parameters(list(names)))


def test_numbers_have_ranges_that_make_sliders(make: Make) -> None:
    rate, step_hz, seed = _described(make(), PhysicsConfig, "rate", "step_hz", "seed")
    (speed,) = rate.floating_point_range
    assert (speed.from_value, speed.to_value, speed.step) == (0.0, 1000.0, 0.0)
    (steps,) = step_hz.integer_range
    assert (steps.from_value, steps.to_value, steps.step) == (60, 10_000, 1)
    # One end alone is no range; words say it.
    assert not seed.integer_range
    assert "0 or more" in seed.additional_constraints


def test_descriptors_state_choices_units_and_read_only_parameters(make: Make) -> None:
    rate, reset_time, step_hz = _described(make(), PhysicsConfig, "rate", "reset_time", "step_hz")
    assert "one of rewind, monotonic" in reset_time.additional_constraints
    assert step_hz.additional_constraints == "60 to 10000 Hz; read when the node starts: restart it to change this"
    assert (rate.read_only, step_hz.read_only) == (False, True)
    assert rate.additional_constraints == "0 to 1000"


@pytest.mark.parametrize(
    "cls", [PhysicsConfig, RenderConfig, DriveConfig, RecordConfig, ReplayConfig, SnapshotConfig, TaskConfig]
)
def test_every_parameter_of_every_node_is_described_as_it_is_declared(make: Make, cls: type[Any]) -> None:
    names = [f.name for f in setting_fields(cls)]
    for f, found in zip(setting_fields(cls), _described(make(), cls, *names), strict=True):
        low, high = f.metadata["minimum"], f.metadata["maximum"]
        bounded = isinstance(f.default, (int, float)) and not isinstance(f.default, bool) and float("inf") not in (high, -low)
        ranges = [*found.integer_range, *found.floating_point_range]
        assert [(r.from_value, r.to_value) for r in ranges] == ([(low, high)] if bounded else []), f.name
        assert found.description == f.metadata["doc"]
        assert all(choice in found.additional_constraints for choice in f.metadata["choices"])


def test_invalid_value_fails_with_the_message_of_the_setting(make: Make) -> None:
    with pytest.raises(ConfigError, match="'step_hz' is 7, must be 60 to 10000 Hz"):
        config_from_parameters(make(step_hz=7), PhysicsConfig)
    with pytest.raises(ConfigError, match="must be of type float"):
        config_from_parameters(make(rate="fast"), PhysicsConfig)


def test_an_integer_may_stand_for_a_number_with_a_point(make: Make) -> None:
    node = make(rate=2)
    assert config_from_parameters(node, PhysicsConfig, changeable=("rate",)).time.rate == 2.0
    assert node.set_parameters([Parameter("rate", value=3)])[0].successful


def test_out_of_range_values_and_read_only_parameters_are_refused_while_the_node_runs(make: Make) -> None:
    node = make()
    config_from_parameters(node, PhysicsConfig, changeable=("rate",))
    fast, steps = node.set_parameters([Parameter("rate", value=2000.0), Parameter("step_hz", value=480)])
    assert not fast.successful
    assert "out of range" in fast.reason
    assert not steps.successful
    assert node.get_parameter("step_hz").value == 240
