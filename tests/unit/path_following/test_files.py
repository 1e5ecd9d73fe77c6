"""The launch file, loaded by stand-ins for launch, and the file with the parameters."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from gibson_path_following.options import EvaluatorOptions, GogglesOptions, LocaliserOptions, PolicyOptions, RecorderOptions
from support.launching import LaunchFile
from support.simulation import require

require("ament_index_python")

PACKAGE = Path(__file__).resolve().parents[3] / "ros_ws" / "src" / "gibson_path_following"
OPTIONS = {
    "path_recorder": RecorderOptions, "path_localiser": LocaliserOptions, "path_policy": PolicyOptions,
    "path_evaluator": EvaluatorOptions, "goggles": GogglesOptions,
}  # fmt: skip


def _launch_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LaunchFile:
    names = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    names.mkdir(parents=True)
    (names / "gibson_path_following").touch()
    (tmp_path / "share" / "gibson_path_following").symlink_to(PACKAGE)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    return LaunchFile(PACKAGE / "launch" / "path_following.launch.py", monkeypatch)


def test_the_launch_file_starts_the_policy_and_on_request_evaluator_and_goggles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = _launch_file(tmp_path, monkeypatch)
    nodes = {node.options["name"]: node.options for node in file.of_kind("Node")}
    assert set(nodes) == {"path_policy", "path_evaluator", "goggles"}
    assert [name for name, options in nodes.items() if "condition" not in options] == ["path_policy"]
    for name, options in nodes.items():
        given = {key for part in options["parameters"] if isinstance(part, dict) for key in part} - {"use_sim_time"}
        assert given <= {one.name for one in fields(OPTIONS[name])}


def test_with_goggles_the_policy_gets_their_images_and_calibration_in_place_of_the_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    actions = _launch_file(tmp_path, monkeypatch).actions
    remaps = [action for action in actions if action.kind == "SetRemap"]
    assert [action.given for action in remaps] == [
        ("camera/image_raw", "goggles/image_raw"), ("camera/camera_info", "goggles/camera_info"),
    ]  # fmt: skip
    (goggles, policy) = (
        next(k for k, action in enumerate(actions) if action.options.get("name") == name) for name in ("goggles", "path_policy")
    )
    assert goggles < min(map(actions.index, remaps)) and max(map(actions.index, remaps)) < policy
    assert all(action.options["condition"] is actions[goggles].options["condition"] for action in remaps)


def test_the_parameters_in_the_file_are_those_of_the_nodes_with_values_that_are_allowed() -> None:
    document = yaml.safe_load((PACKAGE / "config" / "path_following.yaml").read_text())
    found = {name.rpartition("/")[2]: values["ros__parameters"] for name, values in document.items()}
    assert set(found) == set(OPTIONS)
    for name, values in found.items():
        needed = {"path": "p"} if name.startswith("path_") and name != "path_recorder" else {}
        OPTIONS[name](**values, **needed)
