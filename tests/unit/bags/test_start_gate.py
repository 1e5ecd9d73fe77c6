"""The first recorded message: free-running, in lockstep from the start, and in lockstep while time is running."""

from __future__ import annotations

import struct

from gibson_sim.bags.recording import StartGate

S = 10**9


def _clock(seconds: float) -> tuple[str, bytes]:
    return "/clock", b"\x00\x01\x00\x00" + struct.pack("<iI", *divmod(round(seconds * S), S))


def _gate() -> StartGate:
    return StartGate({"/room"}.__contains__)


def test_open_gate_discards_nothing() -> None:
    gate = _gate()
    assert gate.release([("/a", b"0"), _clock(7.0), ("/a", b"1")]) == []
    gate.open()
    assert gate.release([("/a", b"2")]) == [("/a", b"0"), _clock(7.0), ("/a", b"1"), ("/a", b"2")]
    assert gate.release([("/a", b"3")]) == [("/a", b"3")]


def test_late_recorder_starts_with_the_clock_after_all_publishers_are_matched() -> None:
    gate = _gate()
    assert gate.release([("/room", b"walls"), ("/a", b"0"), _clock(7.0), ("/a", b"1")]) == []
    gate.discard()
    assert gate.release([_clock(7.1), ("/a", b"2"), ("/room", b"doors")]) == []
    gate.open_at_next_clock()
    assert gate.release([("/image", b"of 7.1 s")]) == []
    assert not gate.is_open
    found = gate.release([("/a", b"3"), _clock(7.2), ("/a", b"4")])
    assert found == [("/room", b"walls"), ("/room", b"doors"), _clock(7.2), ("/a", b"4")]
    assert gate.is_open


def test_in_a_paused_simulation_it_starts_when_time_continues() -> None:
    gate = _gate()
    gate.release([("/room", b"walls")])
    gate.open_at_next_clock()
    assert gate.release([("/image", b"once more")]) == []
    assert gate.release([_clock(0.1125), ("/a", b"0")]) == [("/room", b"walls"), _clock(0.1125), ("/a", b"0")]


def test_gate_is_late_if_the_first_clock_is_not_zero() -> None:
    gate = _gate()
    assert (gate.has_clock, gate.is_late) == (False, False)
    for first, late in ((0.0, False), (0.01, True)):
        gate = _gate()
        gate.release([_clock(first), _clock(8.0)])
        assert (gate.has_clock, gate.is_late) == (True, late)


def test_opened_after_discarding_it_starts_at_once() -> None:
    gate = _gate()
    gate.discard()
    gate.release([_clock(7.0), ("/a", b"0"), ("/room", b"walls")])
    gate.open()
    assert gate.release([("/a", b"1")]) == [("/room", b"walls"), ("/a", b"1")]
