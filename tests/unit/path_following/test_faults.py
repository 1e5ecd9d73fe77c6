"""A camera with faults: which images are sent, when, and which are covered; and the reaction of a robot that follows them."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.policies.faults import CameraFaults, FaultSettings
from gibson_path_following.policies.follower import PathFollower
from gibson_path_following.policies.teach_repeat import TeachRepeatPolicy
from gibson_path_following.types import View
from support.path_views import pinhole_view, straight_path

TICK = 100_000_000


def _passed(settings: FaultSettings, images: int = 6) -> list[list[tuple[int, bool]]]:
    """Returns what goes out at each of some images, 0.1 s apart; the robot moves from the second on."""
    faults: CameraFaults[int] = CameraFaults(settings)
    out = []
    for k in range(images):
        if k >= 1:
            faults.move(k * TICK)
        out.append(faults.add(k * TICK, k))
    return out


def test_without_faults_every_image_passes_at_once() -> None:
    assert _passed(FaultSettings(), 3) == [[(0, False)], [(1, False)], [(2, False)]]


def test_half_of_the_images_are_every_other_one() -> None:
    assert _passed(FaultSettings(drop=0.5)) == [[(0, False)], [], [(2, False)], [], [(4, False)], []]


def test_an_image_that_is_late_goes_out_with_the_one_of_that_time() -> None:
    assert _passed(FaultSettings(delay=0.2), 4) == [[], [], [(0, False)], [(1, False)]]


def test_the_lens_is_covered_a_time_after_the_first_motion() -> None:
    # The robot moves at 0.1 s: covered from 0.3 s to before 0.5 s.
    out = _passed(FaultSettings(cover_after=0.2, cover=0.2))
    assert [is_covered for ((_, is_covered),) in out] == [False, False, False, True, True, False]


def test_delayed_images_are_dropped_when_time_goes_back() -> None:
    faults: CameraFaults[str] = CameraFaults(FaultSettings(delay=0.2))
    assert faults.add(5 * TICK, "before") == []
    assert faults.add(0, "after") == []
    assert faults.add(2 * TICK, "later") == [("after", False)]


def test_images_whose_stamp_stands_still_are_not_kept_for_ever() -> None:
    faults: CameraFaults[str] = CameraFaults(FaultSettings(delay=0.2))
    for k in range(5):
        assert faults.add(0, f"image {k}") == []
    assert faults.add(2 * TICK, "later") == [("image 4", False)]


@pytest.mark.parametrize("values", [{"drop": 1.5}, {"delay": -1.0}, {"cover": float("nan")}])
def test_impossible_faults_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(SettingError, match="must be 0 to"):
        FaultSettings(**values)


def _drive(settings: FaultSettings, ticks: int = 200) -> list[tuple[float, str]]:
    """Drives a path of 2.2 m with a camera of 10 Hz that fails; returns place, metres, and state every 0.1 s until its end."""
    path = straight_path()
    follower = PathFollower(path, TeachRepeatPolicy(path))
    faults: CameraFaults[tuple[int, View]] = CameraFaults(settings)
    x, driven = 0.0, []
    for k in range(ticks):
        now_ns = k * TICK
        for (stamp_ns, view), is_covered in faults.add(now_ns, (now_ns, pinhole_view(x / 0.2))):
            follower.observe(stamp_ns, (np.zeros_like(view[0]),) if is_covered else view)
        velocity = follower.tick(now_ns)
        if velocity.linear > 0.0:
            faults.move(now_ns)
        driven.append((x, follower.state))
        if follower.state == "finished":
            break
        x += 0.1 * velocity.linear
    return driven


def test_a_robot_whose_lens_is_covered_for_three_seconds_stops_at_once_and_arrives_afterwards() -> None:
    driven = _drive(FaultSettings(cover_after=2.0, cover=3.0))
    begin = next(k for k, (x, _) in enumerate(driven) if x > 0.0) - 1
    lost = [k for k, (_, state) in enumerate(driven) if k > begin and state in ("lost", "searching")]
    assert lost[0] == begin + 20, "it stops with the first covered image, 2 s after it moved"
    assert driven[lost[0]][0] == driven[begin + 50][0], "and stands until the lens is free"
    assert driven[-1][1] == "finished" and driven[-1][0] == pytest.approx(2.2, abs=0.15)


@pytest.mark.parametrize("settings", [FaultSettings(drop=0.5), FaultSettings(drop=0.5, delay=0.2)])
def test_a_robot_with_half_of_its_images_or_late_ones_never_stands_and_arrives(settings: FaultSettings) -> None:
    driven = _drive(settings)
    states = [state for _, state in driven]
    assert set(states[states.index("following") : -1]) == {"following"}
    assert states[-1] == "finished" and driven[-1][0] == pytest.approx(2.2, abs=0.25)


def test_a_robot_whose_images_are_later_than_is_allowed_stands() -> None:
    assert {state for _, state in _drive(FaultSettings(delay=0.6), 12)} == {"waiting", "stale"}
