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


def test_a_lost_first_command_is_given_up_and_later_ones_are_awaited() -> None:
    lockstep = joined("a")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("a", 10, ("cmd_vel",), 1)
    assert (lockstep.lose_first_commands(100, 100), lockstep.is_open) == ((), False)
    assert (lockstep.lose_first_commands(101, 100), lockstep.is_open) == ((("a", "cmd_vel"),), True)
    lockstep.begin_tick(20, (), 200)
    lockstep.tick_done("a", 20, ("cmd_vel",), 201)
    lockstep.receive("cmd_vel", 202)
    assert lockstep.is_open
    lockstep.begin_tick(30, (), 300)
    lockstep.tick_done("a", 30, ("cmd_vel",), 301)
    assert (lockstep.lose_first_commands(1000, 100), lockstep.is_open) == ((), False), "it is on its way: others arrived"


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
    lockstep.receive("cmd_vel", 2)
    assert not lockstep.is_open
    lockstep.receive("cmd_vel", 3)
    assert lockstep.is_open
    lockstep.begin_tick(20, (), 4)
    lockstep.receive("cmd_vel", 5)
    lockstep.tick_done("a", 20, ["cmd_vel"], 6)
    assert lockstep.is_open


def test_a_command_of_the_tick_before_does_not_count() -> None:
    lockstep = joined("a")
    lockstep.receive("cmd_vel", 0)
    lockstep.begin_tick(10, (), 1)
    lockstep.tick_done("a", 10, ["cmd_vel"], 2)
    assert not lockstep.is_open


def test_commands_of_two_participants_on_one_topic_are_counted_together() -> None:
    lockstep = joined("a", "b")
    lockstep.begin_tick(10, (), 0)
    lockstep.tick_done("a", 10, ["cmd_vel"], 1)
    lockstep.tick_done("b", 10, ["cmd_vel"], 1)
    lockstep.receive("cmd_vel", 2)
    assert not lockstep.is_open
    lockstep.receive("cmd_vel", 3)
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
    lockstep.receive("cmd_vel", 2)
    assert lockstep.is_open


def test_a_participant_by_rule_with_a_period_answers_once_in_it() -> None:
    lockstep = Lockstep([ParticipantRule("nav", "cmd_vel", every_s=0.05)])
    waited = []
    for tick in range(1, 13):
        lockstep.begin_tick(tick * 10_000_000, (), 0)
        if not lockstep.is_open:
            waited.append(tick)
            lockstep.receive("cmd_vel", 0)
    assert waited == [5, 10], "a timer that began at time 0 wakes then"


def nav(rule: str = "cmd_vel every 0.05 from goal_pose") -> Lockstep:
    return Lockstep(parse_participants(f"nav={rule}"))


MS = 1_000_000


def ticks_that_wait(lockstep: Lockstep, stamps_ms: range) -> list[int]:
    """Returns the ticks that waited, milliseconds; each is answered at once."""
    waited = []
    for stamp_ms in stamps_ms:
        lockstep.begin_tick(stamp_ms * MS, {"scan"}, 0)
        if not lockstep.is_open:
            waited.append(stamp_ms)
            lockstep.receive("cmd_vel", 0)
    return waited


def test_a_message_between_waiting_ticks_restarts_the_period() -> None:
    lockstep = nav("cmd_vel every 0.05")
    assert ticks_that_wait(lockstep, range(10, 61, 10)) == [50]
    lockstep.receive("cmd_vel", 0)  # after the tick at 60 ms: the node wakes at another time than time 0 would suggest
    assert ticks_that_wait(lockstep, range(70, 181, 10)) == [110, 160]


def test_the_period_of_a_tick_that_went_on_without_an_answer_begins_at_it() -> None:
    lockstep = nav("cmd_vel every 0.05")
    lockstep.begin_tick(50 * MS, (), 0)
    assert lockstep.skip_late(1) == ("nav",)
    assert ticks_that_wait(lockstep, range(60, 111, 10)) == [100]


def test_after_a_reset_periods_begin_as_at_the_start() -> None:
    lockstep = nav("cmd_vel every 0.05")
    assert ticks_that_wait(lockstep, range(10, 1001, 10))[-1] == 1000
    lockstep.reset()
    assert ticks_that_wait(lockstep, range(10, 61, 10)) == [50]


def test_ticks_wait_from_a_message_on_the_topic_of_from_on() -> None:
    lockstep = nav()
    assert lockstep.received_topics == {"cmd_vel", "goal_pose"}
    assert ticks_that_wait(lockstep, range(10, 101, 10)) == []
    assert lockstep.any_idle
    assert lockstep.receive("goal_pose", 0) == ()
    assert not lockstep.any_idle
    assert ticks_that_wait(lockstep, range(110, 201, 10)) == [150, 200], "a period after the tick at which the goal came"


def test_a_goal_before_the_first_tick_counts_from_time_0() -> None:
    lockstep = nav()
    lockstep.receive("goal_pose", 0)
    assert ticks_that_wait(lockstep, range(10, 101, 10)) == [50, 100]


def test_an_answer_after_each_scan_from_the_initial_pose_on() -> None:
    lockstep = nav("pose after scan from initialpose")
    lockstep.begin_tick(10, {"scan"}, 0)
    assert lockstep.is_open
    lockstep.receive("initialpose", 1)
    assert lockstep.is_open
    lockstep.begin_tick(20, {"odom"}, 2)
    assert lockstep.is_open, "it does not concern it"
    lockstep.begin_tick(30, {"scan"}, 3)
    assert lockstep.waits_for == ("nav",)
    lockstep.receive("pose", 4)
    assert lockstep.is_open


def test_a_silent_participant_that_has_answered_rests_until_its_next_goal() -> None:
    lockstep = nav()
    lockstep.receive("goal_pose", 0)
    assert ticks_that_wait(lockstep, range(10, 61, 10)) == [50]
    lockstep.begin_tick(100 * MS, (), 1000)
    assert lockstep.idle_silent(1000 + 5, 5) == ()
    assert lockstep.idle_silent(1000 + 6, 5) == ("nav",)
    assert lockstep.is_open
    assert lockstep.participants[0].missed == 0, "nothing is missing: it is idle"
    assert ticks_that_wait(lockstep, range(110, 401, 10)) == []
    assert lockstep.receive("goal_pose", 0) == ()
    assert ticks_that_wait(lockstep, range(410, 501, 10)) == [450, 500]


def test_a_participant_that_has_never_answered_has_twice_the_time() -> None:
    lockstep = nav()
    lockstep.receive("goal_pose", 0)
    lockstep.begin_tick(50 * MS, (), 1000)
    assert lockstep.idle_silent(1000 + 10, 5) == ()
    assert lockstep.idle_silent(1000 + 11, 5) == ("nav",)


def test_a_participant_without_from_never_rests() -> None:
    lockstep = nav("cmd_vel every 0.05")
    lockstep.begin_tick(50 * MS, (), 0)
    assert lockstep.idle_silent(10**12, 5) == ()
    assert not lockstep.is_open


def test_a_participant_that_answers_while_it_rests_is_reported_as_slow() -> None:
    lockstep = nav()
    lockstep.receive("goal_pose", 0)
    assert ticks_that_wait(lockstep, range(10, 61, 10)) == [50]
    lockstep.begin_tick(100 * MS, (), 0)
    lockstep.idle_silent(6, 5)
    lockstep.begin_tick(110 * MS, (), 0)
    assert lockstep.receive("cmd_vel", 0) == ("nav",)
    assert ticks_that_wait(lockstep, range(120, 211, 10)) == [160, 210]


def test_a_participant_that_begins_with_its_own_first_message_is_not_reported_as_slow() -> None:
    lockstep = nav("cmd_vel every 0.05 from cmd_vel")
    assert ticks_that_wait(lockstep, range(10, 101, 10)) == []
    assert lockstep.receive("cmd_vel", 0) == ()
    assert ticks_that_wait(lockstep, range(110, 201, 10)) == [150, 200]


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("a=/robot_1/pose after robot_1/scan", ParticipantRule("a", "/robot_1/pose", "robot_1/scan")),
        ("n = cmd_vel every 0.05s from goal_pose", ParticipantRule("n", "cmd_vel", "", 0.05, "goal_pose")),
        ("n=map every 5 from map", ParticipantRule("n", "map", "", 5.0, "map")),
        ("d=detections after camera/image_raw", ParticipantRule("d", "detections", "camera/image_raw")),
    ],
)
def test_a_rule_is_read_with_its_names_as_they_are_written(text: str, rule: ParticipantRule) -> None:
    assert parse_participants(text) == (rule,)


def test_names_of_a_rule_are_resolved_but_for_cameras() -> None:
    rule = ParticipantRule("a", "pose", CAMERAS, activation="/goal").resolved(
        lambda name: f"ns/{name}" if name[0] != "/" else name[1:]
    )
    assert rule == ParticipantRule("a", "ns/pose", CAMERAS, activation="goal")


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
    "text",
    [
        "a b",
        "follow=",
        "follow=cmd_vel",
        "n=cmd_vel every 0",
        "n=cmd_vel every 1.2.3",
        "a=b after",
        "=x",
        "n=b every 1e3",
        "n=b every 4000",
        "n=b every 0.0001",
        "n=b every 1 from",
        "n=b from c",
        "n from c",
        "n=9lives after c",
        "n=a//b after c",
        "n=a/ after c",
        "n=b after c every 1",
    ],
)
def test_an_invalid_rule_is_refused_with_the_allowed_form(text: str) -> None:
    with pytest.raises(ConfigError, match="cmd_vel after odom"):
        parse_participants(text)


def test_a_duplicate_name_is_refused() -> None:
    with pytest.raises(ConfigError, match="'a' twice"):
        parse_participants("a; a=cmd_vel after odom")
