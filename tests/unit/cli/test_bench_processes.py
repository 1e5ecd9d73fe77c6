"""Measured processes: their answers, and the errors without one."""

from __future__ import annotations

import sys

import pytest

from gibson_sim_bench.cli import processes as module
from gibson_sim_bench.cli.processes import BenchError, conversation

ADDER = "import sys, json; [print(json.dumps({'sum': sum(json.loads(line)['numbers'])}), flush=True) for line in sys.stdin]"


@pytest.fixture
def plays(monkeypatch: pytest.MonkeyPatch):
    """Returns a function that replaces every role by a piece of Python."""

    def play(program: str) -> None:
        monkeypatch.setattr(module, "_command", lambda role, options: [sys.executable, "-c", program])

    return play


def test_every_request_gets_its_answer(plays) -> None:
    plays(ADDER)
    with conversation({}, "adder", 30.0) as ask:
        assert ask({"numbers": [1, 2]}) == {"sum": 3}
        assert ask({"numbers": [3, 4, 5]}) == {"sum": 12}


def test_a_process_that_ends_is_named_with_its_last_output(plays) -> None:
    plays("import sys; sys.stdin.readline(); sys.exit('error: adder: nothing came within 60 s')")
    with (
        conversation({}, "adder", 30.0) as ask,
        pytest.raises(BenchError, match="the adder process ended with code 1: error: adder: nothing came"),
    ):
        ask({"numbers": [1]})


def test_a_request_to_an_ended_process_is_the_same_error(plays) -> None:
    plays("import sys; sys.exit('error: adder: no such topic')")
    with conversation({}, "adder", 30.0) as ask:
        for _ in range(2):
            with pytest.raises(BenchError, match=r"ended with code 1: error: adder: no such topic"):
                ask({"numbers": [1] * 100_000})


def test_a_silent_process_times_out_and_is_ended(plays, monkeypatch: pytest.MonkeyPatch) -> None:
    plays("import sys, time; [time.sleep(600) for line in sys.stdin]")
    monkeypatch.setattr(module, "PATIENCE_S", 0.2)
    with conversation({}, "adder", 0.1) as ask, pytest.raises(BenchError, match="the adder process was still at it after 0 s"):
        ask({"numbers": [1]})
