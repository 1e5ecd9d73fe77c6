"""Files of a scene that was loaded on another machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.description.shapes import Appearance, Pattern, Shape, VisualSpec
from gibson_sim.errors import SceneNotFoundError
from gibson_sim.scenes.asset_paths import with_local_files
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import DrawnScene, LightSpec, SplatsSpec
from support.scenes import write_square_obj


def _scene(*meshes: str, content_hash: str = "", appearance: Appearance | None = None, environment: str = "") -> DrawnScene:
    visuals = tuple(VisualSpec(f"v{k}", "", Shape("mesh", mesh=mesh), appearance=appearance) for k, mesh in enumerate(meshes))
    return DrawnScene("s", 1, content_hash, (), visuals, (), LightSpec(environment=environment))


@pytest.fixture
def share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of ``$GIBSON_SIM_PATH`` with the scene ``shop``, which has one mesh."""
    folder = tmp_path / "share"
    write_square_obj(folder / "scenes" / "shop" / "meshes", "none.png")
    (folder / "scenes" / "shop" / "scene.yaml").write_text("name: shop\nobjects:\n  - {name: a, mesh: meshes/square.obj}\n")
    monkeypatch.setenv("GIBSON_SIM_PATH", str(folder))
    return folder


def test_paths_that_exist_are_left_alone(tmp_path: Path) -> None:
    mesh = write_square_obj(tmp_path, "none.png")
    scene = _scene(str(mesh))
    assert with_local_files(scene, [(str(tmp_path), "/nowhere")]) == (scene, ())


def test_a_mapped_folder_stands_for_the_one_there(tmp_path: Path) -> None:
    mesh = write_square_obj(tmp_path / "here" / "meshes", "none.png")
    there = "/there/assets/meshes/square.obj"
    appearance = Appearance(pattern=Pattern("image", image="/there/assets/meshes/square.mtl"))
    moved, _ = with_local_files(
        _scene(there, appearance=appearance, environment=there), [("/there/assets", str(tmp_path / "here"))]
    )
    assert moved.visuals[0].shape.mesh == moved.light.environment == str(mesh)
    assert moved.visuals[0].appearance.pattern.image == str(mesh.with_suffix(".mtl"))


def test_splats_are_found_as_meshes_are(tmp_path: Path) -> None:
    (tmp_path / "room.ply").write_bytes(b"ply")
    scene = replace(_scene(), splats=SplatsSpec("/there/room.ply", scale=2.0))
    moved, _ = with_local_files(scene, [("/there", str(tmp_path))])
    assert moved.splats == SplatsSpec(str(tmp_path / "room.ply"), scale=2.0)


def test_a_scene_is_found_by_its_name(share: Path) -> None:
    moved, _ = with_local_files(_scene("/opt/other/scenes/shop/meshes/square.obj"))
    assert moved.visuals[0].shape.mesh == str(share / "scenes/shop/meshes/square.obj")


def test_a_robot_is_found_by_its_name(root: Path) -> None:
    moved, _ = with_local_files(_scene("/opt/other/config/robots/gibson_bot/gibson_bot.urdf"))
    assert moved.visuals[0].shape.mesh == str(root / "config/robots/gibson_bot/gibson_bot.urdf")


def test_a_missing_file_is_named_with_the_remedy() -> None:
    with pytest.raises(SceneNotFoundError, match=r"^/opt/other/scenes/shop9/a\.obj is a file .* 'asset_roots'"):
        with_local_files(_scene("/opt/other/scenes/shop9/a.obj"))


def test_equal_scenes_on_both_machines_need_no_warning(share: Path) -> None:
    digest = load_scene("shop").content_hash
    assert with_local_files(_scene("/x/scenes/shop/meshes/square.obj", content_hash=digest))[1] == ()


def test_a_scene_that_differs_is_named(share: Path) -> None:
    _, warnings = with_local_files(_scene("/x/scenes/shop/meshes/square.obj", content_hash="0" * 64))
    assert len(warnings) == 1
    assert "square.obj" in warnings[0] and "differs between the two machines" in warnings[0]
