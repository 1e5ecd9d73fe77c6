"""The launch files for Nav2, slam_toolbox and robot_localization, loaded by stand-ins for launch: what they start, and with which files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from support.launching import LaunchFile, Said
from support.simulation import require

require("ament_index_python")

EXAMPLES = Path(__file__).resolve().parents[3] / "ros_ws" / "src" / "gibson_examples"


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An ament index with this source tree's examples, as colcon installs them with links."""
    _add(tmp_path, "gibson_examples")
    (tmp_path / "share" / "gibson_examples").rmdir()
    (tmp_path / "share" / "gibson_examples").symlink_to(EXAMPLES)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    return tmp_path


def _add(prefix: Path, package: str) -> None:
    names = prefix / "share" / "ament_index" / "resource_index" / "packages"
    names.mkdir(parents=True, exist_ok=True)
    (names / package).touch()
    (prefix / "share" / package).mkdir()


def _load(name: str, monkeypatch: pytest.MonkeyPatch) -> LaunchFile:
    return LaunchFile(EXAMPLES / "launch" / f"{name}.launch.py", monkeypatch)


def _defaults(file: LaunchFile) -> dict[str, str]:
    return {action.given[0]: action.options["default_value"] for action in file.of_kind("DeclareLaunchArgument")}


def _section(path: str) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(Path(path).read_text())
    return document


def test_nav2_starts_servers_that_the_file_has_parameters_for(index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = _load("nav2", monkeypatch)
    parameters = _section(_defaults(file)["params_file"])
    nodes = file.of_kind("Node")
    servers = [node.options["name"] for node in nodes if node.options["package"] != "nav2_lifecycle_manager"]
    assert {"amcl", "controller_server", "planner_server", "bt_navigator"} <= set(servers) <= set(parameters)
    managers = [node for node in nodes if node.options["package"] == "nav2_lifecycle_manager"]
    managed = [name for node in managers for settings in node.options["parameters"] for name in settings["node_names"]]
    assert sorted(managed) == sorted(servers)
    assert all(node.options["parameters"][0]["use_sim_time"] is True for node in managers)
    conditions = [node.options["name"] for node in nodes if "condition" in node.options]
    assert conditions == ["amcl", "lifecycle_manager_localization"], "with SLAM nothing else publishes map -> odom"


def test_slam_starts_slam_toolbox_with_our_file_and_nav2_without_amcl(index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _add(index, "slam_toolbox")
    file = _load("slam", monkeypatch)
    defaults = _defaults(file)
    assert "slam_toolbox" in _section(defaults["slam_params_file"])
    assert "params_file" not in defaults, "nav2.launch.py would read it"
    slam, nav2 = file.of_kind("IncludeLaunchDescription")
    assert _path(slam) == str(index / "share" / "slam_toolbox" / "launch" / "online_async_launch.py")
    arguments = dict(slam.options["launch_arguments"])
    assert arguments["use_sim_time"] == "true"
    assert arguments["slam_params_file"].given == ("slam_params_file",)
    assert Path(_path(nav2)).samefile(EXAMPLES / "launch" / "nav2.launch.py")
    assert dict(nav2.options["launch_arguments"]) == {"localisation": "none"}
    assert nav2.options["condition"].given[0].given == ("nav2",)
    assert defaults["nav2"] == "false"
    (localisation,) = [a for a in _load("nav2", monkeypatch).of_kind("DeclareLaunchArgument") if a.given[0] == "localisation"]
    assert "none" in localisation.options["choices"]


def _path(include: Said) -> str:
    path: str = include.given[0].given[0]
    return path


def test_slam_toolbox_that_is_missing_is_named(index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match=r"^slam_toolbox is not installed: `sudo apt install ros-jazzy-slam-toolbox`$"):
        _load("slam", monkeypatch)


def test_filter_gets_the_section_of_its_name(index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = _load("ekf", monkeypatch)
    (node,) = file.of_kind("Node")
    assert node.options["name"] in _section(_defaults(file)["params_file"])
    assert node.options["parameters"][0].given == ("params_file",)


def test_every_launch_file_and_parameter_file_is_installed() -> None:
    setup = (EXAMPLES / "setup.py").read_text()
    assert 'glob("launch/*.launch.py")' in setup and 'glob("config/*.yaml")' in setup
    assert {path.name for path in (EXAMPLES / "launch").iterdir() if path.suffix == ".py"} == {
        "ekf.launch.py", "nav2.launch.py", "slam.launch.py",
    }  # fmt: skip
    manifest = (EXAMPLES / "package.xml").read_text()
    for package in ("nav2_bringup", "robot_localization", "slam_toolbox"):
        assert f"<exec_depend>{package}</exec_depend>" not in manifest, "an example must not make every user install it"
