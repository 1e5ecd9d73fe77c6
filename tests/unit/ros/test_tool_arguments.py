"""Types and values on the command line of the tools."""

from __future__ import annotations

import pytest

from support.simulation import require

require("rclpy", "simulation_interfaces", "std_msgs")

from simulation_interfaces.action import SimulateSteps  # noqa: E402
from simulation_interfaces.srv import GetEntities  # noqa: E402

from gibson_sim.errors import GibsonSimError  # noqa: E402
from gibson_sim.ros.tools.arguments import interface_class, parse_values  # noqa: E402

pytestmark = pytest.mark.ros

SERVICE, ACTION = "simulation_interfaces/srv/GetEntities", "simulation_interfaces/action/SimulateSteps"


def test_a_type_is_found_by_its_name() -> None:
    assert interface_class(SERVICE, "srv") is GetEntities
    assert interface_class(ACTION, "action") is SimulateSteps


@pytest.mark.parametrize(
    ("name", "kind", "text"),
    [
        (SERVICE, "action", f"type '{SERVICE}' is a service; an action type such as {ACTION} is needed"),
        (ACTION, "srv", f"type '{ACTION}' is an action; a service type such as {SERVICE} is needed"),
        ("std_msgs/msg/String", "srv", f"type 'std_msgs/msg/String' is a message; a service type such as {SERVICE} is needed"),
    ],
)
def test_a_type_of_another_kind_is_refused_before_rclpy_gets_it(name: str, kind: str, text: str) -> None:
    with pytest.raises(GibsonSimError) as error:
        interface_class(name, kind)
    assert str(error.value) == text


@pytest.mark.parametrize(
    "name", ["", "GetEntities", "simulation_interfaces/GetEntities", "a/srv/", "/srv/B", "os/path/join", "a.b/srv/C"]
)
def test_a_type_of_another_form_is_refused_with_the_form(name: str) -> None:
    with pytest.raises(GibsonSimError) as error:
        interface_class(name, "srv")
    assert str(error.value) == (
        f"type {name!r} does not have the form package/srv/Name; a service type such as {SERVICE} is needed"
    )


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("simulation_interfaces/srv/GetEntitys", f"; did you mean '{SERVICE}'?"),
        ("simulation_interface/srv/GetEntities", f"; did you mean '{SERVICE}'?"),
        ("simulation_interfaces/srv/_get_entities", f"; did you mean '{SERVICE}'?"),
        ("zzzz/srv/Nothing", ""),
        ("simulator_services/srv/Nothing", ""),
        ("simulation_interfaces/srv/Zzzzzz", ""),
    ],
)
def test_a_misspelt_type_is_refused_with_the_most_similar(name: str, hint: str) -> None:
    with pytest.raises(GibsonSimError) as error:
        interface_class(name, "srv")
    assert str(error.value) == f"type {name!r} is not installed in this environment{hint}"


def test_invalid_yaml_is_reported_once() -> None:
    with pytest.raises(GibsonSimError) as error:
        parse_values("{filters: {filter: ")
    assert str(error.value).startswith("'{filters: {filter: ': is not YAML: line ") and str(error.value).count("not YAML") == 1
