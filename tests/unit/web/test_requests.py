"""Valid requests of a page, and the refusal of others."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, strategies as st

from gibson_sim.errors import ConfigError
from gibson_sim.web.requests import (
    Drive,
    Goal,
    InitialPose,
    MoveJoint,
    Open,
    Plot,
    Record,
    RunTask,
    Spawn,
    Time,
    Watch,
    parse_request,
)


@pytest.mark.parametrize(
    ("message", "request_"),
    [
        ({"type": "drive", "linear": 0.4, "angular": -1}, Drive(0.4, 0.0, -1.0)),
        ({"type": "watch", "topics": ["/camera/image_raw"]}, Watch(("/camera/image_raw",))),
        ({"type": "initial_pose", "x": 1, "y": 2, "robot": ""}, InitialPose(1.0, 2.0)),
        ({"type": "goal", "x": 1, "y": 2.5, "yaw": 0.5}, Goal(1.0, 2.5, 0.5)),
        ({"type": "time", "action": "step", "steps": 10}, Time("step", 10)),
        ({"type": "time", "action": "pause"}, Time("pause", 1)),
        ({"type": "spawn", "uri": "bottle", "x": 1, "y": 2}, Spawn("bottle", 1.0, 2.0, 0.0)),
        ({"type": "drive", "linear": 1, "robot": "left"}, Drive(1.0, 0.0, 0.0, "left")),
        ({"type": "plot", "curves": [["/odom", "pose.pose.position.x"]]}, Plot((("/odom", "pose.pose.position.x"),))),
        ({"type": "open", "joint": "door/hinge", "opening": 1}, Open("door/hinge", 1.0)),
        ({"type": "joint", "joint": "arm_2", "position": -0.5, "robot": "left"}, MoveJoint("left", "arm_2", -0.5)),
        ({"type": "record", "action": "start"}, Record("start", images=False)),
        (
            {"type": "task", "action": "start", "task": "open-door", "baseline": "scripted", "seed": 3},
            RunTask("start", "open-door", "scripted", 3),
        ),
        ({"type": "task", "action": "stop"}, RunTask("stop")),
    ],
)
def test_a_request_is_read(message: dict[str, object], request_: object) -> None:
    assert parse_request(json.dumps(message)) == request_


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ("{", "is not JSON"),
        ("[" * 4000, "is not JSON"),
        ("[]", "must be a JSON object"),
        ('{"type": "reboot"}', "type is 'reboot', must be one of watch"),
        ('{"type": "drive", "linear": NaN}', "argument 'linear' is nan, must be -10 to 10 m/s"),
        ('{"type": "drive", "linear": 1e9}', "must be -10 to 10 m/s"),
        ('{"type": "drive", "linear": 1' + "0" * 400 + "}", "must be of type float"),
        (r'{"type": "delete", "name": "\ud800"}', "printable characters"),
        ('{"type": "drive", "linear": true}', "argument 'linear' is True (bool), must be of type float"),
        ('{"type": "time", "action": "step", "steps": 0}', "argument 'steps' is 0, must be 1 to 100000"),
        ('{"type": "rate", "value": -1}', "argument 'value' is -1.0, must be 0 to 1000"),
        ('{"type": "plot", "curves": [["/odom"]]}', "argument 'curves' is [['/odom']], must be a list of at most 16 pairs"),
        ('{"type": "plot", "curves": ' + str([["/a", "x"]] * 17).replace("'", '"') + "}", "must be a list of at most 16 pairs"),
        ('{"type": "open", "joint": "a/b", "opening": 1.1}', "argument 'opening' is 1.1, must be 0 to 1"),
        ('{"type": "record", "action": "start", "images": "/tmp"}', "argument 'images' is '/tmp' (str), must be of type bool"),
        (
            '{"type": "task", "action": "start", "task": "/etc/passwd"}',
            "argument 'task' is '/etc/passwd', must be one of point-goal",
        ),
        (
            '{"type": "task", "action": "start", "task": "open-door", "baseline": "rm"}',
            "argument 'baseline' is 'rm', must be one of none",
        ),
        ('{"type": "drive", "liner": 1}', "argument 'liner' of drive is unknown; did you mean 'linear'?; it has: linear, "),
        ('{"type": "drvie"}', "did you mean 'drive'?"),
        ('{"type": "spawn", "uri": ""}', "argument 'uri' of spawn is missing: Object of the catalogue"),
        ('{"type": "move", "name": "cup", "x": null, "y": 1}', "argument 'x' of move is missing: Position on the map, x"),
        ('{"type": "goal", "x": 1}', "argument 'y' of goal is missing"),
        ('{"type": "rate"}', "argument 'value' of rate is missing"),
        ('{"type": "open", "joint": "a/b", "opening": null}', "argument 'opening' of open is missing"),
        ('{"type": "joint", "joint": "a"}', "argument 'position' of joint is missing"),
        ('{"type": "watch", "topics": "all"}', "must be a list of at most 16 texts"),
        ('{"type": "delete", "name": "' + "x" * 5000 + '"}', "at most 4096 are allowed"),
    ],
)
def test_an_invalid_request_is_refused(message: str, reason: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_request(message)
    assert reason in str(error.value)


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), lambda v: st.lists(v) | st.dictionaries(st.text(), v)))
def test_nothing_else_is_raised(value: object) -> None:
    for message in (value, {"type": "move", "name": value, "x": value}, {"type": "watch", "topics": value}, {"type": value}):
        try:
            parse_request(json.dumps(message))
        except ConfigError:
            continue
