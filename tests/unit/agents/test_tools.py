"""The declarations of an agent's tools, and what is refused before a simulation sees it."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.agents.tools import TOOLS, Drive, DriveTo, GetImage, StartSimulation, description, input_schema, parse_call
from gibson_sim.errors import ConfigError


def test_there_are_at_most_twenty_tools_each_described_by_one_sentence() -> None:
    assert len(TOOLS) <= 20
    for name, tool in TOOLS.items():
        assert re.fullmatch(r"[A-Z][^.\n]+\.", description(tool)), name


def test_arguments_are_read_with_their_defaults() -> None:
    assert parse_call("drive", {"linear": 1, "seconds": 2.0, "robot": None}) == Drive(linear=1.0, seconds=2.0)
    assert parse_call("start_simulation", {"seed": 7.0}) == StartSimulation(seed=7)
    assert parse_call("drive_to", {"x": 1.5, "y": -2}) == DriveTo(x=1.5, y=-2.0)


@pytest.mark.parametrize(
    ("name", "given", "error"),
    [
        ("drive", {"linear": math.nan, "seconds": 1}, "argument 'linear' is nan, must be -10 to 10 m/s"),
        ("drive", {"linear": "NaN", "seconds": 1}, "argument 'linear' is 'NaN' (str), must be of type float"),
        ("drive", {"seconds": 1e9}, "argument 'seconds' is 1000000000.0, must be 0.01 to 30 s"),
        ("drive", {"seconds": math.inf}, "argument 'seconds' is inf, must be 0.01 to 30 s"),
        ("drive", {"linear": 1.0}, "argument 'seconds' of drive is missing: Duration in simulation time, s"),
        ("drive", {"seconds": True}, "argument 'seconds' is True (bool), must be of type float"),
        ("drive", {"seconds": [1]}, "argument 'seconds' is [1] (list), must be of type float"),
        ("drive", {"seconds": 10**400}, "argument 'seconds' is a whole number of 401 digits (int), must be of type float"),
        ("drive", {"seconds": 1, "liner": 1}, "argument 'liner' of drive is unknown; did you mean 'linear'?; it has: linear, "),
        ("spawn", {"model": "", "x": 0, "y": 0}, "argument 'model' of spawn is missing: Object or robot that list_names lists"),
        ("spawn", {"model": "x" * 100_000, "x": 0, "y": 0}, "(100000 characters), must be at most 512 printable characters"),
        ("spawn", {"model": "a\nb", "x": 0, "y": 0}, "argument 'model' is 'a\\nb', must be at most 512 printable characters"),
        ("get_image", {"output": "thermal"}, "argument 'output' is 'thermal', must be one of rgb, depth"),
        ("get_image", {"width": 640.5}, "argument 'width' is 640.5 (float), must be of type int"),
        ("drvie", {}, "tool 'drvie' is unknown; did you mean 'drive'?; known: start_simulation, "),
    ],
)
def test_an_invalid_call_is_refused_in_one_line(name: str, given: dict[str, Any], error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_call(name, given)
    assert error in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 600


def test_schema_has_units_limits_and_defaults() -> None:
    schema = input_schema(Drive)
    assert schema["required"] == ["seconds"]
    assert schema["additionalProperties"] is False
    assert schema["properties"]["linear"] == {
        "type": "number", "description": "Forward velocity, m/s", "default": 0.0, "minimum": -10.0, "maximum": 10.0,
    }  # fmt: skip
    assert "default" not in schema["properties"]["seconds"]
    assert input_schema(GetImage)["properties"]["output"]["enum"] == ["rgb", "depth"]


def test_the_page_lists_all_tools_with_their_arguments(root: Path) -> None:
    rows = re.findall(r"(?m)^\| `(\w+)\((.*?)\)` \|", (root / "docs" / "agents.md").read_text())
    assert dict(rows) == {name: ", ".join(input_schema(tool)["properties"]) for name, tool in TOOLS.items()}
