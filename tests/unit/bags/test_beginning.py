"""With which message a recording begins: free, in lockstep from the start, and in lockstep when time was running already."""

from __future__ import annotations

import struct

from gibson_sim.bags.recording import Beginning

S = 10**9


def _clock(seconds: float) -> tuple[str, bytes]:
    return "/clock", b"\x00\x01\x00\x00" + struct.pack("<iI", *divmod(round(seconds * S), S))


def _beginning() -> Beginning:
    return Beginning({"/room"}.__contains__)


def test_opened_nothing_is_left_out() -> None:
    beginning = _beginning()
    assert beginning.let_through([("/a", b"0"), _clock(7.0), ("/a", b"1")]) == []
    beginning.open()
    assert beginning.let_through([("/a", b"2")]) == [("/a", b"0"), _clock(7.0), ("/a", b"1"), ("/a", b"2")]
    assert beginning.let_through([("/a", b"3")]) == [("/a", b"3")]


def test_one_that_came_late_begins_with_the_clock_after_all_is_heard() -> None:
    beginning = _beginning()
    assert beginning.let_through([("/room", b"walls"), ("/a", b"0"), _clock(7.0), ("/a", b"1")]) == []
    beginning.leave_out()
    assert beginning.let_through([_clock(7.1), ("/a", b"2"), ("/room", b"doors")]) == []
    beginning.begin_with_clock()
    assert beginning.let_through([("/image", b"of 7.1 s")]) == []
    assert not beginning.is_open
    found = beginning.let_through([("/a", b"3"), _clock(7.2), ("/a", b"4")])
    assert found == [("/room", b"walls"), ("/room", b"doors"), _clock(7.2), ("/a", b"4")]
    assert beginning.is_open


def test_where_time_stands_it_begins_when_time_goes_on() -> None:
    beginning = _beginning()
    beginning.let_through([("/room", b"walls")])
    beginning.begin_with_clock()
    assert beginning.let_through([("/image", b"once more")]) == []
    assert beginning.let_through([_clock(0.1125), ("/a", b"0")]) == [("/room", b"walls"), _clock(0.1125), ("/a", b"0")]


def test_late_is_who_hears_of_time_when_it_is_running() -> None:
    beginning = _beginning()
    assert (beginning.has_clock, beginning.is_late) == (False, False)
    for first, late in ((0.0, False), (0.01, True)):
        beginning = _beginning()
        beginning.let_through([_clock(first), _clock(8.0)])
        assert (beginning.has_clock, beginning.is_late) == (True, late)


def test_asked_for_what_there_is_it_begins_at_once() -> None:
    beginning = _beginning()
    beginning.leave_out()
    beginning.let_through([_clock(7.0), ("/a", b"0"), ("/room", b"walls")])
    beginning.open()
    assert beginning.let_through([("/a", b"1")]) == [("/room", b"walls"), ("/a", b"1")]
