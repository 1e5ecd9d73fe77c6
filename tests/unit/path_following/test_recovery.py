"""A blocked robot waits, backs off, looks to both sides, and at last stops."""

from __future__ import annotations

import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.recovery import Recovery, RecoverySettings
from gibson_path_following.types import STOP, Velocity

SETTINGS = RecoverySettings(wait=1.0, back_time=1.0, back_speed=0.1, look_time=1.0, look_rate=0.5, tries=1)
BACK, LEFT, RIGHT = Velocity(-0.1, 0.0), Velocity(0.0, 0.5), Velocity(0.0, -0.5)


def acts(recovery: Recovery, count: int, *, can_back: bool = True) -> list[Velocity]:
    return [recovery.blocked(2.0, 0.5, can_back=can_back) for _ in range(count)]


def test_robot_waits_backs_off_looks_to_both_sides_and_stops() -> None:
    # In 1 s there are two views: the first at 0.5 s, the second at 1.0 s begins what is next.
    found = acts(Recovery(SETTINGS), 20)
    assert found == [STOP, BACK, BACK, LEFT, LEFT, RIGHT, RIGHT, RIGHT, RIGHT, LEFT, LEFT, *[STOP] * 9]


def test_robot_looks_at_once_where_something_stands_behind_it() -> None:
    assert acts(Recovery(SETTINGS), 9, can_back=False) == [STOP, LEFT, LEFT, RIGHT, RIGHT, RIGHT, RIGHT, LEFT, LEFT]


def test_robot_waits_anew_when_it_was_free_in_between() -> None:
    recovery = Recovery(SETTINGS)
    assert acts(recovery, 2) == [STOP, BACK]
    recovery.free(2.0)
    assert acts(recovery, 2) == [STOP, BACK]


def test_robot_ends_backing_off_before_it_drives_on() -> None:
    recovery = Recovery(SETTINGS)
    found = []
    for _ in range(4):
        recovery.blocked(2.0, 0.5, can_back=True)
        found.append(recovery.is_backing)
    assert found == [False, True, True, False]


def test_robot_tries_again_at_another_place_alone() -> None:
    recovery = Recovery(SETTINGS)
    acts(recovery, 20)
    recovery.free(2.5)
    assert acts(recovery, 3) == [STOP, STOP, STOP]
    recovery.free(3.5)
    assert acts(recovery, 2) == [STOP, BACK]


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"tries is -1, must be 0 to 1000"):
        RecoverySettings(tries=-1)
