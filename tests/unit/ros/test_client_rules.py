"""What a client of a simulation keeps and awaits, by hand."""

from __future__ import annotations

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.ros.client.answers import AnswerRule, parse_rule
from gibson_sim.ros.client.collisions import CollisionLog


def test_a_tick_waits_for_the_answer_to_a_topic_that_it_published() -> None:
    rule = AnswerRule(parse_rule("/cmd_vel after scan"))
    assert rule.topic == "cmd_vel"
    rule.begin_tick(0, {"odom"})
    assert rule.is_answered
    rule.end_tick()
    rule.begin_tick(16_666_666, {"odom", "scan"})
    assert not rule.is_answered
    rule.receive()
    assert rule.is_answered
    assert rule.end_tick() == 1


def test_an_answer_may_come_before_the_client_knows_its_tick() -> None:
    rule = AnswerRule(parse_rule("cmd_vel after scan"))
    rule.begin_tick(0, {"scan"})
    rule.receive()
    rule.end_tick()
    rule.receive()
    rule.begin_tick(16_666_666, {"scan"})
    assert rule.is_answered


def test_a_rule_with_a_period_asks_once_in_each() -> None:
    rule = AnswerRule(parse_rule("cmd_vel every 0.05"))
    due = []
    for tick in range(7):  # 0, 16.7, 33.3, 50, 66.7, 83.3, 100 ms
        rule.begin_tick(tick * 10**9 // 60, ())
        due.append(not rule.is_answered)
        rule.receive()
        rule.end_tick()
    assert due == [True, False, False, True, False, False, True]


@pytest.mark.parametrize(
    "text", ["", "cmd_vel", "cmd_vel after", "cmd_vel every 0", "a=cmd_vel after scan", "cmd_vel after scan; b"]
)
def test_an_invalid_rule_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="answers is"):
        parse_rule(text)


def test_each_collision_is_noted_once_with_its_time() -> None:
    log = CollisionLog("robot")
    log.add(1.0, 0, ("", ""))
    log.add(2.0, 1, ("base", "wall"))
    log.add(3.0, 1, ("base", "wall"))
    log.add(4.0, 2, ("base", "wall"))
    assert [str(one) for one in log.collisions] == ["wall (base, at 2.00 s)", "wall (base, at 4.00 s)"]


def test_all_known_collisions_of_a_tick_are_noted() -> None:
    log = CollisionLog("robot")
    log.add(1.0, 2, ("base", "box"), [("base", "box"), ("base", "chair"), ("wheel", "floor")])
    assert [(one.link, one.body) for one in log.collisions] == [("base", "chair"), ("base", "box")]


def test_a_reset_restarts_the_count() -> None:
    log = CollisionLog("robot")
    log.add(1.0, 1, ("base", "wall"))
    log.clear()
    log.add(0.5, 1, ("base", "wall"))
    assert [one.time for one in log.collisions] == [0.5]
