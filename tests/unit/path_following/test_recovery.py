"""A blocked robot waits, backs up, spins to both sides, and after its attempts stops."""

from __future__ import annotations

import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.obstacles.recovery import Recovery, RecoverySettings
from gibson_path_following.types import STOP, Velocity

SETTINGS = RecoverySettings(wait_time=1.0, backup_time=1.0, backup_speed=0.1, spin_time=1.0, spin_rate=0.5, max_attempts=1)
BACK, LEFT, RIGHT = Velocity(-0.1, 0.0), Velocity(0.0, 0.5), Velocity(0.0, -0.5)


def velocities(recovery: Recovery, count: int, *, can_back_up: bool = True) -> list[Velocity]:
    return [recovery.on_blocked(2.0, 0.5, can_back_up=can_back_up) for _ in range(count)]


def test_robot_waits_backs_up_spins_to_both_sides_and_stops() -> None:
    # In 1 s there are two views: the first at 0.5 s, the second at 1.0 s begins what is next.
    found = velocities(Recovery(SETTINGS), 20)
    assert found == [STOP, BACK, BACK, LEFT, LEFT, RIGHT, RIGHT, RIGHT, RIGHT, LEFT, LEFT, *[STOP] * 9]


def test_robot_spins_without_backing_up_where_an_obstacle_is_behind_it() -> None:
    assert velocities(Recovery(SETTINGS), 9, can_back_up=False) == [STOP, LEFT, LEFT, RIGHT, RIGHT, RIGHT, RIGHT, LEFT, LEFT]


def test_robot_waits_anew_after_its_plan_was_free() -> None:
    recovery = Recovery(SETTINGS)
    assert velocities(recovery, 2) == [STOP, BACK]
    recovery.on_free(2.0)
    assert velocities(recovery, 2) == [STOP, BACK]


def test_robot_completes_the_backup_before_it_drives_on() -> None:
    recovery = Recovery(SETTINGS)
    found = []
    for _ in range(4):
        recovery.on_blocked(2.0, 0.5, can_back_up=True)
        found.append(recovery.is_backing_up)
    assert found == [False, True, True, False]


def test_robot_has_new_attempts_at_another_place_alone() -> None:
    recovery = Recovery(SETTINGS)
    velocities(recovery, 20)
    recovery.on_free(2.5)
    assert velocities(recovery, 3) == [STOP, STOP, STOP]
    recovery.on_free(3.5)
    assert velocities(recovery, 2) == [STOP, BACK]


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"max_attempts is -1, must be 0 to 1000"):
        RecoverySettings(max_attempts=-1)
