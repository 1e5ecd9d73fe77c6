"""Problems of a scene are found, with numbers, and repaired where possible.

Pieces of floor that gaps in a scan separate are reported; those behind walls are not.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.scenes.scene_meshes import collision_triangles, scene_roots
from gibson_sim_tools.importing.checks.check import SceneReport, check_path, islands
from gibson_sim_tools.importing.checks.faults import find_faults
from gibson_sim_tools.importing.checks.fix import FixOptions, fix_scene
from gibson_sim_tools.importing.checks.gravity import guess_unit, guess_up, rotation_to_z, size_text
from support.interiors import SIZE, box_faces, room, triangles, turned, write_gibson_folder, write_obj
from support.surfaces import bumpy_grid


def _found(report: SceneReport) -> dict[str, str]:
    """Returns the level of each kind of finding, except open boundaries."""
    return {f.what: f.level for f in report.findings}


def _run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["scene", *map(str, words)])
    return int(ended.value.code or 0)


# Up and units


@pytest.mark.parametrize(("axis", "degrees"), [(0, 3.0), (1, -7.0), (0, 0.7)])
def test_tilt_of_a_floor_is_measured(axis: int, degrees: float) -> None:
    corners, quads = room()
    guess = guess_up(turned(corners, axis, degrees), triangles(quads))
    assert guess.axis == "z"
    assert guess.tilt_deg == pytest.approx(abs(degrees), abs=0.01)
    np.testing.assert_allclose(rotation_to_z(guess.up) @ guess.up, [0, 0, 1], atol=1e-12)


def test_noise_of_a_scan_hardly_changes_the_direction() -> None:
    part = bumpy_grid(100, half=3.0, height=0.0)
    walls, sides = room(furniture=False)
    # Edges of 6 cm and 1 cm of noise: the normals are off by 15 degrees.
    floor = part.vertices + 0.01 * np.random.default_rng(1).standard_normal(part.vertices.shape)
    vertices = np.concatenate([floor, walls])
    faces = np.concatenate([part.triangles.astype(np.int64), triangles(sides) + len(part.vertices)])
    assert guess_up(turned(vertices, 0, 4.0), faces).tilt_deg == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize(("axis", "degrees", "up"), [(0, -90.0, "y"), (1, 90.0, "x"), (0, 90.0, "y")])
def test_a_scene_on_its_side_is_detected(axis: int, degrees: float, up: str) -> None:
    corners, quads = room()
    guess = guess_up(turned(corners, axis, degrees), triangles(quads))
    assert guess.axis == up
    expected = turned(np.array([[0.0, 0.0, 1.0]]), axis, degrees)[0]
    np.testing.assert_allclose(guess.up, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("size", "unit"),
    [
        ((6, 4, 2.5), "m"),
        ((600, 400, 250), "cm"),
        ((6000, 4000, 2500), "mm"),
        ((236, 157, 98), "inch"),
        ((40, 30, 8), "m"),
        ((1e-3,) * 3, ""),
    ],
)
def test_units_are_guessed_by_the_size_of_rooms(size: tuple[float, float, float], unit: str) -> None:
    assert guess_unit(size) == unit


def test_an_implausible_building_size_is_reported_with_the_likely_unit() -> None:
    assert size_text((4.0, 2.4, 3.0)) == "4 x 2.4 x 3 m"
    assert size_text((4000.0, 3000.0, 2400.0)) == "4000 x 3000 x 2400 m; in mm it would be a room or a building"
    assert size_text((1e-9, 1e-9, 1e-9)).startswith("1e-09 x 1e-09 x 1e-09 m; it is not the size of a room in any of ")


# Faces


def test_a_room_with_a_box_in_it_has_no_faults() -> None:
    corners, quads = room()
    faults = find_faults(corners, triangles(quads))
    assert (faults.open_edges, faults.non_manifold_edges, faults.inconsistent_edges) == (0, 0, 0)
    assert not faults.inverted.any() and not faults.degenerate.any()


def test_a_missing_side_is_one_hole_of_its_length() -> None:
    corners, quads = box_faces((0, 0, 0), (1, 2, 3))
    faults = find_faults(corners, triangles(quads[1:]))
    assert faults.open_edges == 4
    assert faults.holes == pytest.approx((6.0,))


def test_turned_faces_are_found_however_they_are_written() -> None:
    corners, quads = box_faces((0, 0, 0), (1, 1, 1))
    faces = triangles(quads)
    faces[[2, 7]] = faces[[2, 7]][:, ::-1]
    # Every triangle with corners of its own, as in a file without shared vertices.
    loose = corners[faces].reshape(-1, 3)
    faults = find_faults(loose, np.arange(len(loose)).reshape(-1, 3))
    assert np.flatnonzero(faults.inverted).tolist() == [2, 7]
    assert faults.inconsistent_edges == 6


def test_an_inside_out_object_is_found_and_a_room_is_not() -> None:
    corners, quads = room()
    quads[6:] = quads[6:, ::-1]
    faults = find_faults(corners, triangles(quads))
    assert faults.inverted.sum() == 12
    assert faults.inverted[6:12].all() and faults.inverted[18:].all()


def test_triangles_without_area_and_edges_of_three_faces_are_counted() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [2, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5], [0, 0, 1]])
    faults = find_faults(corners, faces)
    assert np.flatnonzero(faults.degenerate).tolist() == [3, 4]
    assert faults.non_manifold_edges == 1


# Whole scenes


def _scene(folder: Path, corners: np.ndarray, quads: np.ndarray, more: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    write_obj(folder / "room.obj", corners, quads)
    (folder / "scene.yaml").write_text(f"name: test\n{more}objects: [{{name: room, mesh: room.obj}}]\n")
    return folder


def test_a_good_scene_has_no_findings_and_exit_code_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("check", _scene(tmp_path / "a", *room())) == 0
    assert capsys.readouterr().out == "test: clean\n"


def test_missing_files_of_an_unfinished_scene_are_notes_and_outdated_ones_warnings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rooms = "rooms: [{name: hall, class: hall, polygon: [[-3, -2], [3, -2], [3, 2], [-3, 2]]}]\n"
    folder = _scene(tmp_path / "a", *room(), rooms)
    assert _run("check", folder) == 0
    assert (
        "unfinished: a finished scene also has floor_trav_0.png, floors.txt, free_poses.csv, LICENSE" in capsys.readouterr().out
    )
    assert _run("map", folder, "--write") == 0
    assert _run("check", folder) == 0
    (folder / "floors.txt").write_text("1.5\n")
    capsys.readouterr()
    assert _run("check", folder) == 1
    assert "out-of-date: floors.txt: has floors at 1.5 m, the scene at 0 m" in capsys.readouterr().out


def test_errors_are_reported_with_a_remedy_and_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corners, quads = room()
    starts = "starts: [{name: bad, xy: [1.5, 1.0]}, {name: good, xy: [0.0, 0.0]}]\nfloor_z: 0.0\n"
    assert _run("check", _scene(tmp_path / "a", corners, quads, starts), "--json") == 1
    report = json.loads(capsys.readouterr().out)
    (finding,) = [f for f in report["findings"] if f["what"] == "start-blocked"]
    assert "'bad' at 1.50, 1.00 is not free" in finding["text"] and "nearest free position" in finding["text"]
    assert report["scene"]["size"] == pytest.approx(list(SIZE))


def test_a_missing_floor_is_reported(tmp_path: Path) -> None:
    assert _found(check_path(_scene(tmp_path / "a", *room(), "floor_z: 1.4\n")))["no-floor"] == "warning"


def test_a_floor_that_faces_down_is_reported(tmp_path: Path) -> None:
    corners, quads = room(furniture=False)
    assert "floor-faces-down" in _found(check_path(_scene(tmp_path / "a", corners, quads[:, ::-1], "floor_z: 0.0\n")))


def test_an_unreadable_scene_is_one_error(tmp_path: Path) -> None:
    corners, quads = room()
    folder = _scene(tmp_path / "a", corners, quads)
    (folder / "room.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (finding,) = check_path(folder).findings
    assert finding.level == "error" and "must be finite" in finding.text


def test_a_missing_texture_is_a_warning(tmp_path: Path) -> None:
    folder = _scene(tmp_path / "a", *room())
    write_obj(folder / "room.obj", *room(), "gone.png")
    assert _found(check_path(folder))["missing-texture"] == "warning"


def test_a_tilted_scan_in_centimetres_with_turned_faces_is_mended(tmp_path: Path) -> None:
    corners, quads = room()
    quads[8] = quads[8, ::-1]
    report = check_path(_scene(tmp_path / "a", 100.0 * turned(corners, 0, 5.0), quads))
    assert {"not-level", "not-metres", "inverted"} <= set(_found(report))
    file, mended = fix_scene(report, tmp_path / "b", FixOptions(unit_m=0.01))
    assert mended.clean, mended.findings
    assert mended.facts is not None and mended.facts.size == pytest.approx(SIZE, abs=1e-3)
    assert mended.scene is not None
    assert len(collision_triangles(mended.scene)[1]) == 24
    assert file == tmp_path / "b" / "scene.yaml"


def test_holes_count_in_a_scan_and_not_in_furniture(tmp_path: Path) -> None:
    part = bumpy_grid(105, half=3.0, height=0.01)
    corners, quads = room(furniture=False)
    walls = corners * (1.0, 1.5, 1.0), triangles(quads[1:])
    scan = np.concatenate([part.vertices, walls[0]]), np.concatenate([part.triangles.astype(int), walls[1] + len(part.vertices)])
    loose = scan[0][scan[1]].reshape(-1, 3) * (1.0 + 1e-3 * np.random.default_rng(1).random((3 * len(scan[1]), 1)))
    for name, (points, faces), level in (("a", scan, "warning"), ("b", (loose, np.arange(len(loose)).reshape(-1, 3)), "note")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scan.stl").write_bytes(_stl(points[faces]))
        assert _found(check_path(tmp_path / name)).get("holes", "note") == level


def test_instances_of_a_mesh_count_as_the_copies_that_a_repair_makes_of_them(tmp_path: Path) -> None:
    corners, quads = box_faces((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))
    write_obj(tmp_path / "bin.obj", corners, quads[[0, 2, 3, 4, 5]])  # open at the top: a rim of 4 m
    folder = _scene(tmp_path, *room(furniture=False))
    placed = "".join(f"  - {{name: bin{k}, mesh: bin.obj, pose: {{xyz: [{k}, 0, 0]}}}}\n" for k in (-2, 0, 2))
    (folder / "scene.yaml").write_text(f"name: test\nobjects:\n  - {{name: room, mesh: room.obj}}\n{placed}")
    report = check_path(folder)
    assert report.amounts["holes"] == pytest.approx(12.0)
    assert len([f for f in report.findings if f.what == "holes"]) == 1
    _, mended = fix_scene(report, tmp_path / "b", FixOptions())
    assert mended.amounts["holes"] == pytest.approx(12.0)


def test_holes_in_a_robots_views_are_reported_before_it_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    corners, quads = room(furniture=False)
    assert "view-holes" not in _found(check_path(_scene(tmp_path / "a", corners, quads)))
    report = check_path(_scene(tmp_path / "b", corners, quads[:-1]))
    (found,) = [f for f in report.findings if f.what == "view-holes"]
    assert found.level == "note" and 0.02 < found.amount < 0.2 and "% of a robot's view is holes" in found.text
    assert report.json()["free_floor_m2"] == pytest.approx(5.5 * 3.5, rel=0.1)
    monkeypatch.setattr("gibson_sim_tools.importing.checks.check.MIN_SCAN_TRIANGLES", 10)
    assert _found(check_path(tmp_path / "b"))["view-holes"] == "warning"


def _stl(corners: np.ndarray) -> bytes:
    facets = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    facets["c"] = corners
    return bytes(80) + len(corners).to_bytes(4, "little") + facets.tobytes()


def test_formats_that_must_be_imported_first_are_reported_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_gibson_folder(tmp_path / "Tiny")
    assert _run("check", tmp_path / "Tiny") == 1
    assert "is a Gibson folder; import it first" in capsys.readouterr().err


def test_a_huge_texture_is_reported_before_it_is_decoded_and_scaled_down(tmp_path: Path) -> None:
    folder = _scene(tmp_path / "a", *room())
    write_obj(folder / "room.obj", *room(), "atlas.png")
    picture = np.zeros((64, 9000, 3), dtype=np.uint8)
    picture[:, 4500:] = (0, 0, 255)
    cv2.imwrite(str(folder / "atlas.png"), picture)
    report = check_path(folder)
    assert _found(report)["huge-texture"] == "warning"
    _, mended = fix_scene(report, tmp_path / "b", FixOptions(max_texture=512))
    assert mended.clean and mended.scene is not None
    (part,) = MeshLoader(scene_roots(mended.scene)).shape(mended.scene.visuals[0].shape).parts
    assert part.material.texture is not None and part.material.texture.pixels.shape == (4, 512, 3)
    left, right = part.material.texture.pixels[2, [40, 480]].astype(int)
    assert left.max() < 30 and right[0] > 220


def test_a_copy_that_is_mended_needs_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("check", _scene(tmp_path / "a", *room()), "--fix") == 1
    assert "--output" in capsys.readouterr().err


def test_inspect_prints_sizes_and_floors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("inspect", _scene(tmp_path / "a", *room())) == 0
    text = capsys.readouterr().out
    assert "6.00 x 4.00 x 2.50 m" in text and "24 visual" in text and "floors  0.00 m" in text


@pytest.mark.parametrize("name", ["playcanvas_vr_gallery"])
def test_a_real_scene_is_checked(data_dir: Path, name: str) -> None:
    report = check_path(data_dir / name)
    assert report.facts is not None
    assert report.facts.triangles == 1930 and report.facts.unit == "m" and report.facts.tilt_deg < 0.1
    assert report.facts.size == pytest.approx((10.12, 10.12, 5.05), abs=0.02)
    assert [(t.width, t.height) for t in report.facts.textures] == [(1024, 1024)]


def test_a_scene_without_anything_to_repair_is_not_copied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = _scene(tmp_path / "a", *room())
    assert _run("check", folder, "--fix", "--output", tmp_path / "b") == 0
    assert capsys.readouterr().out.endswith("nothing to repair; no copy made\n")
    assert not (tmp_path / "b").exists()
    assert _run("check", folder, "--fix", "--up=z", "--output", tmp_path / "b") == 0
    assert (tmp_path / "b/scene.yaml").is_file()


@pytest.mark.parametrize(("tilted", "kept"), [(False, {"maps", "free_poses.csv", "LICENSE"}), (True, {"LICENSE"})])
def test_a_copy_keeps_the_files_that_are_still_valid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tilted: bool, kept: set[str]
) -> None:
    corners, quads = room()
    # The floor upside down: one of a few triangles that --fix flips.
    flipped = np.concatenate([quads[:-1], quads[-1:, ::-1]])
    folder = _scene(tmp_path / "a", turned(corners, 0, 5.0) if tilted else corners, flipped)
    assert _run("map", folder, "--write") == 0
    (folder / "maps").mkdir(exist_ok=True)
    (folder / "maps/floor_0.yaml").write_text("image: floor_0.pgm\n")
    (folder / "LICENSE").write_text("CC0\n")
    capsys.readouterr()
    _run("check", folder, "--fix", "--output", tmp_path / "b")
    out = capsys.readouterr().out
    names = {"maps", "free_poses.csv", "LICENSE"}
    assert {name for name in names if (tmp_path / "b" / name).exists()} == kept
    assert ("the copy has another frame, so these are left out: maps, " in out) == tilted
    assert (f"`gibson-sim scene map {tmp_path}/b --write` makes maps and free poses anew" in out) == tilted


def _map(floor: np.ndarray, occupied: np.ndarray) -> FloorMap:
    return FloorMap(0.1, (0.0, 0.0), occupied, floor & ~occupied)


def _blank() -> tuple[np.ndarray, np.ndarray]:
    """Returns a floor of 6 x 3 m with walls about it."""
    floor, occupied = np.ones((32, 62), dtype=bool), np.zeros((32, 62), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return floor, occupied


def test_a_strip_that_was_not_scanned_makes_islands() -> None:
    floor, occupied = _blank()
    floor[:, 40:44] = False
    large, small = islands(_map(floor, occupied), 0.2)
    assert large == pytest.approx(3.4 * 2.5, rel=0.15) and small == pytest.approx(1.2 * 2.5, rel=0.25)


def test_a_wall_makes_no_islands() -> None:
    floor, occupied = _blank()
    occupied[:, 40:42] = True
    assert islands(_map(floor, occupied), 0.2) == ()


def test_gaps_wider_than_a_metre_and_tiny_regions_make_no_islands() -> None:
    floor, occupied = _blank()
    wide, tiny = floor.copy(), floor.copy()
    wide[:, 25:50] = False
    assert islands(_map(wide, occupied), 0.2) == ()
    tiny[:, 40:56] = False
    assert islands(_map(tiny, occupied), 0.2) == ()


def test_a_floor_without_free_space_has_no_islands() -> None:
    floor, occupied = _blank()
    assert islands(_map(~floor, occupied), 0.2) == ()
