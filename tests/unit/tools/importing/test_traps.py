"""Oddities of public files that have no test of their own elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.types import Pose
from gibson_sim_tools.importing.importers import import_scene
from support.gltf import png
from support.interiors import room, write_obj

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="cm" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="pa" count="9">0 0 0 100 0 0 0 100 0</float_array>
      <technique_common><accessor source="#pa" count="3" stride="3"/></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="vs"><node id="world" name="world"><node id="world" name="world">
    <instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#vs"/></scene>
</COLLADA>"""


def _world(folder: Path, models: str) -> Path:
    (folder / "worlds").mkdir()
    (folder / "models" / "room" / "meshes").mkdir(parents=True)
    write_obj(folder / "models" / "room" / "meshes" / "room.obj", *room())
    (folder / "worlds" / "w.world").write_text(f"<sdf version='1.6'><world name='w'>{models}</world></sdf>")
    return folder / "worlds" / "w.world"


def _model(uri: str, name: str, z: float = 0.0) -> str:
    mesh = f"<geometry><mesh><uri>{uri}</uri></mesh></geometry>"
    link = f"<link name='l'><visual name='v'>{mesh}</visual></link>"
    return f"<model name='{name}'><pose>0 0 {z} 0 0 0</pose><static>true</static>{link}</model>"


@pytest.mark.parametrize("uri", ["file://models/room/meshes/room.obj", "model://room/meshes/room.obj"])
def test_a_world_with_strange_uris_far_models_and_missing_meshes_imports_the_rest(tmp_path: Path, uri: str) -> None:
    far, lost = _model(uri, "far", 343582.0), _model("model://room/meshes/gone.dae", "lost")
    imported = import_scene(_world(tmp_path, _model(uri, "room") + far + lost), tmp_path / "out")
    assert len(imported.scene.visuals) == 1
    assert any("far" in w for w in imported.warnings) and any("gone.dae" in w for w in imported.warnings)
    assert load_scene(tmp_path / "out").floor_z == pytest.approx(0.0)


def test_nodes_of_a_dae_may_be_called_world_twice_and_its_unit_holds(tmp_path: Path) -> None:
    (tmp_path / "a.DAE").write_text(DAE)
    (part,) = load_mesh(tmp_path / "a.DAE", [tmp_path]).parts
    np.testing.assert_allclose(part.vertices.max(axis=0), [1.0, 1.0, 0.0])


def test_a_urdf_may_hold_expressions_where_nothing_reads_them(tmp_path: Path) -> None:
    box = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
    text = f"<robot name='husky' extra='$(optenv HUSKY_X 0)'><link name='base'>{box}</link></robot>"
    (tmp_path / "husky.urdf").write_text(text)
    body = load_spawnable(str(tmp_path / "husky.urdf"), "", name="husky", pose=Pose(), roots=())
    assert body.name == "husky"


@pytest.mark.parametrize("texture", ["../materials/textures/red.png", "../Materials/Textures/Red.PNG", "red.png"])
def test_a_mesh_of_a_model_of_gazebo_keeps_its_textures_when_it_is_imported_by_file(tmp_path: Path, texture: str) -> None:
    model = tmp_path / "desk"
    (model / "meshes").mkdir(parents=True)
    (model / "materials" / "textures").mkdir(parents=True)
    (model / "materials" / "textures" / "red.png").write_bytes(png((255, 0, 0)))
    write_obj(model / "meshes" / "desk.obj", *room())
    obj = model / "meshes" / "desk.obj"
    obj.with_name("desk.mtl").write_text(f"newmtl red\nmap_Kd {texture}\n")
    obj.write_text("mtllib desk.mtl\nusemtl red\n" + obj.read_text())
    copied = import_scene(obj, tmp_path / "out")
    assert (copied.warnings, (tmp_path / "out/assets/materials/textures/red.png").is_file()) == ((), True)
    beside = import_scene(obj, None)
    assert (beside.warnings, beside.file) == ((), model / "scene.yaml")


def test_meshes_in_folders_below_meshes_find_the_textures_of_their_model(tmp_path: Path) -> None:
    model = tmp_path / "desk"
    (model / "meshes" / "fine").mkdir(parents=True)
    (model / "materials" / "textures").mkdir(parents=True)
    (model / "model.config").write_text("<model><name>desk</name></model>")
    (model / "materials" / "textures" / "red.png").write_bytes(png((255, 0, 0)))
    write_obj(model / "meshes" / "fine" / "desk.obj", *room())
    obj = model / "meshes" / "fine" / "desk.obj"
    obj.with_name("desk.mtl").write_text("newmtl red\nmap_Kd red.png\n")
    obj.write_text("mtllib desk.mtl\nusemtl red\n" + obj.read_text())
    assert import_scene(obj, tmp_path / "out").warnings == ()
    assert (tmp_path / "out/assets/materials/textures/red.png").is_file()


def test_a_mesh_whose_name_differs_in_case_alone_is_found(tmp_path: Path) -> None:
    scene = load_scene(_world(tmp_path, _model("model://Room/Meshes/ROOM.obj", "room")))
    assert [visual.name for visual in scene.visuals] == ["room"]
