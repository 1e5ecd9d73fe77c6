"""Messages as YAML and back."""

from __future__ import annotations

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

import yaml  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from sensor_msgs.msg import JointState, LaserScan  # noqa: E402
from simulation_interfaces.srv import StepSimulation  # noqa: E402
from std_msgs.msg import Bool, Header, String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_sim.ros.tools.yaml_messages import (  # noqa: E402
    SHORT,
    MessageValueError,
    field_of,
    fill,
    value_text,
    yaml_text,
)

pytestmark = pytest.mark.ros


def test_a_message_is_one_field_a_line() -> None:
    message = fill(JointState(), {"header": {"frame_id": "base", "stamp": {"sec": 3}}, "name": ["a", "b"], "position": [1, 2.5]})
    assert yaml_text(message) == (
        "header:\n  stamp:\n    sec: 3\n    nanosec: 0\n  frame_id: base\nname:\n- a\n- b\nposition:\n- 1.0\n- 2.5\nvelocity: []\neffort: []\n"
    )


def test_arrays_can_be_in_one_line() -> None:
    joints = fill(JointState(), {"name": ["a", "b c"], "position": [1, 2.5]})
    assert yaml_text(joints, inline=True).splitlines()[-4:] == [
        "name: [a, b c]",
        "position: [1.0, 2.5]",
        "velocity: []",
        "effort: []",
    ]
    assert yaml.safe_load(yaml_text(joints, inline=True))["name"] == ["a", "b c"]
    scan = LaserScan(ranges=[1.0] * (SHORT + 5))
    assert yaml_text(scan, inline=True).endswith(f"ranges: [{', '.join(['1.0'] * SHORT)}, ...]\nintensities: []\n")
    transforms = fill(TFMessage(), {"transforms": [{"child_frame_id": "x"}, {}]})
    assert yaml.safe_load(yaml_text(transforms, inline=True)) == yaml.safe_load(yaml_text(transforms))


def test_printed_yaml_fills_an_equal_message() -> None:
    given = {"transforms": [{"child_frame_id": "it's", "transform": {"rotation": {"w": 0.5}}}, {"header": {"frame_id": "a: b"}}]}
    message = fill(TFMessage(), given)
    assert fill(TFMessage(), yaml.safe_load(yaml_text(message, whole=True))) == message


def test_special_numbers_are_those_of_yaml() -> None:
    scan = LaserScan(ranges=[float("inf"), float("-inf"), float("nan")])
    assert value_text(field_of(scan, "ranges")) == "[inf, -inf, nan]\n"
    assert "ranges:\n- .inf\n- -.inf\n- .nan\n" in yaml_text(scan)


def test_long_arrays_are_cut_unless_all_values_are_requested() -> None:
    scan = LaserScan(ranges=[1.0] * (SHORT + 5))
    assert yaml_text(scan).count("- 1.0\n") == SHORT and "- '...'\n" in yaml_text(scan)
    assert yaml_text(scan, whole=True).count("- 1.0\n") == SHORT + 5


def test_a_field_is_found_by_its_path() -> None:
    message = fill(PoseWithCovarianceStamped(), {"pose": {"pose": {"position": {"x": 2}}}})
    assert value_text(field_of(message, "pose.pose.position.x")) == "2.0\n"
    assert value_text(field_of(message, "pose.covariance[3]")) == "0.0\n"
    with pytest.raises(MessageValueError, match="field 'poze' does not exist; known: header, pose"):
        field_of(message, "poze")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"heder": {}}, "heder: this field does not exist; did you mean 'header'? known: header, pose"),
        ({"pose": {"pose": {"position": {"x": "far"}}}}, "pose.pose.position.x is 'far', must be of type double"),
        ({"pose": {"covariance": [1.0]}}, "pose.covariance is"),
        ([1], "must be a mapping with header, pose"),
    ],
)
def test_a_value_that_does_not_fit_is_named(values: object, text: str) -> None:
    with pytest.raises(MessageValueError) as error:
        fill(PoseWithCovarianceStamped(), values)
    assert text in str(error.value)


@pytest.mark.parametrize(
    ("message", "values", "text"),
    [
        (StepSimulation.Request(), {"steps": -1}, "steps is -1, must be of type uint64: 0 to 18446744073709551615"),
        (Header(), {"stamp": {"sec": 2**31}}, "stamp.sec is 2147483648, must be of type int32: -2147483648 to 2147483647"),
        (Bool(), {"data": 1}, "data is 1, must be of type boolean: true or false"),
        (String(), {"data": True}, "data is True, must be of type string: put it in quotes, as in 'yes'"),
        (String(), {"data": 5}, "data is 5, must be of type string: put it in quotes, as in '5'"),
        (Header(), {"stamp": 1}, "stamp is 1, must be a mapping with sec, nanosec"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_the_allowed_values(message: object, values: object, text: str) -> None:
    with pytest.raises(MessageValueError) as error:
        fill(message, values)
    assert str(error.value) == text
