"""The reach of a simulation by its environment."""

from __future__ import annotations

import shlex
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gibson_sim.cli.command_line import run
from gibson_sim.errors import ConfigError
from gibson_sim.reach import apply_reach, describe_reach, is_local, profile_of, reach_of, reach_variables

LOCAL_PROFILE, SUBNET_PROFILE = str(profile_of("local")), str(profile_of("subnet"))
ALONE, EVERYBODY = "processes of this machine alone", "every machine of this network may see and command it"
PEERS = {"ROS_STATIC_PEERS": "192.0.2.7"}


@pytest.mark.parametrize(
    ("given", "wanted", "reach"),
    [
        ({}, None, "local"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": SUBNET_PROFILE}, None, "local"),  # env.sh and the images set it
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, None, "local"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "subnet"}, None, "subnet"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, None, ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **PEERS}, None, ""),
        ({"ROS_DISCOVERY_SERVER": "192.0.2.7:11811"}, None, ""),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/none/mine.xml"}, None, ""),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}, None, ""),
        (PEERS, "local", "local"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "subnet", "subnet"),
    ],
)
def test_reach_follows_from_the_option_then_the_environment(given: dict[str, str], wanted: str | None, reach: str) -> None:
    assert reach_of(given, wanted) == reach


def test_local_removes_whatever_would_open_it_and_stays_local_in_processes_that_it_starts() -> None:
    environment = {"ROS_LOCALHOST_ONLY": "0", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "7", **PEERS}
    apply_reach(environment, "local")
    assert environment == {
        "ROS_DOMAIN_ID": "7",
        "FASTRTPS_DEFAULT_PROFILES_FILE": LOCAL_PROFILE,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "SKIP_DEFAULT_XML_FILE": "1",
    }
    assert is_local(environment)
    assert reach_of(environment) == "local"
    assert ALONE in describe_reach(environment)
    apply_reach(environment, "subnet")
    assert (environment["FASTRTPS_DEFAULT_PROFILES_FILE"], environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]) == (
        SUBNET_PROFILE,
        "SUBNET",
    )
    assert EVERYBODY in describe_reach(environment)


def test_a_profile_of_the_users_own_stays_in_use_for_the_subnet_and_decides_without_an_option() -> None:
    own = {"FASTRTPS_DEFAULT_PROFILES_FILE": "/none/mine.xml"}
    assert reach_variables(own) == {}
    assert (
        describe_reach(own)
        == "reach: as FASTRTPS_DEFAULT_PROFILES_FILE=/none/mine.xml says; `--reach local` keeps other machines out"
    )
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in reach_variables(own, "subnet")
    assert reach_variables(own, "local")["FASTRTPS_DEFAULT_PROFILES_FILE"] == LOCAL_PROFILE


def test_a_range_of_discovery_that_is_neither_keeps_the_large_shared_memory() -> None:
    off = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    assert reach_variables(off) == {"FASTRTPS_DEFAULT_PROFILES_FILE": SUBNET_PROFILE}
    assert (
        describe_reach(off, "reach:=")
        == "reach: as ROS_AUTOMATIC_DISCOVERY_RANGE=OFF says; `reach:=local` keeps other machines out"
    )


def test_another_middleware_gets_its_range_of_discovery_and_does_not_promise_more() -> None:
    other = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    apply_reach(other)
    assert other["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert describe_reach(other).startswith("reach: as ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST says")
    with pytest.raises(ConfigError, match="reach local needs Fast DDS, and RMW_IMPLEMENTATION is 'rmw_cyclonedds_cpp'"):
        reach_variables(other, "local")


def test_unknown_reach_names_those_there_are() -> None:
    with pytest.raises(ConfigError, match="reach is 'world', must be one of local, subnet"):
        reach_variables({}, "world")


def test_profiles_differ_only_in_who_reaches_them(root: Path) -> None:
    def leaves(name: str) -> list[tuple[str, str]]:
        tree = ElementTree.parse(root / "config" / name).iter()
        return [(element.tag.partition("}")[2], (element.text or "").strip()) for element in tree if not len(element)]

    closed, open_ = leaves("fastdds_local.xml"), leaves("fastdds.xml")
    only_local = [leaf for leaf in closed if leaf not in open_]
    assert [leaf for leaf in open_ if leaf not in closed] == []
    assert {text for tag, text in only_local if tag == "address"} == {"127.0.0.1"}
    assert {tag for tag, _ in only_local} == {"address", "maxInitialPeersRange", "sec", "nanosec"}


def test_variables_for_nodes_of_ones_own_are_printed_for_a_shell(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    assert run(["env"]) == 0
    assert capsys.readouterr().out == f"export FASTRTPS_DEFAULT_PROFILES_FILE={shlex.quote(SUBNET_PROFILE)}\n"
    assert run(["env", "--reach", "local"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {"export ROS_AUTOMATIC_DISCOVERY_RANGE=SYSTEM_DEFAULT", "unset ROS_STATIC_PEERS"} <= set(lines)
