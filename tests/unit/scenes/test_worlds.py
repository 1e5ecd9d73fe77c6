"""Lists of worlds, and the errors for worlds that cannot be loaded."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import pytest

from gibson_sim.formats.splats import splats_ply
from gibson_sim.scenes import worlds
from gibson_sim.scenes.worlds import WorldError, WorldFailure, absolute_uri, find_worlds, load_world
from support.scenes import write_room, write_square_obj, write_triangle_glb
from support.splat_files import random_splats

GROUND = "<include><uri>model://ground_plane</uri></include>"
BOX = "<link name='l'><visual name='v'><geometry><box><size>1 2 3</size></box></geometry></visual></link>"
CODES = WorldFailure


def _sdf(content: str = GROUND) -> str:
    return f"<sdf version='1.7'><world name='yard'>{content}</world></sdf>"


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def _error(uri: str = "", text: str = "", **flags: bool) -> WorldError:
    with pytest.raises(WorldError) as caught:
        load_world(uri, text, **flags)
    assert "\n" not in str(caught.value)
    assert "nonexistent" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("as_uri", [True, False])
def test_world_is_loaded_by_path_and_by_uri(tmp_path: Path, as_uri: bool) -> None:
    path = _write(tmp_path / "my yard.world", _sdf())
    assert load_world(path.as_uri() if as_uri else str(path), "").ground_z == 0.0


def test_installed_scene_is_loaded_by_name() -> None:
    assert load_world("flat", "").name == "flat"


def test_uri_of_a_relative_path_is_valid_in_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "living").mkdir()
    (tmp_path / "flat").mkdir()
    monkeypatch.chdir(tmp_path)
    assert absolute_uri("living") == absolute_uri("./living") == str(tmp_path / "living")
    assert absolute_uri("flat") == "flat"  # names take precedence over folders here
    assert absolute_uri("nowhere") == "nowhere"


def test_text_is_a_world() -> None:
    scene = load_world("", "\n<?xml version='1.0'?>" + _sdf(f"{GROUND}<model name='m'>{BOX}</model>"))
    assert (scene.name, scene.ground_z, [v.name for v in scene.visuals]) == ("yard", 0.0, ["m"])


def test_uri_wins_over_text(tmp_path: Path) -> None:
    assert load_world(str(write_room(tmp_path)), _sdf()).name == "tiny_room"


def test_equal_texts_give_equal_hashes_and_others_do_not() -> None:
    one, same, other = (load_world("", _sdf(GROUND + more)).content_hash for more in ("", "", f"<model name='m'>{BOX}</model>"))
    assert one == same
    assert one != other


def test_models_of_a_text_come_from_the_path_of_gibson_sim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write(tmp_path / "models" / "chair" / "model.sdf", f"<sdf version='1.7'><model name='chair'>{BOX}</model></sdf>")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path))
    assert [v.name for v in load_world("", _sdf("<include><uri>model://chair</uri></include>")).visuals] == ["chair"]


def test_a_text_world_cannot_name_local_mesh_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_square_obj(tmp_path, "t.png")
    monkeypatch.chdir(tmp_path)
    for name in ("square.obj", str(tmp_path / "square.obj")):
        mesh = f"<link name='l'><visual name='v'><geometry><mesh><uri>{name}</uri></mesh></geometry></visual></link>"
        error = _error(text=_sdf(f"{GROUND}<model name='m'>{mesh}</model>"))
        assert error.code in (CODES.MISSING_ASSETS, CODES.UNSUPPORTED_ASSETS)


@pytest.mark.parametrize(
    "uri", ["", "nowhere_at_all", "/nowhere", "file:///nowhere.sdf", "http://example.org/w.sdf", "x\0y", "/" + "x" * 300]
)
def test_missing_world_is_no_resource(uri: str) -> None:
    assert _error(uri).code is CODES.NO_RESOURCE


def test_folder_without_a_world_is_no_resource(tmp_path: Path) -> None:
    assert _error(str(tmp_path)).code is CODES.NO_RESOURCE


@pytest.mark.parametrize("uri", ["/etc/passwd", "/dev/zero"])
def test_other_files_are_an_unsupported_format(uri: str) -> None:
    assert _error(uri).code in (CODES.UNSUPPORTED_FORMAT, CODES.NO_RESOURCE)


@pytest.mark.parametrize("text", ["hello", "<sdf><model name='m'/></sdf>", "<robot/>"])
def test_other_texts_are_an_unsupported_format(text: str) -> None:
    assert _error(text=text).code is CODES.UNSUPPORTED_FORMAT


@pytest.mark.parametrize("text", ["<sdf><world", _sdf("")])
def test_broken_and_empty_worlds_are_parse_errors(text: str) -> None:
    assert _error(text=text).code is CODES.RESOURCE_PARSE_ERROR


def test_mistake_in_scene_yaml_is_a_parse_error(tmp_path: Path) -> None:
    assert _error(str(_write(tmp_path / "scene.yaml", "objektes: []\n"))).code is CODES.RESOURCE_PARSE_ERROR


def test_missing_and_broken_meshes_of_scene_yaml_are_distinguished(tmp_path: Path) -> None:
    path = _write(tmp_path / "scene.yaml", "objects: [{mesh: a.obj}]\n")
    assert _error(str(path)).code is CODES.MISSING_ASSETS
    (tmp_path / "a.obj").write_text("v 1 x\n")
    assert _error(str(path)).code is CODES.UNSUPPORTED_ASSETS


def test_a_mesh_that_is_too_large_is_an_unsupported_asset_of_a_loaded_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worlds, "MAX_BYTES", 100)
    path = _write(tmp_path / "scene.yaml", "objects: [{mesh: a.obj}]\n")
    (tmp_path / "a.obj").write_text("v 0 0 0\n" * 13)
    error = _error(str(path))
    assert error.code is CODES.UNSUPPORTED_ASSETS and "it is too large" in str(error)


def test_splats_are_checked_to_the_last_number_before_a_world_counts_as_loaded(tmp_path: Path) -> None:
    path = _write(tmp_path / "scene.yaml", "objects: [{box: [1, 1, 1]}]\nvisual: {splats: room.ply, up_axis: z}\n")
    good = splats_ply(random_splats(3))
    for data, message in (
        (good[:-4], "do not fit into .* bytes; the file is cut"),
        (good[:-4] + b"\xff\xff\xff\xff", "the rotation of 1 of 3 splats is NaN"),
        (b"\xff\xd8\xff", "is not a file of splats"),
    ):
        (tmp_path / "room.ply").write_bytes(data)
        error = _error(str(path))
        assert error.code is CODES.UNSUPPORTED_ASSETS and "splats" in error.public
        assert re.search(message, str(error))
    (tmp_path / "room.ply").write_bytes(good)
    assert load_world(str(path), "").splats is not None


def _house(folder: Path) -> str:
    write_square_obj(folder / "models" / "pane" / "meshes", "gone.png")
    mesh = "<link name='l'><visual name='v'><geometry><mesh><uri>model://{}</uri></mesh></geometry></visual></link>"
    pane, door = mesh.format("pane/meshes/square.obj"), mesh.format("door/door.obj")
    models = f"<model name='pane'>{pane}</model><model name='door'>{door}</model><include><uri>model://portrait</uri></include>"
    return str(_write(folder / "worlds" / "house.world", _sdf(GROUND + models)))


def test_every_missing_asset_is_named(tmp_path: Path) -> None:
    error = _error(_house(tmp_path))
    assert error.code is CODES.MISSING_ASSETS
    for name in ("gone.png", "door.obj", "model://portrait"):
        assert name in str(error)


def test_missing_assets_are_left_out_on_request(tmp_path: Path) -> None:
    scene = load_world(_house(tmp_path), "", ignore_missing=True)
    assert [v.name for v in scene.visuals] == ["pane"]
    assert sum("left out" in w or "missing" in w for w in scene.warnings) == 3


def test_broken_mesh_is_an_unsupported_asset(tmp_path: Path) -> None:
    _write(tmp_path / "a.obj", "v 1 x\n")
    mesh = "<link name='l'><visual name='v'><geometry><mesh><uri>a.obj</uri></mesh></geometry></visual></link>"
    path = str(_write(tmp_path / "w.sdf", _sdf(f"{GROUND}<model name='m'>{mesh}</model>")))
    assert _error(path).code is CODES.UNSUPPORTED_ASSETS
    assert load_world(path, "", ignore_missing=True).visuals == ()


UNSUPPORTED = (
    "<actor name='walker'/><model name='m'><static>1</static><link name='l'><visual name='v'><geometry><heightmap/></geometry></visual>"
    "</link></model>"
)


def test_elements_that_are_not_simulated_are_named_on_request() -> None:
    error = _error(text=_sdf(GROUND + UNSUPPORTED), fail_on_unsupported=True)
    assert error.code is CODES.UNSUPPORTED_ELEMENTS
    assert "walker" in str(error)
    assert "heightmap" in str(error)


def test_elements_that_are_not_simulated_are_left_out_otherwise() -> None:
    assert len(load_world("", _sdf(GROUND + UNSUPPORTED)).warnings) == 2


def test_world_with_models_that_include_themselves_loads_without_the_loops(tmp_path: Path) -> None:
    include = "<include><uri>model://loop</uri></include>" * 3
    _write(tmp_path / "models" / "loop" / "model.sdf", f"<sdf version='1.7'><model name='loop'>{BOX}{include}</model></sdf>")
    scene = load_world(str(_write(tmp_path / "worlds" / "w.world", _sdf("<include><uri>model://loop</uri></include>"))), "")
    assert [v.name for v in scene.visuals] == ["loop"]
    assert any("includes itself" in warning for warning in scene.warnings)


def test_models_that_multiply_are_an_error(tmp_path: Path) -> None:
    for k in range(9):
        include = f"<include><uri>model://m{k + 1}</uri></include>" * 6
        _write(tmp_path / "models" / f"m{k}" / "model.sdf", f"<sdf version='1.7'><model name='m'>{include}</model></sdf>")
    _write(tmp_path / "models" / "m9" / "model.sdf", f"<sdf version='1.7'><model name='m'>{BOX}</model></sdf>")
    path = _write(tmp_path / "worlds" / "w.world", _sdf("<include><uri>model://m0</uri></include>"))
    error = _error(str(path))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "10000" in str(error)


# Lists


def test_our_scenes_are_listed_by_name() -> None:
    (flat,) = [world for world in find_worlds(()) if world.name == "flat"]
    assert (flat.uri, flat.tags) == ("flat", ("scene.yaml",))


def test_worlds_of_a_folder_are_listed_and_can_be_loaded(tmp_path: Path) -> None:
    write_room(tmp_path / "room", "description: A small room.\n")
    _write(tmp_path / "gz" / "worlds" / "yard.world", _sdf())
    _write(tmp_path / "gz" / "models" / "lamp" / "model.sdf", f"<sdf><model name='lamp'>{BOX}</model></sdf>")
    write_triangle_glb(tmp_path / "gz" / "models" / "lamp" / "lamp.glb")
    (tmp_path / "scan").mkdir()
    write_triangle_glb(tmp_path / "scan" / "house.glb")
    _write(tmp_path / "drake" / "den.dmd.yaml", "directives: []\n")
    (tmp_path / "drake" / "assets").mkdir()
    write_triangle_glb(tmp_path / "drake" / "assets" / "sofa.glb")
    found = [world for world in find_worlds([str(tmp_path)]) if world.uri.startswith("file:")]
    assert [(world.name, world.tags) for world in found] == [
        ("den", ("drake",)), ("yard", ("sdf",)), ("tiny_room", ("scene.yaml",)), ("house", ("mesh",)),
    ]  # fmt: skip
    assert found[2].description == "A small room."
    assert load_world(found[3].uri, "").name == "house"


def test_missing_source_is_an_error_unless_it_may_be_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = _write(tmp_path / "yard.world", _sdf())
    sources = [str(tmp_path / "gone"), path.as_uri()]
    with pytest.raises(WorldError, match="gone") as caught:
        find_worlds(sources)
    assert caught.value.code is CODES.NO_RESOURCE
    with caplog.at_level(logging.WARNING):
        assert find_worlds(sources, continue_on_error=True)[-1].name == "yard"
    assert "gone" in caplog.text
