"""Doors and drawers over topics: where they are, and how they are opened."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "control_msgs")

from control_msgs.msg import DynamicJointState  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from gibson_sim.ros.topics import qos  # noqa: E402

pytestmark = pytest.mark.ros
STATES, COMMAND = "object_joint_states", "object_joint_command"


@pytest.fixture(scope="module")
def simulation(ros_domain: int) -> Iterator[Launched]:
    launched = Launched("run", "--scene", "linden_flat", "--no-render")
    launched.wait_for_line("is ready")
    yield launched
    launched.stop()


def _values(messages: list[Any]) -> dict[str, dict[str, float]]:
    return {
        name: dict(zip(row.interface_names, row.values, strict=True))
        for name, row in zip(messages[-1].joint_names, messages[-1].interface_values, strict=True)
    }


def test_doors_and_drawers_are_published_opened_and_freed(simulation: Launched, listener: Listener) -> None:
    states = listener.collect(DynamicJointState, STATES, qos.LATCHED)
    publisher = listener.node.create_publisher(JointState, COMMAND, 10)
    listener.spin_until(lambda: bool(states) and publisher.get_subscription_count() > 0, "joints of bodies")
    first = _values(states)
    assert first["front_door/hinge"]["lower"] == 0.0 and first["front_door/hinge"]["upper"] == pytest.approx(1.745, abs=0.001)
    assert first["front_door/hinge"]["position"] == pytest.approx(0.0, abs=0.01)
    assert not [name for name in first if name.startswith("robot/")]
    names = ["front_door/hinge", "bedroom_2_cabinet_drawers/drawer_2"]
    publisher.publish(JointState(name=names, position=[1.0, 0.2]))
    listener.spin_until(lambda: abs(_values(states)[names[0]]["position"] - 1.0) < 0.02, "an open door")
    listener.spin_until(lambda: abs(_values(states)[names[1]]["position"] - 0.2) < 0.01, "an open drawer")
    publisher.publish(JointState(name=names, effort=[0.0, 0.0]))
    publisher.publish(JointState(name=[names[0]], effort=[-5.0]))  # as a hand that pushes it
    listener.spin_until(lambda: _values(states)[names[0]]["position"] < 0.5, "a door that gives way")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (JointState(name=["hinge"], position=[1.0]), "must be <body>/<joint>"),
        (JointState(name=["front_door/hinge"], position=[9.0]), "position is 9, must be 0 to 1.7453"),
        (JointState(name=["robot/wheel_left_joint"], position=[1.0]), "is a robot"),
        (JointState(name=["no_door/hinge"], position=[1.0]), "no robot or body 'no_door'"),
        (JointState(name=["front_door/hinge"], position=[1.0, 2.0]), "has 2 values of position for 1 joints"),
    ],
)
def test_invalid_joint_command_is_refused_with_a_reason(
    simulation: Launched, listener: Listener, command: JointState, said: str
) -> None:
    publisher = listener.node.create_publisher(JointState, COMMAND, 10)
    listener.spin_until(lambda: publisher.get_subscription_count() > 0, "the subscription")
    known = len(simulation.lines)
    listener.spin_until(lambda: publisher.publish(command) or any(said in line for line in simulation.lines[known:]), said)
    listener.node.destroy_publisher(publisher)
