"""``gibson-sim bench realism``: poses, causes, measures, report and errors, without a renderer and without Blender."""

from __future__ import annotations

import argparse
import importlib.util
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import CameraSpec, Frame
from gibson_sim_bench import timing
from gibson_sim_bench.cli import realism
from gibson_sim_bench.realism.causes import (
    CAUSES,
    LIGHT,
    MOVING,
    OUTSIDE,
    REFLECTION,
    TEXTURE,
    CauseError,
    errors_by_cause,
    masks_of,
)
from gibson_sim_bench.realism.measure import Pair, PoseResult, RealismPlan, RealismReport, SceneResult, same_depth
from gibson_sim_bench.realism.measures import flip_map
from gibson_sim_bench.realism.page import report_text, side_by_side, worst_poses, write_page
from gibson_sim_bench.realism.poses import HEIGHTS_M, Arrangement, body_poses, is_visible, sample_arrangements
from gibson_sim_tools.tracing.tracer import TracedPicture

GREY = np.full((60, 80, 3), 128, dtype=np.uint8)
NOWHERE = np.zeros((60, 80), dtype=bool)
MATTE = np.zeros((60, 80), dtype=np.uint8)
COVERED = np.ones((60, 80), dtype=np.float32)


# Measures


def test_equal_pictures_have_no_flip_difference() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (40, 50, 3)).astype(np.uint8)
    assert flip_map(picture, picture).max() == 0.0


def test_flip_of_black_and_white_is_that_of_the_authors_program() -> None:
    black, white = np.zeros((40, 50, 3), dtype=np.uint8), np.full((40, 50, 3), 255, dtype=np.uint8)
    # What the authors' program (flip-evaluator) returns, too.
    assert flip_map(black, white).mean() == pytest.approx(0.9674, abs=1e-3)
    assert flip_map(black, white) == pytest.approx(flip_map(white, black))


def test_flip_sees_an_edge_that_is_missing() -> None:
    edge = GREY.copy()
    edge[:, 40:] = 160
    shifted = np.roll(edge, 6, axis=1)
    shifted[:, :6] = 128
    difference = flip_map(edge, shifted)
    assert difference[30, 43] > 10 * difference[30, 10]


# Causes


def test_each_pixel_has_one_cause() -> None:
    moving, alpha, material = NOWHERE.copy(), COVERED.copy(), MATTE.copy()
    moving[:20], alpha[:, :10], material[10:30] = True, 0.2, 1
    masks = masks_of(moving, alpha, material)
    assert masks[OUTSIDE].sum() == 60 * 10
    assert masks[MOVING].sum() == 20 * 70
    assert masks[REFLECTION].sum() == 10 * 70
    assert masks[LIGHT] is masks[TEXTURE]
    assert sum(int(masks[cause].sum()) for cause in (MOVING, OUTSIDE, REFLECTION, LIGHT)) == 60 * 80


def test_shares_of_the_causes_add_up_to_the_squared_error() -> None:
    moving = NOWHERE.copy()
    moving[:30, :40] = True
    ours = np.random.default_rng(0).integers(0, 256, GREY.shape).astype(np.uint8)
    found = errors_by_cause(ours, GREY, masks_of(moving, COVERED, MATTE))
    assert sum(error.share for error in found.values()) == pytest.approx(1.0)
    total = sum(error.pixels * error.mse for error in found.values())
    assert total == pytest.approx(((ours.astype(float) - GREY) ** 2).mean())


def test_an_error_that_is_equal_everywhere_is_light() -> None:
    found = errors_by_cause(GREY + np.uint8(10), GREY, masks_of(NOWHERE, COVERED, MATTE))
    assert found[LIGHT].mse == pytest.approx(100.0)
    assert found[LIGHT].share == pytest.approx(1.0)


def test_an_error_that_alternates_is_texture() -> None:
    ours = GREY.copy()
    ours[::2], ours[1::2] = 138, 118
    found = errors_by_cause(ours, GREY, masks_of(NOWHERE, COVERED, MATTE))
    assert found[TEXTURE].share > 0.99


def test_errors_of_what_moves_do_not_leak_into_light() -> None:
    moving = NOWHERE.copy()
    moving[:, 40:] = True
    ours = GREY.copy()
    ours[:, 40:] = 228
    found = errors_by_cause(ours, GREY, masks_of(moving, COVERED, MATTE))
    assert found[MOVING].share == pytest.approx(1.0)
    assert found[MOVING].mse == pytest.approx(100.0**2)
    assert found[LIGHT].mse == 0.0


def test_equal_pictures_have_no_error_of_any_cause() -> None:
    assert {error.share for error in errors_by_cause(GREY, GREY, masks_of(NOWHERE, COVERED, MATTE)).values()} == {0.0}


# Poses


@pytest.fixture(scope="module")
def home() -> SceneSpec:
    return load_scene("linden_flat")


@pytest.fixture(scope="module")
def arrangements(home: SceneSpec) -> list[Arrangement]:
    return sample_arrangements(home, 9, 3, robot_radius=0.2, width=64, samples=1)


def test_equal_seeds_give_equal_poses(home: SceneSpec, arrangements: list[Arrangement]) -> None:
    again = sample_arrangements(home, 4, 3, robot_radius=0.2, width=64, samples=1)
    assert again == arrangements[:4]
    other = sample_arrangements(home, 4, 4, robot_radius=0.2, width=64, samples=1)
    assert all(a.camera != b.camera for a, b in zip(again, other, strict=True))


def test_cameras_are_at_three_heights_on_free_floor(home: SceneSpec, arrangements: list[Arrangement]) -> None:
    floor = scene_floor_map(home, robot_height=1.5)
    for number, arrangement in enumerate(arrangements):
        x, y, z = arrangement.camera.pose.position
        assert z == pytest.approx(HEIGHTS_M[number % 3])
        assert floor.clearance([[x, y]])[0] >= 0.25
        assert (arrangement.camera.width, arrangement.camera.height) == (64, 48)


def test_robot_and_moved_things_are_in_front_of_the_camera(home: SceneSpec, arrangements: list[Arrangement]) -> None:
    starts = {body.name: body.start for body in home.bodies}
    seen = 0
    for arrangement in arrangements:
        T_camera_world = np.linalg.inv(matrix_from_pose(arrangement.camera.pose))
        loose = [body for body in arrangement.bodies if body.name in arrangement.moved and body.semantic_class != "door"]
        for pose in [body.start for body in loose] + ([arrangement.robot] if arrangement.robot else []):
            right, _, forward = (T_camera_world @ [*pose.position, 1.0])[:3]
            assert abs(math.atan2(right, forward)) < math.radians(37.0), "the view is 75 degrees wide"
            assert 0.8 < math.hypot(right, forward) < 3.3
            seen += 1
        assert all(body.start != starts[body.name] for body in loose)
    assert seen >= 18


def test_doors_are_moved_within_their_range(home: SceneSpec, arrangements: list[Arrangement]) -> None:
    doors = [body for a in arrangements for body in a.bodies if body.semantic_class == "door" and body.name in a.moved]
    assert doors
    for door in doors:
        hinge = next(joint for joint in door.model.joints if joint.is_bounded)
        position = dict(door.joints)[hinge.name]
        assert hinge.lower <= position <= hinge.upper
        assert len(door.joints) == len({name for name, _ in door.joints})


def test_poses_of_bodies_are_those_of_all_their_links(home: SceneSpec, arrangements: list[Arrangement]) -> None:
    poses = body_poses(arrangements[0].bodies)
    assert set(poses) == {f"{body.name}/{link}" for body in home.bodies for link in body.links}


def test_a_scene_without_room_for_the_camera_is_refused(home: SceneSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    full = FloorMap(0.05, (0.0, 0.0), np.ones((20, 20), dtype=bool), np.ones((20, 20), dtype=bool))
    monkeypatch.setattr("gibson_sim_bench.realism.poses._floor_of", lambda scene, z: full)
    with pytest.raises(SceneError, match=r"'linden_flat': no floor has a place for the camera, 0.3 m from all"):
        sample_arrangements(home, 1, 0, robot_radius=0.2, width=64, samples=1)


def test_sight_ends_at_a_wall() -> None:
    wall = np.zeros((20, 20), dtype=bool)
    wall[:, 10] = True
    floor = FloorMap(0.05, (0.0, 0.0), wall, np.ones((20, 20), dtype=bool))
    assert is_visible(floor, np.array([0.2, 0.5]), np.array([0.4, 0.9]))
    assert not is_visible(floor, np.array([0.2, 0.5]), np.array([0.8, 0.5]))


# Comparison


def _picture(depth: np.ndarray, material: np.ndarray | None = None) -> TracedPicture:
    rgb = np.zeros((*depth.shape, 3), dtype=np.float32)
    none = np.zeros(depth.shape, dtype=np.uint8)
    return TracedPicture(
        rgb, rgb, np.ones(depth.shape, dtype=np.float32), depth, none > 0, none if material is None else material
    )


def _frame(depth: np.ndarray) -> Frame:
    return Frame(CameraSpec("eye", "", width=80, height=60), 0, np.eye(4), depth=depth)


def test_depths_agree_within_three_centimetres_or_beside_an_edge() -> None:
    ours = np.full((60, 80), 2.0, dtype=np.float32)
    assert same_depth(_frame(ours), _picture(ours + np.float32(0.04))) == 1.0
    assert same_depth(_frame(ours), _picture(ours + np.float32(0.2))) == 0.0
    theirs = ours.copy()
    ours[:, :40], theirs[:, :41] = 1.0, 1.0
    assert same_depth(_frame(ours), _picture(theirs)) == 1.0
    theirs[:, :50] = 1.0
    assert same_depth(_frame(ours), _picture(theirs)) == pytest.approx(1.0 - 9 / 80)


def test_pixels_of_glass_have_no_depth_to_compare() -> None:
    ours = np.full((60, 80), 2.0, dtype=np.float32)
    glass = np.zeros((60, 80), dtype=np.uint8)
    glass[:, :40] = 2
    theirs = ours.copy()
    theirs[:, :40] = 1.0
    assert same_depth(_frame(ours), _picture(theirs, glass)) == 1.0


def test_nothing_agrees_with_nothing() -> None:
    nothing = np.full((60, 80), np.inf, dtype=np.float32)
    assert same_depth(_frame(nothing), _picture(nothing)) == 1.0


# Report


def _pose(value: float, moves_mse: float = 400.0) -> PoseResult:
    causes = {cause: CauseError(0.0, 0.0, 0.0) for cause in CAUSES}
    causes |= {
        MOVING: CauseError(0.25, moves_mse, 0.5),
        LIGHT: CauseError(0.75, 100.0, 0.3),
        TEXTURE: CauseError(0.75, 33.0, 0.2),
    }
    return PoseResult("hall 1.00, 2.00", True, ("chair",), value, value, 0.9, 0.1, 45.0, 0.99, causes)


def _report() -> RealismReport:
    poses = tuple(_pose(float(value)) for value in range(20, 40))
    pairs = tuple(Pair(GREY, GREY + np.uint8(k)) for k in range(20))
    scene = SceneResult("home", True, (1.0, 1.1, 0.9), poses, (), pairs)
    return RealismReport(timing.facts(), RealismPlan(("home",)), (scene,), 12.0)


def test_summary_has_mean_worst_tenth_and_worst() -> None:
    summary = _report().scenes[0].summary
    assert (summary["psnr"], summary["psnr_worst_tenth"], summary["psnr_worst"]) == (29.5, 20.5, 20.0)


def test_psnr_of_what_moves_is_that_of_all_its_pixels_together() -> None:
    scene = SceneResult("home", True, (1.0, 1.0, 1.0), (_pose(20.0, 400.0), _pose(30.0, 0.0)))
    assert scene.summary["psnr_moves"] == pytest.approx(10 * math.log10(255**2 / 200), abs=1e-3)
    assert scene.summary["psnr_still"] == pytest.approx(10 * math.log10(255**2 / 133), abs=1e-3)


def test_report_as_json_has_figures_that_can_be_compared() -> None:
    values = _report().as_json()
    assert values["kind"] == "realism"
    assert [figure["name"] for figure in values["figures"]] == ["home: PSNR, mean", "home: PSNR, worst tenth", "home: FLIP, mean"]
    assert values["scenes"][0]["poses"][0]["causes"][MOVING] == {"pixels": 0.25, "mse": 400.0, "share": 0.5}
    assert "blender_python" not in values["plan"]


def test_text_names_every_scene_and_cause() -> None:
    text = report_text(_report())
    assert all(word in text for word in ("home", "29.5", *CAUSES))


def test_page_has_the_worst_pairs_and_loads_nothing(tmp_path: Path) -> None:
    report = _report()
    write_page(report, tmp_path / "index.html", 3)
    page = (tmp_path / "index.html").read_text()
    assert page.count("<figure>") == 3
    assert page.count("data:image/png") == 3
    assert "http" not in page.replace("http-equiv", "")
    assert worst_poses(report.scenes[0], 3) == [0, 1, 2]


def test_names_in_the_page_are_no_html(tmp_path: Path) -> None:
    report = _report()
    scene = replace(report.scenes[0], scene="<script>")
    write_page(replace(report, scenes=(scene,)), tmp_path / "index.html", 1)
    assert "<script>" not in (tmp_path / "index.html").read_text()


def test_difference_is_grey_where_pictures_are_equal() -> None:
    row = side_by_side(Pair(GREY, GREY - np.uint8(10)))
    assert row.shape == (60, 240, 3)
    assert row[0, [0, 80, 160], 0].tolist() == [128, 118, 158]


# Options


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--samples", "1"], "--samples is 1, must be 2 to 65536"),
        (["--poses", "0"], "--poses is 0, must be 1 to 10000"),
        (["--width", "322"], "--width is 322, must be a multiple of 4"),
        (["--seed", "-1"], "--seed is -1, must be 0 to"),
        (["--worst", "-1"], "--worst is -1, must be 0 or more"),
        (["--blender-python", "/no/such/python"], "--blender-python /no/such/python: cannot be run"),
    ],
)
def test_an_impossible_comparison_is_refused_in_one_line(
    words: list[str], error: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["bench", "realism", "linden_flat", "--output", str(tmp_path), *words])
    assert end.value.code == 1
    assert error in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_python_without_blender_is_an_error_of_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    if importlib.util.find_spec("bpy") is not None:
        pytest.skip("SKIPPED: this Python has Blender")
    with pytest.raises(SystemExit):
        main(["bench", "realism", "linden_flat", "--output", str(tmp_path)])
    lines = capsys.readouterr().err.strip().splitlines()
    assert "has no Blender" in lines[-1]
    assert "--blender-python" in lines[-1]


def test_defaults_are_those_that_the_help_names() -> None:
    parser = argparse.ArgumentParser()
    realism.add_parser(parser.add_subparsers(dest="kind"))
    plan = realism.plan_of(parser.parse_args(["realism", "a", "b"]))
    assert (plan.scenes, plan.poses, plan.seed, plan.width, plan.samples, plan.antialiasing) == (("a", "b"), 12, 0, 320, 128, 1)
    with pytest.raises(ConfigError, match="no scene is given"):
        RealismPlan(())
