"""An agent's files are those in the named folders, and no others."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.agents.folders import Folders
from gibson_sim.errors import ConfigError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret.yaml").write_text("secret")
    work = tmp_path / "work"
    work.mkdir()
    (work / "robot.yaml").write_text("")
    (work / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (work / "up").symlink_to(tmp_path)
    (work / "loop").symlink_to("loop")
    return work


def test_known_names_need_no_file(folder: Path) -> None:
    assert Folders([]).name_or_file("flat", ["flat"], "scene") == "flat"
    assert Folders([folder]).name_or_file("flat", ["flat"], "scene") == "flat"


def test_files_in_the_folders_are_found_by_relative_and_absolute_paths(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "scene.yaml").write_text("")
    folders = Folders([folder, other])
    assert folders.names == [str(folder), str(other)]
    assert folders.name_or_file("robot.yaml", [], "robot") == str(folder / "robot.yaml")
    assert folders.name_or_file(str(other / "scene.yaml"), [], "scene") == str(other / "scene.yaml")


@pytest.mark.parametrize(
    "path", ["/etc/passwd", "../secret.yaml", "link.yaml", "up/secret.yaml", "up/work/../secret.yaml", "~/x", "~root/.ssh/id"]
)
def test_paths_that_lead_out_are_refused(folder: Path, path: str) -> None:
    with pytest.raises(ConfigError, match=r"is outside of the folders of this server, .*--folder DIR") as caught:
        Folders([folder]).name_or_file(path, [], "robot")
    assert "secret:" not in str(caught.value)
    with pytest.raises(ConfigError, match="is outside of the folders"):
        Folders([folder]).new_folder(path, "recordings")


@pytest.mark.parametrize("path", ["a\0b", "loop", "x" * 5000])
def test_an_invalid_path_is_refused_in_one_line(folder: Path, path: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Folders([folder]).name_or_file(path, [], "robot")
    assert str(caught.value).isprintable()


def test_a_name_like_a_known_one_is_a_hint(folder: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"robot 'gibson_boot' is neither a known name nor a file in .*; did you mean 'gibson_bot'"
    ):
        Folders([folder]).name_or_file("gibson_boot", ["gibson_bot"], "robot")
    with pytest.raises(ConfigError, match="which has none: start the server with `--folder DIR`"):
        Folders([]).name_or_file("robot.yaml", ["gibson_bot"], "robot")
    with pytest.raises(ConfigError, match=r"scene 'nowhere' is neither .*; known names: flat, hall"):
        Folders([folder]).name_or_file("nowhere", ["flat", "hall"], "scene")
    with pytest.raises(ConfigError, match="known names: `list_names` lists all 30"):
        Folders([folder]).name_or_file("nowhere", [f"scene_{k}" for k in range(30)], "scene")


def test_new_folders_are_new_and_inside(folder: Path) -> None:
    folders = Folders([folder])
    assert folders.new_folder("bags/one", "recordings") == folder / "bags" / "one"
    assert folders.new_folder("", "recordings").parent == folder / "recordings"
    with pytest.raises(ConfigError, match=r"folder 'robot.yaml' already exists"):
        folders.new_folder("robot.yaml", "recordings")
    with pytest.raises(ConfigError, match="there is no folder for recordings: start the server with"):
        Folders([]).new_folder("", "recordings")


def test_an_option_that_is_no_folder_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"--folder .* is not a folder; create it"):
        Folders([folder / "robot.yaml"])
