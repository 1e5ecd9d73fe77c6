from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.errors import RecordError

IMAGE_HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
"""Type hash in share/sensor_msgs/msg/Image.json of ROS 2 Jazzy."""


def test_hash_of_image_is_that_of_jazzy() -> None:
    assert MessageDefinitions().type_hash("sensor_msgs/msg/Image") == IMAGE_HASH


def test_full_text_contains_every_nested_type_once_after_its_separator() -> None:
    text = MessageDefinitions().full_text("nav_msgs/msg/Odometry")
    heads = [line.removeprefix("MSG: ") for line in text.splitlines() if line.startswith("MSG: ")]
    assert sorted(heads) == sorted(
        [
            "std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose",
            "geometry_msgs/Point", "geometry_msgs/Quaternion", "geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist",
            "geometry_msgs/Vector3",
        ]
    )  # fmt: skip
    assert text.count("=" * 80 + "\nMSG: ") == len(heads)


def test_own_messages_are_found_in_the_source_tree() -> None:
    text = MessageDefinitions().full_text("gibson_msgs/msg/Scene")
    assert "MSG: gibson_msgs/Visual\n" in text
    assert "float64 fov_y" in text


def test_type_used_by_two_others_is_written_once() -> None:
    """Visual and Camera both contain a Pose."""
    assert MessageDefinitions().full_text("gibson_msgs/msg/Scene").count("MSG: geometry_msgs/Pose\n") == 1


def test_given_definition_wins_over_installed_one() -> None:
    text = MessageDefinitions({"std_msgs/String": "string other"}).full_text("std_msgs/msg/String")
    assert text == "string other\n"


def test_unknown_nested_type_is_named_with_the_type_that_contains_it() -> None:
    definitions = MessageDefinitions({"my_msgs/msg/Outer": "other_msgs/Inner inner\n"})
    with pytest.raises(RecordError, match=r"other_msgs/msg/Inner.*my_msgs/msg/Outer contains.*source the workspace"):
        definitions.full_text("my_msgs/msg/Outer")


def test_service_is_refused() -> None:
    with pytest.raises(RecordError, match="not a message type"):
        MessageDefinitions().full_text("std_srvs/srv/Empty")


@pytest.mark.ros
def test_hashes_are_those_of_the_ros_installation() -> None:
    files = [
        f for p in ("sensor_msgs", "nav_msgs", "gibson_msgs") for f in (Path(sys.prefix) / "share" / p / "msg").glob("*.json")
    ]
    if not files:
        pytest.skip("SKIPPED: no ROS message packages in this Python")
    definitions = MessageDefinitions()
    wrong = []
    for file in files:
        wanted = json.loads(file.read_text())["type_hashes"][0]
        if definitions.type_hash(wanted["type_name"]) != wanted["hash_string"]:
            wrong.append(wanted["type_name"])
    assert wrong == []


def test_service_has_two_definitions_with_their_nested_types() -> None:
    request, response = MessageDefinitions().service_texts("simulation_interfaces/srv/GetEntityState")
    assert request.count("string entity") == 1
    assert "MSG: " not in request
    assert "MSG: simulation_interfaces/EntityState\n" in response
    assert "MSG: geometry_msgs/Pose\n" in response
    with pytest.raises(RecordError, match=r"service type 'no_msgs/srv/No': no \.srv file found"):
        MessageDefinitions().service_texts("no_msgs/srv/No")
