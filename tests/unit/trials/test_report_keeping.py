"""What is kept of a run once it was judged: its path, and pictures of what went wrong."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import cv2
import pytest

from gibson_sim.trials.report.keeping import keep_of_run
from gibson_sim.trials.report.paths import read_path
from support.run_bags import Run, until
from support.trial_results import failed, passed


def test_a_failed_run_keeps_its_bag_its_path_and_plots(tmp_path: Path) -> None:
    Run(truth=until(6.0, 4.0)).write(tmp_path)
    keep_of_run(failed(0), tmp_path, "failed")
    assert (tmp_path / "bag" / "metadata.yaml").exists()
    assert read_path(tmp_path) == ((1.0, 2.0), (4.0, 2.0))
    for name in ("path.png", "motion.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture is not None
        assert picture.shape[1] > 400
    assert not (tmp_path / "film.jpg").exists()


def test_a_passed_run_keeps_its_path_alone(tmp_path: Path) -> None:
    Run().write(tmp_path)
    shutil.copytree(tmp_path / "bag", tmp_path / "bag_epoch1")
    keep_of_run(passed(0), tmp_path, "failed")
    assert [path.name for path in tmp_path.iterdir()] == ["path.json"]


def test_a_passed_run_keeps_its_bag_on_request(tmp_path: Path) -> None:
    Run().write(tmp_path)
    keep_of_run(passed(0), tmp_path, "all")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "path.json"]


def test_a_bag_without_truth_has_no_path(tmp_path: Path) -> None:
    Run(without=("/ground_truth/odom",)).write(tmp_path)
    keep_of_run(passed(0), tmp_path, "all")
    assert read_path(tmp_path) == ()


def test_a_damaged_bag_is_a_warning_and_no_error(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("x: 1")
    with caplog.at_level(logging.WARNING):
        keep_of_run(failed(3), tmp_path, "failed")
    assert "run 3: the page lacks pictures of it" in caplog.text
    assert (tmp_path / "bag").is_dir()


def test_a_run_without_a_bag_keeps_nothing(tmp_path: Path) -> None:
    keep_of_run(failed(0), tmp_path, "failed")
    assert list(tmp_path.iterdir()) == []
