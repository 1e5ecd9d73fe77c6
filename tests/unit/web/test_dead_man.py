"""The page that drives, and when the robot stops. Times are seconds."""

from __future__ import annotations

from gibson_sim.web.dead_man import DEADLINE_S, STANDING, STOPS, DeadMan
from gibson_sim.web.requests import Drive

FORWARD = Drive(0.5, 0.0, 0.0)


def test_a_command_holds_until_its_deadline_and_then_the_robot_is_stopped() -> None:
    rule = DeadMan()
    assert rule.due(0.0) is None
    assert rule.drive("page", FORWARD, 10.0)
    assert rule.due(10.0) == rule.due(10.0 + 0.99 * DEADLINE_S) == FORWARD
    assert [rule.due(10.0 + DEADLINE_S + k) for k in range(STOPS)] == [STANDING] * STOPS
    assert rule.due(20.0) is None  # others may drive again


def test_a_page_that_lets_go_or_is_lost_stops_the_robot_at_once() -> None:
    for end in (lambda rule: rule.drive("page", STANDING, 10.01), lambda rule: rule.release("page")):
        rule = DeadMan()
        rule.drive("page", FORWARD, 10.0)
        end(rule)
        assert rule.due(10.02) == STANDING


def test_the_page_that_drives_keeps_the_robot() -> None:
    rule = DeadMan()
    rule.drive("one", FORWARD, 10.0)
    assert not rule.drive("two", Drive(-1.0, 0.0, 0.0), 10.1)
    rule.release("two")
    assert rule.due(10.1) == FORWARD
    assert rule.drive("two", Drive(-1.0, 0.0, 0.0), 10.0 + DEADLINE_S)


def test_a_page_that_commands_standstill_sends_nothing() -> None:
    rule = DeadMan()
    assert rule.drive("page", STANDING, 0.0)
    assert rule.due(0.0) is None
