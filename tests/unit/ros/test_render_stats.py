"""Statistics of a render node, computed by hand: a camera of 10 Hz."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.ros.nodes.render_stats import LoadingProgress, RenderStats
from gibson_sim.types import CameraSpec, Frame

CAMERA = CameraSpec("eye", "", rate_hz=10.0, outputs=("rgb", "depth"))
TENTH_NS = 100_000_000


def _draw(stats: RenderStats, tick: int) -> None:
    stats.count_due(CAMERA, tick * TENTH_NS, subscribed=True)
    stats.add(0, 2_000_000, 5_000_000, [Frame(CAMERA, tick * TENTH_NS, np.eye(4))], ["eye/rgb"])


def test_images_that_were_due_in_between_are_skipped() -> None:
    stats = RenderStats()
    for tick in (1, 2, 5, 6):
        _draw(stats, tick)
    assert stats.skipped == 2


def test_a_camera_is_charged_with_its_own_skipped_images_alone() -> None:
    stats, other = RenderStats(), CameraSpec("view", "", rate_hz=10.0, outputs=("rgb",))
    for tick in (1, 5):
        _draw(stats, tick)
    stats.count_due(other, TENTH_NS, subscribed=True)
    stats.add(0, 1, 2, [Frame(other, TENTH_NS, np.eye(4))], ["view/rgb"])
    assert stats.summary()["skipped_by_camera"] == {"eye": 3, "view": 0}


def test_images_that_could_not_be_rendered_are_not_skipped() -> None:
    stats = RenderStats()
    _draw(stats, 1)
    stats.count_due(CAMERA, 2 * TENTH_NS, subscribed=True)
    stats.count_failed(CAMERA)
    _draw(stats, 3)
    summary = stats.summary()
    assert (summary["images"], summary["failed_images"], summary["skipped_images"]) == ({"eye": 2}, {"eye": 1}, 0)


def test_reports_count_failed_images_also_of_a_camera_without_any_other() -> None:
    stats = RenderStats()
    for expected in (1, 0):
        for _ in range(expected):
            stats.count_due(CAMERA, TENTH_NS, subscribed=True)
            stats.count_failed(CAMERA)
        assert stats.since_last_report()["failed"] == expected
    assert stats.summary()["skipped_by_camera"] == {"eye": 0}


def test_images_without_subscribers_are_not_skipped() -> None:
    stats = RenderStats()
    _draw(stats, 1)
    stats.count_due(CAMERA, 2 * TENTH_NS, subscribed=False)
    _draw(stats, 40)
    assert stats.skipped == 0


def test_a_jump_back_is_neither_skipped_nor_simulated_time() -> None:
    stats = RenderStats()
    for tick in (100, 101, 102, 1, 2, 3):
        _draw(stats, tick)
    assert stats.skipped == 0
    # Six images; 0.2 s before and 0.2 s after the jump.
    assert stats.summary()["images_per_simulated_s"]["eye"] == pytest.approx(5 / 0.4)


def test_a_summary_counts_images_outputs_and_messages() -> None:
    stats = RenderStats()
    for tick in (1, 2, 3):
        _draw(stats, tick)
    summary = stats.summary()
    assert summary["images"] == {"eye": 3}
    assert summary["outputs"] == {"eye/rgb": 3, "eye/depth": 3}
    assert summary["messages"] == {"eye/rgb": 3}
    assert (summary["draw_ms_median"], summary["publish_ms_median"]) == (2.0, 3.0)


def test_a_summary_before_the_first_image_is_empty() -> None:
    assert RenderStats().summary()["images"] == {}


def test_a_stage_of_loading_that_was_logged_is_logged_at_its_end() -> None:
    now, noted, logged = [0.0], list[str](), list[str]()
    report = LoadingProgress(noted.append, logged.append, lambda: now[0])
    for seconds, what, part in ((0.1, "reading", 0.5), (0.2, "reading", 1.0), (2.5, "details", 0.11), (2.6, "details", 1.0)):
        now[0] = seconds
        report(what, part)
    assert logged == ["details: 11 %", "details: 100 %"], "a quick stage is not logged"
    assert noted[-1] == "details: 100 %"
