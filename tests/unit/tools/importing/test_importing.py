"""Third-party folders, meshes and worlds become our scenes."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from gibson_sim.cli.main import main
from gibson_sim.errors import ConfigError, GibsonSimError, SceneError, SceneNotFoundError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import Material, Mesh, MeshPart
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import collision_triangles, scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.importing.checks.check import check_path
from gibson_sim_tools.importing.checks.fix import FixOptions, fix_scene
from gibson_sim_tools.importing.document import is_scan
from gibson_sim_tools.importing.importers import ImportOptions, import_scene
from support.gltf import Gltf
from support.interiors import SIZE, room, turned, write_gibson_folder, write_obj, write_replica_folder
from support.plys import ply


def _bounds(scene: SceneSpec) -> np.ndarray:
    vertices, _ = collision_triangles(scene)
    return np.array([vertices.min(axis=0), vertices.max(axis=0)])


def _run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["scene", *map(str, words)])
    return int(ended.value.code or 0)


# Gibson


def test_a_folder_in_gibsons_layout_imports_with_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_gibson_folder(tmp_path / "Tiny", floors=(0.0, 2.6))
    assert _run("import", folder, "--output", tmp_path / "out") == 0
    assert "from a Gibson folder" in capsys.readouterr().out
    scene = load_scene(tmp_path / "out")
    assert scene.name == "Tiny"
    assert scene.floors == (0.0, 2.6)
    assert (scene.light.sun, scene.light.ambient) == (0.0, 1.0)
    np.testing.assert_allclose(_bounds(scene), [[-3, -2, 0], [3, 2, 2.5]])
    drawn = MeshLoader(scene_roots(scene)).shape(scene.visuals[0].shape).parts[0]
    assert drawn.material.texture is not None and drawn.material.texture.pixels[0, 0].tolist() == [180, 120, 60]
    assert scene.warnings == ()


def test_the_coarse_mesh_of_gibson_is_its_collision_mesh(tmp_path: Path) -> None:
    write_gibson_folder(tmp_path / "Tiny")
    scene = import_scene(tmp_path / "Tiny", tmp_path / "out").scene
    assert len(collision_triangles(scene)[1]) == 12
    assert MeshLoader(scene_roots(scene), textures=False).shape(scene.visuals[0].shape).triangle_count == 24


def test_a_map_of_gibson_becomes_one_of_nav2(tmp_path: Path) -> None:
    write_gibson_folder(tmp_path / "Tiny")
    import_scene(tmp_path / "Tiny", tmp_path / "out")
    values = yaml.safe_load((tmp_path / "out" / "maps" / "floor_0.yaml").read_text())
    image = cv2.imread(str(tmp_path / "out" / "maps" / values["image"]), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    rows, columns = np.nonzero(image == 254)
    # Nav2: the last row is the lowest y.
    x = values["origin"][0] + (columns + 0.5) * values["resolution"]
    y = values["origin"][1] + (len(image) - rows - 0.5) * values["resolution"]
    np.testing.assert_allclose([x.min(), x.max(), y.min(), y.max()], [0, 3, 0, 2], atol=0.01)


def test_without_a_folder_nothing_is_copied(tmp_path: Path) -> None:
    folder = write_gibson_folder(tmp_path / "Tiny")
    before = {p.name for p in folder.iterdir()}
    assert import_scene(folder, None).file == folder / "scene.yaml"
    assert {p.name for p in folder.iterdir()} == before | {"scene.yaml"}
    with pytest.raises(SceneError, match="a Gibson Sim scene already"):
        import_scene(folder, None)


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    write_gibson_folder(tmp_path / "Tiny")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(SceneError, match="not empty"):
        import_scene(tmp_path / "Tiny", tmp_path / "out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["Tiny", "out"]


@pytest.mark.parametrize("text", ["ground\n", "0.0\nnan\n"])
def test_invalid_floor_heights_are_refused(tmp_path: Path, text: str) -> None:
    folder = write_gibson_folder(tmp_path / "Tiny")
    (folder / "floors.txt").write_text(text)
    with pytest.raises(SceneError, match=r"floors\.txt"):
        import_scene(folder, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_interactive_scene_of_igibson_is_refused_with_a_reason(tmp_path: Path) -> None:
    for name in ("layout", "urdf"):
        (tmp_path / "Rs_int" / name).mkdir(parents=True)
    with pytest.raises(SceneError, match="interactive iGibson scene"):
        import_scene(tmp_path / "Rs_int", tmp_path / "out")


# Replica


def test_a_replica_folder_falls_apart_into_its_objects(tmp_path: Path) -> None:
    scene = import_scene(write_replica_folder(tmp_path / "room_0"), tmp_path / "out").scene
    assert [(v.name, v.semantic_class) for v in scene.visuals] == [("wall_3", "wall"), ("night_stand_7", "night_stand")]
    loader = MeshLoader(scene_roots(scene))
    stand = loader.shape(scene.visuals[1].shape)
    np.testing.assert_allclose(stand.bounds, [[1.5, 0.5, 0.0], [2.5, 1.5, 1.0]], atol=1e-6)
    (part,) = stand.parts
    assert part.material.unlit
    np.testing.assert_allclose(part.colors, np.full((8, 3), (200, 150, 100)), atol=1)
    np.testing.assert_allclose(_bounds(scene), [[-3, -2, 0], [3, 2, 2.5]], atol=1e-6)


def test_a_replica_folder_may_stay_one_object(tmp_path: Path) -> None:
    scene = import_scene(write_replica_folder(tmp_path / "room_0"), tmp_path / "out", ImportOptions(semantics=False)).scene
    assert [v.semantic_class for v in scene.visuals] == [""]


def test_labels_that_are_no_list_are_refused(tmp_path: Path) -> None:
    folder = write_replica_folder(tmp_path / "room_0")
    (folder / "habitat" / "info_semantic.json").write_text('{"objects": [{"class_name": "wall"}]}')
    with pytest.raises(SceneError, match=r"info_semantic\.json"):
        import_scene(folder, tmp_path / "out")


# Habitat


def _habitat(folder: Path) -> Path:
    """Writes a textured-like mesh with z up, as Matterport's are, with labels beside it."""
    folder.mkdir()
    corners, quads = room()
    gltf = Gltf()
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    gltf.document["meshes"][0]["primitives"].append(
        {"attributes": {"POSITION": gltf.accessor(corners)}, "indices": gltf.accessor(triangles.ravel(), "<u2")}
    )
    (folder / "house.glb").write_bytes(gltf.glb())
    objects = [1] * 6 + [2] * 6
    (folder / "house_semantic.ply").write_bytes(ply(corners, quads.tolist(), None, objects=objects))
    return folder


@pytest.mark.parametrize("lists", ["house.scn", "house.house", "info_semantic.json"])
def test_labels_of_habitat_are_laid_on_the_mesh_and_its_up_axis_is_found(tmp_path: Path, lists: str) -> None:
    folder = _habitat(tmp_path / "house")
    texts = {
        "house.scn": json.dumps({"objects": [{"id": 1, "class_": "wall"}, {"id": 2, "class_": "chair"}]}),
        "house.house": "ASCII 1.1\nC 0 1 wall 1 wall 0 0\nC 1 2 dining#chair 3 chair 0 0\nO 1 0 0 0 0 0\nO 2 0 1 0 0 0\n",
        "info_semantic.json": json.dumps({"objects": [{"id": 1, "class_name": "wall"}, {"id": 2, "class_name": "chair"}]}),
    }
    (folder / lists).write_text(texts[lists])
    imported = import_scene(folder, tmp_path / "out")
    assert sorted(v.semantic_class for v in imported.scene.visuals) == ["chair", "wall"]
    np.testing.assert_allclose(_bounds(imported.scene), [[-3, -2, 0], [3, 2, 2.5]], atol=1e-6)
    assert any("z axis" in warning for warning in imported.warnings)


def test_colours_of_hm3d_identify_the_objects(tmp_path: Path) -> None:
    folder = tmp_path / "hm3d"
    folder.mkdir()
    floor, wall = [[0, 0, 0], [4, 0, 0], [4, 0, -4]], [[0, 0, 0], [4, 0, 0], [4, 3, 0]]
    plain, coloured = Gltf().triangle(floor).triangle(wall), Gltf().triangle(floor).triangle(wall)
    for primitive, color in zip(coloured.document["meshes"][0]["primitives"], ((1.0, 0, 0), (0, 1.0, 0)), strict=True):
        primitive["attributes"]["COLOR_0"] = coloured.accessor([color] * 3)
    (folder / "a.glb").write_bytes(plain.glb())
    (folder / "a.semantic.glb").write_bytes(coloured.glb())
    (folder / "a.semantic.txt").write_text('HM3D Semantic Annotations\n1,FF0000,"floor",0\n2,00FF00,"wall",0\n')
    scene = import_scene(folder / "a.glb", tmp_path / "out").scene
    assert sorted(v.name for v in scene.visuals) == ["floor_1", "wall_2"]


# Plain meshes


def test_a_mesh_on_its_side_is_turned_upright_and_that_is_reported(tmp_path: Path) -> None:
    corners, quads = room()
    write_obj(tmp_path / "scan.obj", turned(corners, 0, -90.0), quads)  # z up becomes y up
    imported = import_scene(tmp_path / "scan.obj", tmp_path / "out")
    low, high = _bounds(imported.scene)
    np.testing.assert_allclose(high - low, SIZE, atol=1e-5)
    assert any("y axis" in warning for warning in imported.warnings)


def test_a_scan_in_the_frame_of_its_camera_is_turned_over(tmp_path: Path) -> None:
    corners, quads = room()
    # Without its underside, as a scan has a box: x right, y down, z forward.
    (tmp_path / "scan.ply").write_bytes(ply(turned(corners, 0, 90.0), np.delete(quads, 6, axis=0).tolist(), None))
    imported = import_scene(tmp_path / "scan.ply", tmp_path / "out")
    assert any("-y is taken as up" in warning for warning in imported.warnings)
    vertices, triangles = collision_triangles(imported.scene)
    box = vertices[np.unique(triangles[12:])]
    assert np.ptp(vertices[:, 2]) == pytest.approx(2.5)
    assert box[:, 2].min() == pytest.approx(vertices[:, 2].min())


def test_axis_unit_and_name_can_be_given(tmp_path: Path) -> None:
    corners, quads = room()
    write_obj(tmp_path / "scan.obj", 100.0 * turned(corners, 0, -90.0), quads)
    assert (
        _run("import", tmp_path / "scan.obj", "--output", tmp_path / "out", "--up-axis", "y", "--unit", "cm", "--name", "flat")
        == 0
    )
    scene = load_scene(tmp_path / "out")
    assert scene.name == "flat"
    np.testing.assert_allclose(_bounds(scene), [[-3, -2, 0], [3, 2, 2.5]], atol=1e-5)


@pytest.mark.parametrize("name", ["cloud.las", "cloud.e57", "cloud.xyz", "cloud.pcd"])
def test_point_clouds_are_refused_and_the_tools_are_named(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"points")
    with pytest.raises(SceneError, match=r"point cloud.*MeshLab.*Open3D"):
        import_scene(tmp_path / name, tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "advice"), [("a.fbx", "Blender"), ("a.blend", "glTF"), ("a.ifc", "IfcConvert"), ("a.txt", "known:")]
)
def test_other_formats_are_refused_with_advice(tmp_path: Path, name: str, advice: str) -> None:
    (tmp_path / name).write_bytes(b"something")
    with pytest.raises(SceneError, match=advice):
        import_scene(tmp_path / name, tmp_path / "out")


def test_a_missing_path_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SceneNotFoundError):
        import_scene(tmp_path / "nowhere", tmp_path / "out")


def test_an_unknown_unit_names_the_known_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_gibson_folder(tmp_path / "Tiny")
    assert _run("import", tmp_path / "Tiny", "--unit", "furlong") == 1
    assert "--unit furlong: must be one of m, cm, mm, inch, foot, km" in capsys.readouterr().err
    assert issubclass(ConfigError, GibsonSimError)


# Worlds

SDF = """<sdf version='1.7'><world name='w'><model name='crate'><pose>1 2 0.5 0 0 0.3</pose><static>true</static><link name='l'>
<visual name='v'><geometry><box><size>1 1 1</size></box></geometry></visual>
<collision name='a'><pose>0 0 -0.25 0 0 0</pose><geometry><box><size>1 1 0.5</size></box></geometry></collision>
<collision name='b'><pose>0 0 0.25 0 0 0</pose><geometry><cylinder><radius>0.3</radius><length>0.5</length></cylinder></geometry></collision>
</link></model></world></sdf>"""


def test_collision_shapes_of_a_world_that_differ_from_its_visuals_are_kept(tmp_path: Path) -> None:
    (tmp_path / "w.world").write_text(SDF)
    source, imported = load_scene(tmp_path / "w.world"), import_scene(tmp_path / "w.world", tmp_path / "out").scene
    np.testing.assert_allclose(_bounds(imported), _bounds(source), atol=1e-5)
    assert len(collision_triangles(imported)[1]) == len(collision_triangles(source)[1])


@pytest.mark.parametrize("name", ["drake_living_room", "playcanvas_vr_gallery", "aws_small_house"])
def test_real_scenes_import_as_they_are(data_dir: Path, tmp_path: Path, name: str) -> None:
    folder = data_dir / name
    imported = import_scene(folder, tmp_path / "out")
    scene = imported.scene
    assert len(scene.visuals) == {"drake_living_room": 7, "playcanvas_vr_gallery": 1, "aws_small_house": 67}[name]
    low, high = {"drake_living_room": (-3.03, 3.02), "playcanvas_vr_gallery": (-5.06, 5.06), "aws_small_house": (-5.7, 5.7)}[name]
    assert _bounds(scene)[:, 1].tolist() == pytest.approx([low, high], abs=0.16)
    # What the source lacks is said of it, and once.
    missing = {"drake_living_room": ["wood_table_worn_nor_gl_1k.png"], "aws_small_house": ["aws_Carpet_01.png", "_PortraitA_01 "]}
    for what in missing.get(name, []):
        assert sum(what in warning for warning in imported.warnings) == 1
    assert {"scene.yaml", "assets"} <= {p.name for p in (tmp_path / "out").iterdir()}


# Scans


def _bumpy_room(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """A floor of 6 x 4 m whose height is off by up to 4 mm, (V, 3), and its squares (F, 4)."""
    y, x = np.meshgrid(np.linspace(-2, 2, cells + 1), np.linspace(-3, 3, cells + 1), indexing="ij")
    heights = np.random.default_rng(0).uniform(-0.004, 0.004, x.size)
    corner = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].ravel()
    return np.column_stack([x.ravel(), y.ravel(), heights]), np.column_stack(
        [corner, corner + 1, corner + cells + 2, corner + cells + 1]
    )


def test_a_scan_collides_in_its_simple_form_and_so_is_its_mended_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_obj(tmp_path / "scan.obj", *_bumpy_room(101))
    imported = import_scene(tmp_path / "scan.obj", tmp_path / "out")
    assert "collision: simplified" in imported.file.read_text()
    assert any(c.shape.kind == "box" for c in imported.scene.collisions)
    rooms = "rooms: [{name: hall, class: hall, polygon: [[-3, -2], [3, -2], [3, 2], [-3, 2]]}]\n"
    imported.file.write_text(imported.file.read_text() + rooms)
    file, report = fix_scene(check_path(imported.file), tmp_path / "mended", FixOptions(level=False))
    assert "collision: simplified" in file.read_text()
    assert report.scene is not None and [room.name for room in report.scene.rooms] == ["hall"]


def test_many_disconnected_objects_are_no_scan() -> None:
    corners, faces = _bumpy_room(101)
    loose = corners[faces].reshape(-1, 3)
    squares = np.arange(len(loose)).reshape(-1, 4)
    apart = loose + np.repeat(np.arange(len(squares)), 4)[:, None] * (0.0, 0.0, 0.1)
    normals = np.zeros_like(apart, dtype=np.float32)
    triangles = np.concatenate([squares[:, :3], squares[:, [0, 2, 3]]]).astype(np.uint32)
    meshes = (Mesh((MeshPart(v.astype(np.float32), normals, None, triangles, Material()),)) for v in (loose, apart))
    assert [is_scan(mesh) for mesh in meshes] == [True, False]


@pytest.mark.parametrize(
    ("cwd", "named"),
    [
        ("pläce of worlds", "worlds/a.world"),
        ("pläce of worlds/worlds", "a.world"),
        ("pläce of worlds/worlds", "./a.world"),
        ("pläce of worlds/models", "../worlds/a.world"),
        ("link/worlds", "a.world"),
        (".", "link/models/../worlds/a.world"),
    ],
)
def test_a_world_of_a_relative_path_finds_the_models_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cwd: str, named: str
) -> None:
    place = tmp_path / "pläce of worlds"
    (place / "worlds").mkdir(parents=True)
    (place / "models/room").mkdir(parents=True)
    corners, quads = room()
    write_obj(place / "models/room/room.obj", corners, quads)
    shape = "<geometry><mesh><uri>model://room/room.obj</uri></mesh></geometry>"
    link = f"<link name='l'><visual name='v'>{shape}</visual><collision name='c'>{shape}</collision></link>"
    (place / "models/room/model.sdf").write_text(f"<sdf version='1.6'><model name='room'><static>1</static>{link}</model></sdf>")
    (place / "models/room/model.config").write_text("<model><name>room</name><sdf>model.sdf</sdf></model>")
    include = "<include><uri>model://room</uri></include>"
    (place / "worlds/a.world").write_text(f"<sdf version='1.6'><world name='a'>{include}</world></sdf>")
    (tmp_path / "link").symlink_to(place)
    monkeypatch.chdir(tmp_path / cwd)
    imported = import_scene(Path(named), tmp_path / "out put")
    assert [v.name for v in imported.scene.visuals] == ["room"] and not imported.warnings
