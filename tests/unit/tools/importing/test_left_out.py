"""What an import cannot use stays visible by its own name and is listed."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.importing.checks.check import SceneReport, check_path
from gibson_sim_tools.importing.checks.fix import FixOptions, fix_scene
from gibson_sim_tools.importing.document import LEFT_OUT
from gibson_sim_tools.importing.importers import import_scene
from support.interiors import room, write_obj

TABLE = "<collision name='c'><geometry><box><size>1 2 0.8</size></box></geometry></collision>"
LOST = "<visual name='v'><geometry><mesh><uri>model://table/meshes/gone.dae</uri></mesh></geometry></visual>"
_MESH = "<geometry><mesh><uri>model://room/meshes/room.obj</uri></mesh></geometry>"
ROOM = f"<visual name='v'>{_MESH}</visual><collision name='c'>{_MESH}</collision>"


def world(folder: Path, **models: str) -> Path:
    (folder / "models" / "room" / "meshes").mkdir(parents=True)
    write_obj(folder / "models" / "room" / "meshes" / "room.obj", *room())
    text = "".join(
        f"<model name='{name}'><pose>1 1 0.4 0 0 0</pose><static>true</static><link name='l'>{inner}</link></model>"
        for name, inner in models.items()
    )
    (folder / "models" / "w.world").write_text(f"<sdf version='1.6'><world name='w'>{text}</world></sdf>")
    return folder / "models" / "w.world"


def texts(report: SceneReport, what: str) -> list[str]:
    return [finding.text for finding in report.findings if finding.what == what]


def test_a_model_without_its_mesh_is_drawn_as_its_collision_under_its_own_name(tmp_path: Path) -> None:
    scene = load_scene(world(tmp_path, room=ROOM, table=LOST + TABLE))
    (table,) = (visual for visual in scene.visuals if visual.name == "table")
    (solid,) = (collision for collision in scene.collisions if collision.name == "table")
    assert (table.shape, table.pose) == (solid.shape, solid.pose)
    assert table.color == (0.7, 0.7, 0.7, 1.0)
    assert any("table: is drawn as its collision shapes" in warning for warning in scene.warnings)


def test_omitted_visuals_are_named_and_stay_separate_objects(tmp_path: Path) -> None:
    path = world(tmp_path, room=ROOM, room_guard=TABLE)
    assert any("room_guard: is invisible" in warning for warning in load_scene(path).warnings)
    imported = import_scene(path, tmp_path / "out")
    assert [visual.name for visual in imported.scene.visuals] == ["room"]
    assert [collision.name for collision in imported.scene.collisions] == ["room", "room_guard"]
    fixed, _ = fix_scene(check_path(tmp_path / "out"), tmp_path / "fixed", FixOptions())
    assert [collision.name for collision in load_scene(fixed).collisions] == ["room", "room_guard"]


def test_a_visual_that_is_meant_to_be_transparent_is_not_drawn(tmp_path: Path) -> None:
    glass = "<visual name='v'><transparency>1</transparency><geometry><box><size>1 1 1</size></box></geometry></visual>"
    scene = load_scene(world(tmp_path, room=ROOM, glass=glass + TABLE))
    assert [visual.name for visual in scene.visuals] == ["room"]
    assert not scene.warnings


def test_check_repeats_what_the_import_left_out_and_fix_keeps_it(tmp_path: Path) -> None:
    imported = import_scene(world(tmp_path, room=ROOM, lost=LOST), tmp_path / "out")
    assert any("gone.dae" in warning for warning in imported.warnings)
    report = check_path(tmp_path / "out")
    (missing,) = texts(report, "missing")
    assert "gone.dae does not exist" in missing
    assert not report.clean
    _, again = fix_scene(report, tmp_path / "fixed", FixOptions())
    assert texts(again, "missing") == [missing]


def test_missing_textures_are_not_forgotten_by_a_mended_copy(tmp_path: Path) -> None:
    path = world(tmp_path, room=ROOM)
    obj = tmp_path / "models" / "room" / "meshes" / "room.obj"
    obj.with_name("room.mtl").write_text("newmtl wall\nmap_Kd wall.png\n")
    obj.write_text("mtllib room.mtl\nusemtl wall\n" + obj.read_text())
    import_scene(path, tmp_path / "out")
    report = check_path(tmp_path / "out")
    # Once, although both the import and the file itself tell of it.
    (texture,) = texts(report, "missing-texture")
    _, again = fix_scene(report, tmp_path / "fixed", FixOptions())
    assert [text.split("assets/")[-1] for text in texts(again, "missing-texture")] == [texture.split("assets/")[-1]]
    assert not again.clean


def test_a_clean_scene_has_no_such_file(tmp_path: Path) -> None:
    import_scene(world(tmp_path, room=ROOM), tmp_path / "out")
    assert not (tmp_path / "out" / LEFT_OUT).exists()


@pytest.mark.parametrize("text", ["[{kind: wrong, text: a}]", "{a: [}", "[{kind: other, text: 5}]", "3"])
def test_a_broken_note_is_one_line(tmp_path: Path, text: str) -> None:
    import_scene(world(tmp_path, room=ROOM), tmp_path / "out")
    (tmp_path / "out" / LEFT_OUT).write_text(text)
    (finding,) = check_path(tmp_path / "out").findings
    assert finding.what == "unreadable"
    assert LEFT_OUT in finding.text and "\n" not in finding.text


def test_friction_and_look_of_a_world_are_imported(tmp_path: Path) -> None:
    surface = "<surface><friction><ode><mu>{}</mu></ode></friction></surface>"
    geometry = "<geometry><capsule><radius>0.1</radius><length>0.5</length></capsule></geometry>"
    material = "<material><diffuse>1 0 0 1</diffuse><pbr><metal><metalness>0.25</metalness><roughness>0.75</roughness></metal></pbr></material>"
    plane = f'<collision name="p"><geometry><plane/></geometry>{surface.format(0.5)}</collision>'
    link = f'<visual name="v">{geometry}{material}</visual><collision name="c">{geometry}{surface.format(0.25)}</collision>'
    world = f'<model name="post"><static>1</static><link name="l">{link}{plane}</link></model>'
    (tmp_path / "w.sdf").write_text(f'<sdf version="1.9"><world name="w">{world}</world></sdf>')
    imported = load_scene(import_scene(tmp_path / "w.sdf", tmp_path / "out").file)
    original = load_scene(tmp_path / "w.sdf")
    assert [(c.shape, c.friction) for c in imported.collisions] == [(c.shape, c.friction) for c in original.collisions]
    assert [c.friction for c in imported.collisions] == [0.25]
    assert imported.ground_friction == 0.5
    assert [v.appearance for v in imported.visuals] == [v.appearance for v in original.visuals]
