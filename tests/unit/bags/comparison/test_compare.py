"""Rows, pages and texts of two small recordings."""

from __future__ import annotations

import builtins
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.bags.comparison.compare import Comparison, Row, compare
from gibson_sim.bags.comparison.page import figures, number, page, text_table
from gibson_sim.bags.comparison.pictures import picture_statistics, thumbnail
from gibson_sim.bags.comparison.plots import draw_plots
from gibson_sim.bags.comparison.recorded_drive import Commands, Pictures, PlanarTrack, RecordedDrive
from gibson_sim.bags.plots.style import require_matplotlib
from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.robots.load import load_robot

T = np.arange(0.0, 12.0, 1 / 30)
SENT = np.arange(0.0, 12.0, 0.1)


def pictures(value: int) -> Pictures:
    rgb = np.full((24, 32, 3), value, dtype=np.uint8)
    statistics, histogram = picture_statistics(rgb)
    return Pictures(np.array([1.0, 8.0]), np.stack([statistics] * 2), np.stack([histogram] * 2), (thumbnail(rgb),) * 2)


def recording(name: str, late: float = 0.0, scale: float = 1.0, start: float = 0.0, value: int = 128) -> RecordedDrive:
    """Returns a drive with two steps, whose odometry lags by ``late`` seconds and has the scale ``scale``."""
    asked = np.where((SENT >= 2.0) & (SENT < 6.0), 0.3, 0.0)
    speed = 0.3 * (np.clip((T - 2.0 - late) * 3.0, 0.0, 1.0) - np.clip((T - 6.0 - late) * 3.0, 0.0, 1.0))
    zero, way = 0.0 * T, np.cumsum(speed) / 30
    return RecordedDrive(
        path=Path(name), duration=12.0, topics={"cmd_vel": "/cmd_vel", "odom": "/odom"},
        commands=Commands(SENT, asked, 0.0 * SENT), odometry=PlanarTrack(T, scale * way, zero, zero, scale * speed, zero, "/odom"),
        truth=PlanarTrack(T, start + way, zero, zero, speed, zero, "/ground_truth/odom"), pictures=pictures(value),
        notes=("no imu: nothing of it",),
    )  # fmt: skip


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(recording("<real>", late=0.1, scale=1.1, value=100), recording("sim"), load_robot("gibson_bot"))


def row(comparison: Comparison, group: str, name: str) -> Row:
    return next(one for one in comparison.rows if (one.group, one.name) == (group, name))


def test_equal_recordings_do_not_differ() -> None:
    same = compare(recording("a"), recording("b"), load_robot("gibson_bot"))
    assert same.differing == ()
    assert text_table(same) == "no notable differences"
    assert not any(parameter.changes for parameter in same.parameters)


def test_differences_are_sorted_by_weight(comparison: Comparison) -> None:
    weights = [one.weight for one in comparison.differing]
    assert weights == sorted(weights, reverse=True)
    assert row(comparison, "velocity, forward", "delay").difference == pytest.approx(100.0, abs=10.0)
    assert row(comparison, "odometry", "forward distance over the true one").real == pytest.approx(1.1, rel=1e-3)


def test_a_row_names_the_value_to_change(comparison: Comparison) -> None:
    assert row(comparison, "velocity, forward", "delay").change.startswith("drive.command_delay: 0 → 0.1")


def test_a_value_that_one_side_lacks_has_no_weight() -> None:
    assert Row("a", "b", "", math.nan, 1.0, 0.1).weight == 0.0


def test_darker_pictures_at_the_same_poses_suggest_less_exposure(comparison: Comparison) -> None:
    found = row(comparison, "images at the same poses", "brightness")
    assert (found.real, found.sim) == pytest.approx((100 / 255, 128 / 255))
    assert "effects.exposure_ev -0.76" in found.change


def test_poses_are_relative_to_the_start_on_request() -> None:
    real, sim, robot = recording("a", start=5.0), recording("b"), load_robot("gibson_bot")
    assert compare(real, sim, robot).pictures is None
    moved = compare(real, sim, robot, align="start")
    assert moved.pictures is not None
    assert len(moved.pictures.pairs) == 2


def test_almost_empty_recordings_are_compared(tmp_path: Path) -> None:
    empty = RecordedDrive(Path("empty"), 0.0, {}, notes=("no odom",))
    found = compare(empty, empty, load_robot("gibson_bot"))
    assert (found.rows, found.parameters, draw_plots(found)) == ((), (), [])
    assert "no odom" in page(found, [], "gibson_bot")


def test_page_escapes_text_of_the_bags(comparison: Comparison) -> None:
    text = page(replace(comparison, notes=("<script>",)), draw_plots(comparison), "gibson_bot")
    assert "<script" not in text
    assert "&lt;real&gt;" in text
    assert text.count("<svg") == text.count("</svg>") >= 4
    assert "data:image/jpeg;base64," in text


def test_values_are_json_without_nan_and_infinity(comparison: Comparison) -> None:
    text = json.dumps(figures(comparison), allow_nan=False)
    assert "drive.command_delay" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (0.05017, "0.0502"),
        (19.923, "19.92"),
        (144.44, "144.4"),
        (2048.0, "2048"),
        (1.2e-5, "1.20e-05"),
        (math.nan, "–"),
    ],
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text


def test_without_matplotlib_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real_import = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "matplotlib":
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(EnvironmentProblemError, match=r"gibson_sim\[analysis\]"):
        require_matplotlib("an HTML report", ", or leave out --html")
