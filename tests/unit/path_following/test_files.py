"""The launch file, loaded by stand-ins for launch, and the file with the parameters."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from gibson_path_following.options import EvaluatorOptions, LocaliserOptions, PolicyOptions, RecorderOptions
from support.launching import LaunchFile
from support.simulation import require

require("ament_index_python")

PACKAGE = Path(__file__).resolve().parents[3] / "ros_ws" / "src" / "gibson_path_following"
OPTIONS = {
    "path_recorder": RecorderOptions, "path_localiser": LocaliserOptions, "path_policy": PolicyOptions,
    "path_evaluator": EvaluatorOptions,
}  # fmt: skip


def test_the_launch_file_starts_the_policy_and_on_request_the_evaluator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    names.mkdir(parents=True)
    (names / "gibson_path_following").touch()
    (tmp_path / "share" / "gibson_path_following").symlink_to(PACKAGE)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    file = LaunchFile(PACKAGE / "launch" / "path_following.launch.py", monkeypatch)
    nodes = {node.options["name"]: node.options for node in file.of_kind("Node")}
    assert set(nodes) == {"path_policy", "path_evaluator"}
    assert "condition" in nodes["path_evaluator"] and "condition" not in nodes["path_policy"]
    for name, options in nodes.items():
        given = {key for part in options["parameters"] if isinstance(part, dict) for key in part} - {"use_sim_time"}
        assert given <= {one.name for one in fields(OPTIONS[name])}


def test_the_parameters_in_the_file_are_those_of_the_nodes_with_values_that_are_allowed() -> None:
    document = yaml.safe_load((PACKAGE / "config" / "path_following.yaml").read_text())
    found = {name.rpartition("/")[2]: values["ros__parameters"] for name, values in document.items()}
    assert set(found) == set(OPTIONS)
    for name, values in found.items():
        needed = {"path": "p"} if name != "path_recorder" else {}
        OPTIONS[name](**values, **needed)
