"""Search of scenes, robots and files by path and by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim import resources
from gibson_sim.errors import ConfigError, RobotError, SceneNotFoundError
from gibson_sim.resources import cache_folder, find_config, find_robot, find_scene, known_scenes, share_folders
from support.scenes import write_room


def test_explicit_path_is_taken(tmp_path: Path) -> None:
    assert find_scene(str(write_room(tmp_path / "room"))) == (tmp_path / "room").resolve()


def test_missing_explicit_path_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneNotFoundError, match=r"room.* does not exist"):
        find_scene(tmp_path / "room")


@pytest.mark.parametrize("inner", ["scenes/barn", "barn"])
def test_name_is_found_under_the_search_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inner: str) -> None:
    write_room(tmp_path / inner)
    monkeypatch.setenv("GIBSON_SIM_PATH", f"/nonexistent:{tmp_path}")
    assert find_scene("barn") == (tmp_path / inner).resolve()
    assert known_scenes()["barn"].resolve() == (tmp_path / inner).resolve()


def test_first_folder_of_the_search_path_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        write_room(tmp_path / name / "scenes" / "barn")
    monkeypatch.setenv("GIBSON_SIM_PATH", f"{tmp_path / 'b'}:{tmp_path / 'a'}")
    assert find_scene("barn") == (tmp_path / "b" / "scenes" / "barn").resolve()


def test_misspelt_name_names_the_nearest_known_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_room(tmp_path / "scenes" / "warehouse")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path))
    with pytest.raises(SceneNotFoundError, match="did you mean 'warehouse'"):
        find_scene("warehose")


def test_installed_name_goes_before_a_folder_of_that_name_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_room(tmp_path / "share" / "scenes" / "barn")
    write_room(tmp_path / "here" / "barn")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path / "share"))
    monkeypatch.chdir(tmp_path / "here")
    assert find_scene("barn") == (tmp_path / "share" / "scenes" / "barn").resolve()
    assert find_scene("./barn") == (tmp_path / "here" / "barn").resolve()


def test_name_cannot_climb_out_of_a_share_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "share" / "scenes").mkdir(parents=True)
    write_room(tmp_path / "share" / "secret")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path / "share"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneNotFoundError):
        find_scene("x/../../../secret")


def test_configuration_is_found_without_its_suffix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "config" / "presets").mkdir(parents=True)
    (tmp_path / "config" / "presets" / "slow.yaml").write_text("{}")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path))
    assert find_config("slow", "presets") == (tmp_path / "config" / "presets" / "slow.yaml").resolve()
    with pytest.raises(ConfigError, match="did you mean 'slow'"):
        find_config("slov", "presets")


def test_unknown_robot_is_a_robot_error() -> None:
    with pytest.raises(RobotError, match="rovr"):
        find_robot("rovr")


@pytest.mark.parametrize("name", ["", "  "])
def test_empty_name_is_refused(name: str) -> None:
    with pytest.raises(SceneNotFoundError, match="empty"):
        find_scene(name)


def test_caches_are_where_the_desktop_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache_folder("scenes") == Path("/somewhere/gibson-sim/scenes")
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert cache_folder("scenes") == Path.home() / ".cache" / "gibson-sim" / "scenes"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder("scenes") == Path.home() / ".cache" / "gibson-sim" / "scenes"


def test_files_of_an_installation_made_of_links_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "src" / "warm.yaml"
    source.parent.mkdir()
    source.write_text("{}")
    presets = tmp_path / "share" / "config" / "presets"
    presets.mkdir(parents=True)
    (presets / "warm.yaml").symlink_to(source)
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path / "share"))
    assert find_config("warm", "presets") == source


def test_a_name_does_not_lead_out_of_the_folders_that_are_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "share" / "config" / "presets" / "inner").mkdir(parents=True)
    (tmp_path / "secret.yaml").write_text("{}")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path / "share"))
    monkeypatch.chdir(tmp_path / "share")
    with pytest.raises(ConfigError, match="is not found"):
        find_config("inner/../../../../secret", "presets")


def test_files_of_an_installation_that_is_a_link_to_the_sources_have_one_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tree, share = tmp_path / "tree", tmp_path / "prefix" / "share" / "gibson_sim"
    for name in ("config", "scenes"):
        (tree / name).mkdir(parents=True)
        share.mkdir(parents=True, exist_ok=True)
        (share / name).symlink_to(tree / name)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    monkeypatch.delenv("GIBSON_SIM_PATH", raising=False)
    assert share_folders()[0] == tree
    (share / "scenes").unlink()
    assert share_folders()[0] == share, "somebody's own link, which says nothing about where the rest is"


@pytest.mark.parametrize("site", ["lib/python3.11/site-packages", "lib/python3.11/dist-packages"])
def test_scenes_are_found_below_the_prefix_that_pip_installed_into(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, site: str
) -> None:
    share = tmp_path / "share" / "gibson_sim"
    write_room(share / "scenes" / "barn")
    module = tmp_path / site / "gibson_sim" / "resources.py"
    monkeypatch.setattr(resources, "__file__", str(module))
    assert find_scene("barn") == (share / "scenes" / "barn").resolve()


def test_without_any_scene_the_error_names_the_package_that_brings_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "share_folders", lambda: (tmp_path,))
    with pytest.raises(SceneNotFoundError, match="'barn' is not found; install gibson_sim_scenes, or set GIBSON_SIM_PATH"):
        find_scene("barn")
