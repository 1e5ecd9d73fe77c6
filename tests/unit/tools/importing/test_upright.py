"""Up is found in any orientation, or reported as unclear; upright scenes stay; no repair makes a scene worse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.patches import flat_patches
from gibson_sim.geometry.upright import find_candidates
from gibson_sim_tools.importing.checks.check import SceneFinding, SceneReport, check_path
from gibson_sim_tools.importing.checks.facts import SceneFacts
from gibson_sim_tools.importing.checks.fix import FixOptions, fix_scene, regressions
from gibson_sim_tools.importing.checks.gravity import UpGuess, direction, direction_text, guess_up, refine_up, rotation_to_z
from gibson_sim_tools.importing.document import rpy_deg
from gibson_sim_tools.importing.importers import ImportOptions, import_scene
from support.interiors import box_faces, room, triangles, turned, write_obj
from support.plys import ply
from support.scans import hall, noisy_room
from support.turning import random_rotation, verdict

NOISY = noisy_room(edge=0.1)


def _run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["scene", *map(str, words)])
    return int(ended.value.code or 0)


def _soup(vertices: np.ndarray, faces: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Returns a speck at the middle of each triangle, 1 cm wide, that faces anywhere."""
    rng = np.random.default_rng(seed)
    middles = vertices[faces].mean(axis=1)
    specks = middles[:, None] + 0.01 * rng.standard_normal((len(faces), 3, 3))
    return specks.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def _levels(*heights: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns a room of 6 x 4 m whose floor rises in stages from side to side."""
    corners, quads = room(furniture=False)
    quads = quads[1:]
    width = 6.0 / len(heights)
    for k, height in enumerate(heights):
        low, high = (-3.0 + k * width, -2.0, height - 0.2), (-3.0 + (k + 1) * width, 2.0, height)
        more, sides = box_faces(low, high)
        quads = np.concatenate([quads, sides + len(corners)])
        corners = np.concatenate([corners, more])
    return corners, quads


# Which way is up


def test_a_furnished_room_is_turned_upright_from_any_side_or_reported_as_ambiguous() -> None:
    found = [verdict(*NOISY, random_rotation(seed), 0.3) for seed in range(12)]
    assert "wrong" not in found and found.count("upright") >= 9, found


def test_a_room_37_degrees_off_every_axis_is_not_laid_on_a_wall() -> None:
    up = np.array([1.0, 1.0, 1.0]) / np.sqrt(3.0)  # 54.7 degrees off each axis, the farthest there is
    x = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    rotation = np.stack([x, np.cross(up, x), up], axis=1)
    guess = guess_up(NOISY[0] @ rotation.T, NOISY[1])
    assert guess.sure
    np.testing.assert_allclose(guess.up, up, atol=0.005)


@pytest.mark.parametrize("shape", ["cube", "empty room"])
def test_up_of_an_empty_room_is_uncertain_unless_it_is_already_upright(shape: str) -> None:
    corners, quads = box_faces((0, 0, 0), (3, 3, 3), inward=True) if shape == "cube" else room(furniture=False)
    for seed in range(4):
        assert not guess_up(corners @ random_rotation(seed).T, triangles(quads)).sure
    kept = guess_up(corners, triangles(quads))
    assert kept.sure and kept.tilt_deg < 0.01


def test_an_ambiguous_up_axis_is_reported_with_the_candidate_directions() -> None:
    corners, quads = room(furniture=False)
    rotation = random_rotation(3)
    guess = guess_up(corners @ rotation.T, triangles(quads))
    assert 2 <= len(guess.others) <= 3 and guess.up == (0.0, 0.0, 1.0)
    assert max(abs(float(np.asarray(up) @ rotation[:, 2])) for up in guess.others) > 0.999


@pytest.mark.parametrize("seed", range(4))
def test_specks_that_face_anywhere_are_no_worse_than_not_sure(seed: int) -> None:
    assert verdict(*_soup(*NOISY), random_rotation(seed)) != "wrong"


@pytest.mark.parametrize("seed", range(4))
def test_a_floor_with_holes_is_no_worse_than_not_sure(seed: int) -> None:
    vertices, faces = NOISY
    middle = vertices[faces].mean(axis=1)
    lost = (middle[:, 2] < 0.1) & (np.sin(2.5 * middle[:, 0]) + np.sin(3.1 * middle[:, 1]) > -0.2)
    assert verdict(vertices, faces[~lost], random_rotation(seed)) != "wrong"
    assert verdict(vertices, faces[~lost], np.eye(3)) == "upright"


def test_a_mesh_without_area_or_without_anything_flat_stays_as_it_is() -> None:
    rng = np.random.default_rng(0)
    assert guess_up(np.zeros((3, 3)), np.array([[0, 1, 2]])).tilt_deg == 0.0
    assert guess_up(np.zeros((0, 3)), np.zeros((0, 3), dtype=int)).sure
    cloud = rng.normal(size=(3000, 3))
    guess = guess_up(cloud, np.arange(3000).reshape(-1, 3))
    assert guess.up == (0.0, 0.0, 1.0)


# Out of level


def test_floors_at_three_heights_are_level_each_for_itself() -> None:
    corners, quads = _levels(0.0, 0.09, 0.18)
    assert guess_up(corners, triangles(quads)).tilt_deg < 0.02
    assert guess_up(turned(corners, 1, 1.0), triangles(quads)).tilt_deg == pytest.approx(1.0, abs=0.02)


def test_a_level_room_with_floors_at_three_heights_is_mended_level(tmp_path: Path) -> None:
    corners, quads = _levels(0.0, 0.09, 0.18)
    quads[2] = quads[2][::-1]  # something to mend
    folder = tmp_path / "a"
    folder.mkdir()
    write_obj(folder / "room.obj", corners, quads)
    (folder / "scene.yaml").write_text("name: stages\nobjects: [{name: room, mesh: room.obj}]\n")
    _, mended = fix_scene(check_path(folder), tmp_path / "b", FixOptions())
    assert mended.facts is not None and mended.facts.tilt_deg < 0.02
    assert not {"no-room", "no-floor", "not-level"} & {f.what for f in mended.findings}


def test_a_repair_that_makes_a_scene_worse_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    corners, quads = room()
    folder = tmp_path / "a"
    folder.mkdir()
    write_obj(folder / "room.obj", turned(corners, 0, 5.0), quads)
    (folder / "scene.yaml").write_text("name: bent\nobjects: [{name: room, mesh: room.obj}]\n")
    report = check_path(folder)
    up = np.array([0.0, np.sin(np.radians(30)), np.cos(np.radians(30))])
    monkeypatch.setattr("gibson_sim_tools.importing.checks.fix.refine_up", lambda *_: tuple(up))
    with pytest.raises(SceneError, match="nothing was written: a repaired copy of 'bent' would be worse than it is"):
        fix_scene(report, tmp_path / "b", FixOptions(up=(0.0, 0.0, 1.0)))
    assert not (tmp_path / "b").exists()


def test_only_findings_that_could_be_measured_before_are_regressions(tmp_path: Path) -> None:
    corners, quads = room()
    write_obj(tmp_path / "up.obj", corners, quads)
    write_obj(tmp_path / "side.obj", turned(corners, 0, -90.0), quads)
    up, side = check_path(tmp_path / "up.obj"), check_path(tmp_path / "side.obj")
    bad = SceneReport((SceneFinding("no-room", "warning", "nothing is free"),), up.facts)
    assert regressions(up, bad) == ["nothing is free"]
    assert regressions(side, bad) == []
    assert regressions(bad, up) == []


# By hand


@pytest.mark.parametrize(
    ("text", "expected"),
    [("z", (0, 0, 1)), ("-y", (0, -1, 0)), ("+X", (1, 0, 0)), ("0,3,4", (0, 0.6, 0.8)), ("-1,0,0", (-1, 0, 0))],
)
def test_directions_are_axes_or_three_numbers(text: str, expected: tuple[float, ...]) -> None:
    assert direction(text) == pytest.approx(expected)


@pytest.mark.parametrize("text", ["", "w", "0,0,0", "1,2", "nan,0,1", "1,2,3,4", "inf,0,0"])
def test_invalid_directions_are_refused_with_a_reason(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--up is .*must be an axis, x, y, z, -x, -y, -z, or a direction"):
        direction(text)


def test_a_direction_is_written_as_it_is_read() -> None:
    assert direction_text((0.0, -1.0, 0.0)) == "-y"
    assert direction(direction_text((0.48, 0.6, 0.64))) == pytest.approx((0.48, 0.6, 0.64), abs=1e-3)


def test_a_given_direction_is_refined_by_level_surfaces_near_it() -> None:
    corners, quads = room()
    assert refine_up(turned(corners, 0, 5.0), triangles(quads), (0, 0, 1)) == pytest.approx(
        tuple(turned(np.array([[0.0, 0.0, 1.0]]), 0, 5.0)[0]), abs=1e-6
    )
    assert refine_up(turned(corners, 0, 40.0), triangles(quads), (0, 0, 1)) == pytest.approx((0, 0, 1))


def test_a_scene_whose_up_is_not_clear_is_turned_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corners, quads = room(furniture=False)
    rotation = random_rotation(5)
    write_obj(tmp_path / "box.obj", corners @ rotation.T, quads)
    assert _run("check", tmp_path / "box.obj", "--fix", "--output", tmp_path / "a") == 1
    out = capsys.readouterr().out
    assert "up-unclear: which way is up is not clear: it may be " in out and "--fix --up=" in out
    assert "the up direction is not clear, so the scene is not rotated: " in out and "repaired: " not in out
    up = ",".join(f"{c:.3f}" for c in rotation[:, 2])
    assert _run("check", tmp_path / "box.obj", "--fix", "--up", up, "--output", tmp_path / "b") == 0
    facts = check_path(tmp_path / "b").facts
    assert facts is not None and facts.tilt_deg < 0.01 and facts.size[2] == pytest.approx(2.5, abs=1e-3)


def test_starts_are_turned_with_the_scene(tmp_path: Path) -> None:
    corners, quads = room()
    write_obj(tmp_path / "room.obj", turned(corners, 0, 4.0), quads)
    x, y, z = turned(np.array([[-1.0, -1.0, 0.0]]), 0, 4.0)[0]
    (tmp_path / "scene.yaml").write_text(
        f"name: t\nstarts: [{{name: door, xyz: [{x}, {y}, {z}]}}]\nobjects: [{{name: room, mesh: room.obj}}]\n"
    )
    _, mended = fix_scene(check_path(tmp_path), tmp_path / "b", FixOptions())
    assert mended.scene is not None
    (start,) = mended.scene.starts
    assert start.pose.position == pytest.approx((-1.0, -1.0, 0.0), abs=0.01)


# Imports


def _scan_file(path: Path, rotation: np.ndarray) -> Path:
    vertices, faces = NOISY
    path.write_bytes(ply(vertices @ rotation.T, faces.tolist(), np.full((len(vertices), 3), 128)))
    return path


def test_a_scan_that_lies_along_no_axis_is_imported_upright(tmp_path: Path) -> None:
    rotation = random_rotation(7)
    imported = import_scene(_scan_file(tmp_path / "scan.ply", rotation), tmp_path / "out")
    assert any("is not perpendicular to any axis of the file" in w for w in imported.warnings), imported.warnings
    facts = check_path(tmp_path / "out").facts
    assert facts is not None and facts.upright and facts.tilt_deg < 0.5
    assert facts.size[2] == pytest.approx(2.4, abs=0.1)


@pytest.mark.parametrize("said", ["-y", "vector"])
def test_up_of_an_imported_mesh_is_what_the_user_says(tmp_path: Path, said: str) -> None:
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if said == "-y" else random_rotation(7)
    write_obj(tmp_path / "box.obj", room(furniture=False)[0] @ rotation.T, room(furniture=False)[1])
    up = "-y" if said == "-y" else ",".join(f"{c:.6f}" for c in rotation[:, 2])
    assert _run("import", tmp_path / "box.obj", "--up-axis", up, "--output", tmp_path / "out") == 0
    facts = check_path(tmp_path / "out").facts
    assert facts is not None and facts.size[2] == pytest.approx(2.5, abs=1e-3) and facts.floors == pytest.approx((0.0,), abs=1e-3)


def test_an_import_with_an_ambiguous_up_axis_is_reported(tmp_path: Path) -> None:
    write_obj(tmp_path / "box.obj", room(furniture=False)[0] @ random_rotation(5).T, room(furniture=False)[1])
    (warning, *_) = import_scene(tmp_path / "box.obj", tmp_path / "out").warnings
    assert "which way is up is not clear" in warning and "--up-axis=" in warning
    assert ImportOptions().up is None


# What was levelled before


def _laid_on_a_wall(folder: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """Writes a scene of a mesh whose z is up, and the pose of a levelling that took one of its walls, 30 degrees off x, for the floor."""
    heading = turned(np.eye(3), 2, 30.0).T
    folder.mkdir()
    data = ply(vertices @ heading.T, faces.tolist(), np.full((len(vertices), 3), 128))
    folder.joinpath("scan.ply").write_bytes(data)
    pose = f"{{rpy_deg: {rpy_deg(rotation_to_z(heading @ np.array([1.0, 0.0, 0.0])))}}}"
    folder.joinpath("scene.yaml").write_text(f"name: t\nobjects: [{{name: scan, mesh: scan.ply, up_axis: z, pose: {pose}}}]\n")
    return folder


def test_a_levelling_that_laid_a_scan_on_a_wall_is_reverted(tmp_path: Path) -> None:
    vertices, faces = NOISY
    report = check_path(_laid_on_a_wall(tmp_path / "a", vertices, faces))
    assert report.facts is not None and report.facts.tilt_deg == pytest.approx(90.0, abs=0.5)
    _, mended = fix_scene(report, tmp_path / "b", FixOptions())
    assert mended.facts is not None and mended.facts.tilt_deg < 0.5
    assert mended.facts.size[2] == pytest.approx(2.4, abs=0.1)


def test_an_empty_room_that_a_levelling_laid_on_a_wall_is_stood_up_as_its_file_has_it(tmp_path: Path) -> None:
    corners, quads = room(furniture=False)
    _, mended = fix_scene(check_path(_laid_on_a_wall(tmp_path / "a", corners, triangles(quads))), tmp_path / "b", FixOptions())
    assert mended.facts is not None and mended.facts.size[2] == pytest.approx(2.5, abs=0.01)


def test_islands_that_a_sloping_floor_hid_do_not_keep_it_from_being_levelled() -> None:
    facts = check_facts(tilt_deg=1.2)
    before = SceneReport((SceneFinding("not-level", "warning", "the floor is 1.20 degrees out of level"),), facts)
    fresh = SceneFinding("islands", "warning", "the free floor at z = 0.00 m is in 3 pieces")
    assert regressions(before, SceneReport((fresh,), check_facts(tilt_deg=0.1))) == []
    assert regressions(SceneReport((), facts), SceneReport((fresh,), check_facts(tilt_deg=0.1))) == [fresh.text]
    blocked = SceneFinding("no-room", "warning", "no place is free")
    assert regressions(before, SceneReport((blocked,), check_facts(tilt_deg=0.1))) == [blocked.text]
    steep = SceneReport(before.findings, check_facts(tilt_deg=12.0))
    assert regressions(steep, SceneReport((blocked,), check_facts(tilt_deg=0.1))) == []


@pytest.mark.parametrize(
    ("before", "after", "worse"),
    [
        ({"inverted": 6.0}, {"inverted": 7.0}, ["inverted triangles: 7, 6 before"]),
        ({"holes": 10.0}, {"holes": 10.3}, []),
        ({"holes": 10.0}, {"holes": 10.5}, ["open boundaries: 10.5 m, 10.0 m before"]),
        ({}, {"view-holes": 0.02}, ["holes in the views of a robot: 2.0 %, 0.0 % before"]),
        ({"view-holes": 0.1}, {"view-holes": 0.05}, []),
    ],
)
def test_every_amount_of_a_check_counts_beyond_its_noise(
    before: dict[str, float], after: dict[str, float], worse: list[str]
) -> None:
    def report(amounts: dict[str, float]) -> SceneReport:
        return SceneReport(tuple(SceneFinding(k, "note", k, amount=v) for k, v in amounts.items()), check_facts(tilt_deg=0.1))

    assert regressions(report(before), report(after)) == worse


def test_less_free_floor_and_a_larger_tilt_are_worse_even_where_neither_is_a_fault() -> None:
    def report(tilt_deg: float, free: float) -> SceneReport:
        return SceneReport((), check_facts(tilt_deg), free_floor=free)

    assert regressions(report(0.1, 20.0), report(0.15, 18.8)) == []
    assert regressions(report(0.1, 20.0), report(0.1, 18.0)) == ["floor that is free for a robot: 18.0 m^2, 20.0 m^2 before"]
    assert regressions(report(0.1, 20.0), report(0.4, 20.0)) == ["the floor is 0.40 degrees out of level, 0.10 before"]
    assert regressions(report(12.0, 20.0), report(0.1, 10.0)) == []  # the map of a steep floor says nothing


def test_a_level_hall_with_raised_seating_is_not_turned_by_a_repair(tmp_path: Path) -> None:
    vertices, faces = hall((8.0, 6.0, 3.0), rise=0.05, depth=1.5, start=1.0, noise=0.005, edge=0.25)
    (tmp_path / "hall.ply").write_bytes(ply(vertices, faces.tolist(), None))
    report = check_path(tmp_path / "hall.ply")
    assert report.facts is not None and report.facts.tilt_deg < 0.02 and "not-level" not in report.amounts
    _, mended = fix_scene(report, tmp_path / "b", FixOptions())
    assert mended.geometry is not None
    np.testing.assert_allclose(mended.geometry.vertices.min(axis=0), vertices.min(axis=0), atol=1e-5)


def check_facts(tilt_deg: float) -> SceneFacts:
    """Returns the facts of an empty scene in metres that is so much out of level."""
    up = (0.0, float(np.sin(np.radians(tilt_deg))), float(np.cos(np.radians(tilt_deg))))
    return SceneFacts(
        "t", (0, 0, 0), (4, 4, 2.5), 1, 12, 12, 1, False, (), "z", up, tilt_deg, "m", (0.0,), {}, 0, (), ()
    )  # fmt: skip


def test_floors_ground_and_rooms_are_turned_with_the_scene(tmp_path: Path) -> None:
    corners, quads = room()
    write_obj(tmp_path / "room.obj", turned(corners + np.array([0.0, 0.0, 1.0]), 0, 4.0), quads)
    square = np.array([[-2.0, -1.5, 1.0], [2.0, -1.5, 1.0], [2.0, 1.5, 1.0], [-2.0, 1.5, 1.0]])
    outline = turned(square, 0, 4.0)
    z = float(outline[:, 2].mean())
    polygon = [[round(float(x), 4), round(float(y), 4)] for x, y, _ in outline]
    (tmp_path / "scene.yaml").write_text(
        f"name: t\nfloor_z: {z}\nground_z: {z}\nrooms: [{{name: hall, class: corridor, floor: 0, polygon: {polygon}}}]\n"
        "objects: [{name: room, mesh: room.obj}]\n"
    )
    _, mended = fix_scene(check_path(tmp_path), tmp_path / "b", FixOptions())
    assert mended.scene is not None
    assert mended.scene.floors == pytest.approx((1.0,), abs=0.01) and mended.scene.ground_z == pytest.approx(1.0, abs=0.01)
    (hall,) = mended.scene.rooms
    np.testing.assert_allclose(hall.polygon, square[:, :2], atol=0.12)


def _wall_with_cupboards() -> tuple[np.ndarray, np.ndarray]:
    """Returns a wall of 9 x 3 m that faces +y, and cupboards on it, as a scan has them that saw no floor."""
    corners, quads = np.array([[-4.5, 0.0, 0.0], [4.5, 0.0, 0.0], [4.5, 0.0, 3.0], [-4.5, 0.0, 3.0]]), np.array([[0, 3, 2, 1]])
    for k in range(8):
        low = np.array([-4.2 + 1.1 * k, 0.0, 0.2 + 0.9 * (k % 3)])
        more, sides = box_faces(tuple(low), tuple(np.add(low, (0.8, 2.0 if k == 3 else 0.4 + 0.1 * (k % 4), 0.7))))
        # No backs.
        quads = np.concatenate([quads, sides[~np.isclose(more[sides][:, :, 1], 0.0).all(axis=1)] + len(corners)])
        corners = np.concatenate([corners, more])
    return corners, triangles(quads)


def test_a_wall_with_cupboards_is_not_taken_for_a_floor_with_furniture() -> None:
    corners, faces = _wall_with_cupboards()
    for seed in range(8):
        rotation = random_rotation(seed)
        guess = guess_up(corners @ rotation.T, faces)
        if float(rotation[2, 1]) < np.cos(np.radians(15.0)):  # nearly level walls pass for floors: scans are held nearly upright
            assert not guess.sure or float(np.asarray(guess.up) @ rotation[:, 2]) > 0.99


def test_cues_for_up_hardly_depend_on_the_rotation_of_the_mesh() -> None:
    cues = []
    for seed in range(6):
        rotation = random_rotation(seed)
        patches = flat_patches(NOISY[0] @ rotation.T, NOISY[1], np.random.default_rng(0))
        assert patches is not None
        cues.append(next(c.cues[2:] for c in find_candidates(patches) if float(np.asarray(c.up) @ rotation[:, 2]) > 0.99))
    assert np.ptp(np.array(cues), axis=0).max() < 0.08, np.round(cues, 2)


def test_the_floor_of_a_levelled_scene_is_recomputed(tmp_path: Path) -> None:
    corners, quads = room()
    write_obj(tmp_path / "room.obj", turned(corners + np.array([2.0, 1.0, 0.0]), 1, 12.0), quads)
    report = check_path(tmp_path / "room.obj")
    assert report.scene is not None and report.scene.floor_estimated
    _, mended = fix_scene(report, tmp_path / "b", FixOptions(up=tuple(turned(np.array([[0.0, 0.0, 1.0]]), 1, 12.0)[0])))
    assert mended.scene is not None
    assert mended.scene.floors == pytest.approx((0.0,), abs=0.01)
    assert "no-room" not in {f.what for f in mended.findings}


SIDES = [np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.diag([1, -1, -1])]


@pytest.mark.parametrize("side", range(3))
def test_a_scan_that_stands_on_a_wall_or_its_ceiling_does_not_pass_for_upright(side: int) -> None:
    vertices, faces = NOISY
    middle = vertices[faces].mean(axis=1)
    inside = (middle[:, :2] > 0.2).all(axis=1) & (middle[:, 0] < 3.0) & (middle[:, 1] < 4.8)
    empty = faces[~(inside & (middle[:, 2] > 0.1) & (middle[:, 2] < 2.2))]
    open_above = faces[middle[:, 2] < 2.2]
    either_way = np.where(np.random.default_rng(0).random(len(open_above))[:, None] < 0.5, open_above, open_above[:, ::-1])
    kept = either_way if side == 2 else empty
    for rotation in (SIDES[side], SIDES[side].T):
        assert verdict(vertices, kept, rotation.astype(np.float64)) == "not sure"
    assert verdict(vertices, kept, np.eye(3)) == "upright"


def test_ambiguous_scenes_stay_so_until_the_up_direction_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    corners, quads = room()
    write_obj(tmp_path / "room.obj", corners, quads)
    unsure = UpGuess((0.0, 0.0, 1.0), False, ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)))
    with monkeypatch.context() as patch:
        patch.setattr("gibson_sim_tools.importing.importers.guess_up", lambda *_, **__: unsure)
        assert _run("import", tmp_path / "room.obj", "--output", tmp_path / "in") == 0
    assert _run("check", tmp_path / "in") == 1
    assert _run("check", tmp_path / "in", "--fix", "--output", tmp_path / "a") == 1
    assert "up-unclear: room.obj: which way is up is not clear: it may be -z; z of the file" in capsys.readouterr().out
    assert _run("check", tmp_path / "a", "--fix", "--up=z", "--output", tmp_path / "b") == 0
    assert _run("check", tmp_path / "b") == 0


@pytest.mark.parametrize(("share", "slope_deg"), [(0.3, 1.5), (0.5, 1.5), (0.5, 2.5), (0.5, 4.0)])
def test_a_ramp_beside_a_level_floor_does_not_tilt_it(share: float, slope_deg: float) -> None:
    corners, quads = room(furniture=False)
    middles = corners[quads].mean(axis=1)
    walls = quads[(middles[:, 2] > 0.01) & (middles[:, 2] < 2.4)]
    edge, top = 3.0 - 6.0 * share, 6.0 * share * np.tan(np.radians(slope_deg))
    floor = [[-3, -2, 0], [edge, -2, 0], [edge, 2, 0], [-3, 2, 0]]
    ramp = [[edge, -2, 0], [3, -2, top], [3, 2, top], [edge, 2, 0]]
    both = np.concatenate([walls, np.arange(8).reshape(2, 4) + len(corners)])
    guess = guess_up(np.concatenate([corners, floor, ramp]), triangles(both))
    assert guess.tilt_deg < 0.05
