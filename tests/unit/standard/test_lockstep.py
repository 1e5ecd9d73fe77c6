from __future__ import annotations

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.standard.lockstep import CAMERAS, Lockstep, ParticipantRule, parse_participants


def joined(*names: str) -> Lockstep:
    lockstep = Lockstep()
    for name in names:
        lockstep.join(name)
    return lockstep


def test_without_participants_it_is_always_open() -> None:
    lockstep = Lockstep()
    assert lockstep.is_open
    lockstep.begin_tick(10, (), 0)
    assert lockstep.is_open


def test_a_tick_ends_when_all_participants_have_done_it() -> None:
    lockstep = joined("a", "b")
    lockstep.begin_tick(10, (), 0)
    assert not lockstep.is_open
    assert lockstep.tick_done("a", 10, (), 1)
    assert lockstep.waits_for == ("b",)
    assert lockstep.tick_done("b", 10, (), 2)
    assert lockstep.is_open


def test_only_the_present_tick_can_be_done() -> None:
    lockstep = joined("a")
    lockstep.begin_tick(10, (), 0)
    assert not lockstep.tick_done("a", 9, (), 1)
    assert not lockstep.tick_done("stranger", 10, (), 1)
    assert lockstep.waits_for == ("a",)


def test_commands_on_their_way_hold_the_tick_in_either_order() -> None:
    lockstep = joined("a")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("a", 10, ["cmd_vel", "cmd_vel"], 1)
    lockstep.receive_command("cmd_vel", 2)
    assert not lockstep.is_open
    lockstep.receive_command("cmd_vel", 3)
    assert lockstep.is_open
    lockstep.begin_tick(20, (), 4)
    lockstep.receive_command("cmd_vel", 5)
    lockstep.tick_done("a", 20, ["cmd_vel"], 6)
    assert lockstep.is_open


def test_a_command_of_the_tick_before_does_not_count() -> None:
    lockstep = joined("a")
    lockstep.receive_command("cmd_vel", 0)
    lockstep.begin_tick(10, (), 1)
    lockstep.tick_done("a", 10, ["cmd_vel"], 2)
    assert not lockstep.is_open


def test_commands_of_two_participants_on_one_topic_are_counted_together() -> None:
    lockstep = joined("a", "b")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("a", 10, ["cmd_vel"], 1)
    lockstep.tick_done("b", 10, ["cmd_vel"], 1)
    lockstep.receive_command("cmd_vel", 2)
    assert not lockstep.is_open
    lockstep.receive_command("cmd_vel", 3)
    assert lockstep.is_open


def test_ticks_wait_for_renderers_only_when_a_camera_is_due() -> None:
    lockstep = Lockstep()
    lockstep.join("render", CAMERAS)
    assert lockstep.topics == {CAMERAS}
    lockstep.begin_tick(10, (), 0)
    assert lockstep.is_open
    lockstep.begin_tick(20, {CAMERAS}, 1)
    assert lockstep.waits_for == ("render",)


def test_time_does_not_start_before_declared_participants_have_joined() -> None:
    lockstep = Lockstep(parse_participants("render; controller"))
    assert lockstep.missing == ("controller", "render")
    lockstep.join("render")
    assert not lockstep.is_open
    lockstep.join("controller")
    assert lockstep.is_open


def test_a_participant_by_rule_answers_with_its_command() -> None:
    lockstep = Lockstep(parse_participants("follow=cmd_vel after odom"))
    assert lockstep.is_open, "a participant by rule does not join"
    lockstep.begin_tick(10, {"scan"}, 0)
    assert lockstep.is_open, "it does not concern it"
    lockstep.begin_tick(20, {"odom"}, 1)
    assert lockstep.waits_for == ("follow",)
    lockstep.receive_command("cmd_vel", 2)
    assert lockstep.is_open


def test_a_participant_by_rule_with_a_period_answers_once_in_it() -> None:
    lockstep = Lockstep([ParticipantRule("nav", "cmd_vel", every_s=0.05)])
    waited = []
    for tick in range(1, 13):
        lockstep.begin_tick(tick * 10_000_000, (), 0)
        if not lockstep.is_open:
            waited.append(tick)
            lockstep.receive_command("cmd_vel", 0)
    assert waited == [1, 5, 10]


def test_a_participant_that_rejoined_needs_the_tick_again() -> None:
    lockstep = joined("render")
    lockstep.begin_tick(10, (), 0)
    assert lockstep.join("render"), "the tick waits for it"
    lockstep.tick_done("render", 10, (), 1)
    assert not lockstep.join("render"), "between ticks there is nothing to repeat"


def test_a_tick_does_not_wait_for_a_participant_that_left() -> None:
    lockstep = joined("a", "b")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("b", 10, (), 1)
    lockstep.leave("a", 2)
    assert lockstep.is_open


def test_skipping_late_participants_names_and_counts_them() -> None:
    lockstep = joined("a", "b")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("a", 10, (), 1)
    assert lockstep.skip_late(2) == ("b",)
    assert lockstep.is_open
    assert {p.name: p.missed for p in lockstep.participants} == {"a": 0, "b": 1}


def test_a_reset_forgets_the_present_tick() -> None:
    lockstep = joined("a")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("a", 10, ["cmd_vel"], 0)
    lockstep.reset()
    assert lockstep.is_open
    lockstep.begin_tick(10, (), 1)
    lockstep.tick_done("a", 10, (), 2)
    assert lockstep.is_open


def test_waiting_times_are_counted_for_each_participant() -> None:
    lockstep = joined("quick", "slow")
    lockstep.begin_tick(10, (), 100)
    lockstep.tick_done("quick", 10, (), 103)
    lockstep.tick_done("slow", 10, (), 140)
    assert {p.name: (p.ticks, p.waited_ns, p.longest_ns) for p in lockstep.participants} == {
        "quick": (1, 3, 3),
        "slow": (1, 40, 40),
    }


@pytest.mark.parametrize(
    "text", ["a b", "follow=", "follow=cmd_vel", "n=cmd_vel every 0", "n=cmd_vel every 1.2.3", "a=b after", "=x"]
)
def test_what_is_no_rule_is_refused_with_the_form_that_is_allowed(text: str) -> None:
    with pytest.raises(ConfigError, match="cmd_vel after odom"):
        parse_participants(text)


def test_a_name_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match="'a' twice"):
        parse_participants("a; a=cmd_vel after odom")
