"""Hints of the command line for names that are not in the graph."""

from __future__ import annotations

from typing import Any

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.ros.tools.hints import (
    PHYSICS,
    RENDER,
    check_name,
    loading_nodes,
    missing_service,
    spawned_as,
    suggestion,
    type_and_values,
)

SIMULATION = {
    "/get_simulation_state": ["simulation_interfaces/srv/GetSimulationState"],
    "/spawn_entity": ["simulation_interfaces/srv/SpawnEntity"],
    "/physics/get_parameters": ["rcl_interfaces/srv/GetParameters"],
    "/render/get_parameters": ["rcl_interfaces/srv/GetParameters"],
}
PARAMETERS = "rcl_interfaces/srv/GetParameters"


def _missing(name: str, kind: str, services: dict[str, Any]) -> str:
    return missing_service(name, kind, services, domain=105, start="`gibson-sim run`")


def test_a_wrong_node_is_named_with_the_nearest_node() -> None:
    assert _missing("/physic/get_parameters", PARAMETERS, SIMULATION) == "node '/physic' does not exist; did you mean '/physics'?"
    assert _missing("/x/get_parameters", PARAMETERS, SIMULATION) == "node '/x' does not exist; known: /physics, /render"


def test_a_standard_service_without_a_simulation_reports_that_none_runs() -> None:
    expected = "no simulation runs in ROS domain 105; start one with `gibson-sim run`"
    assert _missing("/spawn_entity", "simulation_interfaces/srv/SpawnEntity", {}) == expected
    others = {"/talker/get_parameters": [PARAMETERS]}
    assert _missing("/spawn_entity", "simulation_interfaces/srv/SpawnEntity", others) == expected
    assert _missing("/physics/get_parameters", PARAMETERS, {}) == expected


def test_a_node_without_a_simulation_reports_that_none_runs_beside_other_nodes() -> None:
    others = {"/talker/get_parameters": [PARAMETERS]}
    assert _missing("/physics/get_parameters", PARAMETERS, others) == (
        "node '/physics' does not exist; no simulation runs in ROS domain 105; start one with `gibson-sim run`"
    )
    assert _missing("/talkr/get_parameters", PARAMETERS, others) == "node '/talkr' does not exist; did you mean '/talker'?"


def test_a_node_without_parameter_services_is_not_reported_as_missing() -> None:
    text = missing_service("/tool/set_parameters", PARAMETERS, {}, ["/tool"], domain=105, start="`gibson-sim run`")
    assert text.startswith("node '/tool' offers no parameters; ")


def test_only_the_nodes_of_a_simulation_by_their_exact_names_are_awaited_until_they_have_loaded() -> None:
    present = ["/physics", "/lab/render", "/physics_watch", "/physics/logger", "/my_render"]
    assert loading_nodes((PHYSICS, RENDER), present, set()) == ["/lab/render", "/physics"]
    assert loading_nodes((PHYSICS,), present, set()) == ["/physics"]
    assert loading_nodes((PHYSICS, RENDER), present, {"/physics"}) == ["/lab/render"]


def test_a_wrong_service_of_a_simulation_suggests_the_nearest() -> None:
    assert (
        _missing("/spawn_entiti", "", SIMULATION) == "no node offers the service '/spawn_entiti'; did you mean '/spawn_entity'?"
    )
    assert _missing("/zzz", "", SIMULATION) == "no node offers the service '/zzz'; see `gibson-sim service list`"


@pytest.mark.parametrize(
    ("name", "known", "found"),
    [
        ("/odm", ["/odom", "/scan"], "did you mean '/odom'?"),
        ("/cmd", ["/cmd_vel"], "did you mean '/cmd_vel'?"),
        ("/scan", ["/left/scan", "/scam"], "did you mean '/left/scan'?"),
        ("/nothing", ["/diagnostics", "/odom"], "none"),
        ("spawn_entity", ["/spawn_entity"], "none"),
        ("/spawn_entity", ["spawn_entity"], "none"),
    ],
)
def test_only_a_similar_and_different_name_is_suggested(name: str, known: list[str], found: str) -> None:
    assert suggestion(name, known, "none") == found


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (("{scope: 1}", ""), ("", "{scope: 1}")),
        (("std_srvs/srv/Trigger", ""), ("std_srvs/srv/Trigger", "")),
        (("std_srvs/srv/Trigger", "{}"), ("std_srvs/srv/Trigger", "{}")),
        (("", "{scope: 1}"), ("", "{scope: 1}")),
    ],
)
def test_values_of_a_service_call_are_never_taken_for_its_type(given: tuple[str, str], meant: tuple[str, str]) -> None:
    assert type_and_values(*given) == meant


def test_the_name_of_a_resource_finds_the_entities_that_it_was_spawned_as() -> None:
    text = spawned_as("bottle_water", "bottle", ["robot", "bottle", "kitchen_bottle_water", "bottle_3", "bottle_opener"])
    assert text.endswith("'bottle_water' is spawned as 'bottle': did you mean bottle or bottle_3?")
    assert spawned_as("bottle_water", "bottle", ["robot"]) == ""


@pytest.mark.parametrize("name", ["/a b", "/a//b", "1x", "/9", "/a{b}", "/a-b", "/a/", "/", "~", "/\u00e4", "a\n"])
def test_an_invalid_ros_name_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(ConfigError, match="is not a ROS name: letters"):
        check_name("topic", name)


def test_an_empty_name_is_refused_as_empty() -> None:
    with pytest.raises(ConfigError, match="the name of the topic is empty"):
        check_name("topic", "")


@pytest.mark.parametrize("name", ["odom", "/odom", "/robot_1/scan", "_hidden", "~/x", "/view_top/image_raw"])
def test_valid_ros_names_are_accepted(name: str) -> None:
    check_name("topic", name)
