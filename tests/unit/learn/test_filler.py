"""Pairs, stages and scores of the filler, by hand; impossible settings are refused."""

from __future__ import annotations

import argparse
import errno
import os
import shutil
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, WriteError
from gibson_sim.filling.fillers import PushPull
from gibson_sim_learn.cli import learn
from gibson_sim_learn.filler import pipeline
from gibson_sim_learn.filler.evaluation import Flicker, beats_baselines, mean_flicker, scores_of, table
from gibson_sim_learn.filler.pairs import Pairs, ScannedScene, data_hash, depth_of, load_pairs, save_pairs
from gibson_sim_learn.filler.pipeline import make_scan
from gibson_sim_learn.filler.scoring import Score, Scoring, gmsd, warped
from gibson_sim_learn.filler.settings import EvaluationSettings, PairsSettings, TrainingSettings, options_of
from gibson_sim_learn.path_following.split import TRAINING, VALIDATION
from gibson_sim_learn.training_folder import locked


def flat(level: int, side: int = 16) -> np.ndarray:
    return np.full((side, side, 3), level, np.uint8)


def pairs(views: int = 2, side: int = 16) -> Pairs:
    """Returns views of a scan of level 100 whose left half is a hole of level 0, filled with 110; the truth is 120."""
    hole = np.zeros((views, side, side), np.uint8)
    hole[:, :, : side // 2] = 1
    filled = np.full((views, side, side, 3), 100, np.uint8)
    filled[hole == 1] = 110
    drawn = np.where(hole[..., None] == 1, np.uint8(0), filled)
    normals = np.where(hole[..., None] == 1, 0, np.array([0, 0, -127])).astype(np.int8)
    depth = np.where(hole == 1, 0, 2000).astype(np.uint16)
    return Pairs(drawn, filled, depth, normals, hole, np.full_like(filled, 120))


def test_psnr_is_that_of_all_pixels_of_a_region_together() -> None:
    scoring, hole = Scoring(), np.zeros((16, 16), bool)
    hole[:8] = True
    scoring.add(flat(100), flat(110), hole)
    scoring.add(flat(100), flat(100), hole)
    found = scoring.score()
    # Mean squared error (100 + 0) / 2 = 50: 10 log10(255^2 / 50) = 31.14 dB, in both halves.
    assert [found.hole_psnr, found.seen_psnr] == pytest.approx([31.14, 31.14], abs=0.01)
    # (2 100 110 + 6.5025) / (100^2 + 110^2 + 6.5025) = 0.99548; the other image has 1.
    assert found.seen_ssim == pytest.approx((0.99548 + 1.0) / 2, abs=1e-4)


def test_a_picture_without_holes_has_no_score_in_holes() -> None:
    scoring = Scoring()
    scoring.add(flat(1), flat(1), np.zeros((16, 16), bool))
    found = scoring.score()
    assert np.isnan(found.hole_psnr) and found.seen_psnr == 60.0


def test_gmsd_is_zero_for_equal_pictures_and_matches_edges_computed_by_hand() -> None:
    step = flat(0, 8)
    step[:, 4:] = 90
    assert gmsd(step, step) == 0.0
    # Half the size: levels 0 0 90 90. Gradients 0 90 90 0 against none: similarity 170 / (8100 + 170) = 0.02056 in half of
    # the pixels, 1 in the others: deviation (1 - 0.02056) / 2.
    assert gmsd(step, flat(0, 8)) == pytest.approx(0.48972, abs=1e-5)


def test_warped_picture_is_moved_by_what_the_camera_moved() -> None:
    matrix = np.array([[20.0, 0.0, 7.5], [0.0, 20.0, 7.5], [0.0, 0.0, 1.0]])
    depth = np.full((16, 16), 2.0, np.float32)
    image = np.repeat(np.arange(16, dtype=np.uint8)[None, :, None] * 10, 16, axis=0).repeat(3, axis=2)
    there = np.eye(4)
    there[0, 3] = 0.2  # to the right: what is seen moves left by 20 * 0.2 / 2 = 2 pixels
    found, known = warped(image, there, matrix, depth, np.eye(4), depth)
    assert known[:, :14].all() and not known[:, 14:].any()
    assert (found[:, :14] == image[:, 2:]).all()
    # Another surface was there: nothing is known.
    assert not warped(image, there, matrix, depth, np.eye(4), 0.5 * depth)[1].any()


def test_ways_are_scored_on_every_nth_view() -> None:
    methods = {"nothing": lambda colour, depth, normals, hole: colour, "truth": lambda colour, depth, normals, hole: flat(120)}
    found = scores_of([pairs(3)], methods, every=2)
    # Where seen 20 levels: 10 log10(255^2 / 400) = 22.11 dB; in holes 120: 6.55 dB.
    assert [found["nothing"].seen_psnr, found["nothing"].hole_psnr] == pytest.approx([22.11, 6.55], abs=0.01)
    assert (found["truth"].hole_psnr, found["truth"].gmsd) == (60.0, 0.0)


def test_a_network_is_worth_shipping_if_it_beats_the_best_classical_in_holes_and_nothing_where_seen() -> None:
    scores = {name: Score(15.0, 20.0, 0.5, 0.6, 0.2) for name in ("nothing", "telea", "navier_stokes", "push_pull")}
    better = Score(15.1, 20.1, 0.5, 0.6, 0.2)
    assert beats_baselines(scores | {"own.onnx": better}, "own.onnx")
    assert not beats_baselines(scores | {"learned": replace(better, seen_psnr=20.0)}, "learned")
    assert not beats_baselines(scores | {"learned": better, "telea": replace(better, hole_psnr=15.2)}, "learned")
    lines = table({"learned": better}, mean_flicker([{"learned": Flicker(1.0, 2.0)}, {"learned": Flicker(2.0, 4.0)}]))
    assert lines[-1] == "| `learned` | 15.10 dB, 0.500 | 20.10 dB, 0.600 | 0.200 | 1.50, 3.00 |"


def test_shards_are_read_as_saved_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="2 of 2 shards are missing: room-000, room-001; run `gibson-sim learn filler pairs"):
        load_pairs(tmp_path, ["room-000", "room-001"])
    save_pairs(tmp_path / "room-000", pairs())
    (found,) = load_pairs(tmp_path, ["room-000"])
    assert all(np.array_equal(getattr(found, item.name), getattr(pairs(), item.name)) for item in fields(Pairs))
    assert depth_of(found.depth_mm[0])[0].tolist() == [np.inf] * 8 + [2.0] * 8
    for content in (b"cut", b""):
        (tmp_path / "room-000" / "truth.npy").write_bytes(content)
        with pytest.raises(ConfigError, match=r"room-000: not a shard of data: .*; run `gibson-sim learn filler pairs --folder"):
            load_pairs(tmp_path, ["room-000"])


def test_arrays_that_differ_from_their_digest_are_refused(tmp_path: Path) -> None:
    save_pairs(tmp_path / "room-000", pairs())
    np.save(tmp_path / "room-000" / "truth.npy", pairs().truth + 1)
    with pytest.raises(ConfigError, match=r"room-000: its arrays differ from digest.txt; run `gibson-sim learn filler pairs"):
        load_pairs(tmp_path, ["room-000"])
    save_pairs(tmp_path / "room-001", pairs())
    (tmp_path / "room-001" / "digest.txt").unlink()
    with pytest.raises(ConfigError, match=r"room-001: its arrays differ from digest.txt"):
        load_pairs(tmp_path, ["room-001"])


def test_hash_of_the_pairs_distinguishes_other_pairs(tmp_path: Path) -> None:
    for name, count in (("one", 2), ("same", 2), ("other", 3)):
        save_pairs(tmp_path / name / "room-000", pairs(count))
    one, same, other = (data_hash(tmp_path / name, ["room-000"]) for name in ("one", "same", "other"))
    assert one == same != other


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Returns a list of the shards that are drawn; they are drawn without scans."""
    found: list[tuple[str, int]] = []

    def draw(scene: str, seed: int, number: int) -> Pairs:
        found.append((scene, number))
        return pairs()

    monkeypatch.setattr(pipeline, "make_scan", lambda scene, folder, settings: folder)
    monkeypatch.setattr(ScannedScene, "load", lambda scene, scan: scene)
    monkeypatch.setattr("gibson_sim_learn.filler.pairs.draw_pairs", draw)
    return found


def test_pairs_draws_missing_and_damaged_shards_again(tmp_path: Path, drawn: list[tuple[str, int]]) -> None:
    pipeline.make_all_pairs(tmp_path, PairsSettings(shards=3), ["mill_house"])
    assert drawn == [("mill_house", number) for number in range(pipeline._count("mill_house", PairsSettings(shards=3)))]
    drawn.clear()
    pipeline.make_all_pairs(tmp_path, PairsSettings(shards=3), ["mill_house"])
    assert not drawn
    (tmp_path / "pairs" / "mill_house-001" / "hole.npy").unlink()
    (tmp_path / "pairs" / "mill_house-000" / "truth.npy").write_bytes(b"cut")
    pipeline.make_all_pairs(tmp_path, PairsSettings(shards=3), ["mill_house"])
    assert drawn == [("mill_house", 0), ("mill_house", 1)]
    load_pairs(tmp_path / "pairs", ["mill_house-000", "mill_house-001"])


def test_pairs_of_other_settings_are_refused(tmp_path: Path, drawn: list[tuple[str, int]]) -> None:
    pipeline.make_all_pairs(tmp_path, PairsSettings(frames=60, shards=1), ["mill_house"])
    pipeline.make_all_pairs(tmp_path, PairsSettings(frames=60, shards=2), ["mill_house"])
    with pytest.raises(ConfigError, match=r"pairs: holds pairs with another frames \(60\); choose another --folder"):
        pipeline.make_all_pairs(tmp_path, PairsSettings(), ["linden_flat"])


def test_a_scene_on_which_another_process_works_is_refused_and_other_scenes_are_not(
    tmp_path: Path, drawn: list[tuple[str, int]]
) -> None:
    with locked(tmp_path / "scans" / "linden_flat"):
        with pytest.raises(
            ConfigError,
            match=r"scans/linden_flat: another `gibson-sim learn` works in this folder; wait for it, or choose other --scenes",
        ):
            pipeline.make_all_pairs(tmp_path, PairsSettings())
        assert not drawn
        pipeline.make_all_pairs(tmp_path, PairsSettings(), ["river_office", "river_office"])
    assert drawn == [("river_office", 0), ("river_office", 1)]


def test_shards_that_training_lacks_are_named_with_the_command_that_draws_them(
    tmp_path: Path, drawn: list[tuple[str, int]]
) -> None:
    pipeline.make_all_pairs(tmp_path, PairsSettings(shards=3, frames=60), [*TRAINING, *VALIDATION])
    assert pipeline.missing_for_training(tmp_path) == []
    shutil.rmtree(tmp_path / "pairs" / f"{TRAINING[-1]}-002")
    assert pipeline.missing_for_training(tmp_path) == [f"{TRAINING[-1]}-002"]
    with pytest.raises(ConfigError) as error:
        load_pairs(tmp_path / "pairs", pipeline._shards(tmp_path, TRAINING))
    assert str(error.value) == (
        f"{tmp_path}/pairs: 1 of {3 * len(TRAINING)} shards are missing: {TRAINING[-1]}-002; "
        f"run `gibson-sim learn filler pairs --folder {tmp_path} --shards 3 --frames 60`"
    )


def test_unreadable_settings_of_pairs_say_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_text('{"shards": 3, "colour": 1}')
    with pytest.raises(
        ConfigError, match=r"settings.json: cannot be read: .*; delete it, and run `gibson-sim learn filler pairs`"
    ):
        load_pairs(tmp_path, ["room-000"])


def test_a_scan_that_cannot_be_loaded_says_what_to_delete(tmp_path: Path) -> None:
    (tmp_path / "textured").mkdir()
    with pytest.raises(
        ConfigError, match=rf"delete the folder {tmp_path}/textured, and run `gibson-sim learn filler pairs` with the"
    ):
        ScannedScene.load("arena", tmp_path / "textured")


def test_a_deleted_texture_is_made_again(tmp_path: Path) -> None:
    ran: list[str] = []

    def run(arguments: Sequence[str]) -> None:
        ran.append(arguments[1])
        if arguments[1] == "texture":
            (tmp_path / "textured").mkdir()

    make_scan("flat", tmp_path, PairsSettings(), run)
    make_scan("flat", tmp_path, PairsSettings(), run)
    assert ran == ["scan", "fuse", "texture"]
    shutil.rmtree(tmp_path / "textured")
    make_scan("flat", tmp_path, PairsSettings(), run)
    assert ran == ["scan", "fuse", "texture", "texture"]


def test_a_finished_stage_is_not_run_again_and_other_settings_are_refused(tmp_path: Path) -> None:
    ran: list[str] = []

    def failing_fuse(arguments: Sequence[str]) -> None:
        ran.append(arguments[1])
        if arguments[1] == "fuse":
            (tmp_path / "mesh.ply").write_text("a remainder, which `scene fuse` does not overwrite")
            raise ConfigError("no")

    with pytest.raises(ConfigError, match="no"):
        make_scan("flat", tmp_path, PairsSettings(), failing_fuse)
    assert make_scan("flat", tmp_path, PairsSettings(), lambda arguments: ran.append(arguments[1])) == tmp_path / "textured"
    assert ran == ["scan", "fuse", "fuse", "texture"] and not (tmp_path / "mesh.ply").exists()
    assert (tmp_path / "fuse.done").read_text() == "scene fuse scan --voxel 0.02 --triangles 150000 --output mesh.ply\n"
    with pytest.raises(ConfigError, match=r"scan.done: that stage was run with other settings; give another --folder"):
        make_scan("flat", tmp_path, PairsSettings(frames=60), lambda arguments: ran.append(arguments[1]))


def test_impossible_settings_are_refused() -> None:
    for wrong, message in (
        (lambda: TrainingSettings(crop=100), "'crop' is 100 px, must be a multiple of 16"),
        (lambda: PairsSettings(shards=0), "'shards' is 0"),
        (lambda: EvaluationSettings(every=0), "'every' is 0"),
        (lambda: EvaluationSettings(drive=1), "'drive' is 1, must be 0 or 2 to 280"),
    ):
        with pytest.raises(ConfigError, match=message):
            wrong()


def test_a_full_disk_is_one_line_and_leaves_no_part_of_a_shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    save_pairs(tmp_path / "room-000", pairs())
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(WriteError, match=r"cannot write .*drawn\.npy: No space left on device .*; free disk space"):
        save_pairs(tmp_path / "room-001", pairs())
    assert [path.name for path in tmp_path.iterdir()] == ["room-000"]


def test_options_of_settings_are_those_that_differ_from_the_default() -> None:
    assert options_of(TrainingSettings()) == "" and options_of(PairsSettings(shards=2)) == " --shards 2"
    settings = TrainingSettings(batch=2, crop=64, evaluate_every=10, learning_rate=1e-4)
    assert options_of(settings) == " --batch 2 --crop 64 --learning-rate 0.0001 --evaluate-every 10"


def test_evaluation_names_the_file_of_a_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("linden_flat-000", "linden_flat-001"):
        save_pairs(tmp_path / "pairs" / name, pairs())
    monkeypatch.setattr("gibson_sim_learn.filler.evaluation.open_filler", lambda name: PushPull())
    for model, name in ((None, "learned"), (tmp_path / "own.onnx", str(tmp_path / "own.onnx"))):
        found = pipeline.evaluate(
            tmp_path, ["linden_flat"], model, EvaluationSettings(drive=0), sheet_file=tmp_path / "sheet.png"
        )
        assert list(found.values["scores"])[-1] == name and found.lines[-1].startswith(f"| `{name}` |")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--report", "."], r"cannot write \.: Is a directory"),
        (["--sheet", "sheet.xyz"], r"cannot write sheet\.xyz: its suffix is that of no image format; the name must end in \.png"),
    ],
)
def test_outputs_that_cannot_be_written_are_refused_before_the_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    parser = argparse.ArgumentParser()
    learn.add_parser(parser.add_subparsers())
    monkeypatch.setattr(pipeline, "evaluate", lambda *args, **kwargs: pytest.fail("the evaluation began"))
    with pytest.raises(WriteError, match=message):
        learn.run_filler_evaluation(parser.parse_args(["learn", "filler", "evaluate", *options]))
    assert list(tmp_path.iterdir()) == []
