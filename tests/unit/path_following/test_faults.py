"""A camera with faults: which images go out, when, and which of them are covered."""

from __future__ import annotations

import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.faults import CameraFaults, FaultSettings

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


def test_what_was_late_is_forgotten_when_time_goes_back() -> None:
    faults: CameraFaults[str] = CameraFaults(FaultSettings(delay=0.2))
    assert faults.add(5 * TICK, "before") == []
    assert faults.add(0, "after") == []
    assert faults.add(2 * TICK, "later") == [("after", False)]


@pytest.mark.parametrize("values", [{"drop": 1.5}, {"delay": -1.0}, {"cover": float("nan")}])
def test_faults_that_cannot_be_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(SettingError, match="must be 0 to"):
        FaultSettings(**values)
