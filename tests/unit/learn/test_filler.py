"""Pairs, stages and scores of the filler: by hand, and what cannot be is refused."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, WriteError
from gibson_sim_learn.filler.evaluation import Flicker, beats_baselines, mean_flicker, scores_of, table
from gibson_sim_learn.filler.pairs import Pairs, data_hash, depth_of, load_pairs, save_pairs
from gibson_sim_learn.filler.scans import make_scan
from gibson_sim_learn.filler.scoring import Score, Scoring, gmsd, ssim_map, warped
from gibson_sim_learn.filler.settings import EvaluationSettings, PairsSettings, TrainingSettings


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


def test_ssim_falls_where_pictures_differ_alone() -> None:
    other = flat(100, 32)
    other[:, 24:] = 0
    found = ssim_map(other, flat(100, 32))
    assert found[:, :16].min() > 0.999 and found[:, 28:].max() < 0.01


def test_gmsd_is_nought_of_equal_pictures_and_counts_edges_by_hand() -> None:
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
    assert beats_baselines(scores | {"learned": better})
    assert not beats_baselines(scores | {"learned": replace(better, seen_psnr=20.0)})
    assert not beats_baselines(scores | {"learned": better, "telea": replace(better, hole_psnr=15.2)})
    lines = table({"learned": better}, mean_flicker([{"learned": Flicker(1.0, 2.0)}, {"learned": Flicker(2.0, 4.0)}]))
    assert lines[-1] == "| `learned` | 15.10 dB, 0.500 | 20.10 dB, 0.600 | 0.200 | 1.50, 3.00 |"


def test_shards_come_back_as_they_were_saved_and_what_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no pairs of room; run gibson-sim learn filler pairs"):
        load_pairs(tmp_path, ["room"])
    save_pairs(tmp_path / "room-000", pairs())
    (found,) = load_pairs(tmp_path, ["room"])
    assert all(np.array_equal(getattr(found, item.name), getattr(pairs(), item.name)) for item in fields(Pairs))
    assert depth_of(found.depth_mm[0])[0].tolist() == [np.inf] * 8 + [2.0] * 8
    (tmp_path / "room-000" / "truth.npy").write_bytes(b"cut")
    with pytest.raises(ConfigError, match=r"room-000: not a shard of data: .*; run `gibson-sim learn filler pairs` again"):
        load_pairs(tmp_path, ["room"])


def test_hash_of_the_pairs_tells_others(tmp_path: Path) -> None:
    for name, count in (("one", 2), ("same", 2), ("other", 3)):
        save_pairs(tmp_path / name / "room-000", pairs(count))
    one, same, other = (data_hash(tmp_path / name, ["room"]) for name in ("one", "same", "other"))
    assert one == same != other


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


def test_settings_that_cannot_be_are_refused() -> None:
    for wrong, message in (
        (lambda: TrainingSettings(crop=100), "'crop' is 100 px, must be a multiple of 16"),
        (lambda: PairsSettings(shards=0), "'shards' is 0"),
        (lambda: EvaluationSettings(every=0), "'every' is 0"),
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
