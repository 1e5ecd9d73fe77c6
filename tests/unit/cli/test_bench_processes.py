"""Child processes of the benchmarks: their responses, and the errors without one."""

from __future__ import annotations

import sys

import pytest

from gibson_sim_bench.cli import processes as module
from gibson_sim_bench.cli.processes import BenchError, node_session

ADDER = "import sys, json; [print(json.dumps({'sum': sum(json.loads(line)['numbers'])}), flush=True) for line in sys.stdin]"


@pytest.fixture
def plays(monkeypatch: pytest.MonkeyPatch):
    """Returns a function that replaces every node by a Python program."""

    def play(program: str) -> None:
        monkeypatch.setattr(module, "_command", lambda node, options: [sys.executable, "-c", program])

    return play


def test_every_request_gets_its_response(plays) -> None:
    plays(ADDER)
    with node_session({}, "adder", 30.0) as send:
        assert send({"numbers": [1, 2]}) == {"sum": 3}
        assert send({"numbers": [3, 4, 5]}) == {"sum": 12}


def test_a_process_that_ends_is_named_with_its_last_output(plays) -> None:
    plays("import sys; sys.stdin.readline(); sys.exit('error: adder: no message within 60 s')")
    with (
        node_session({}, "adder", 30.0) as send,
        pytest.raises(BenchError, match="the adder process ended with code 1: error: adder: no message"),
    ):
        send({"numbers": [1]})


def test_a_request_to_an_ended_process_is_the_same_error(plays) -> None:
    plays("import sys; sys.exit('error: adder: no such topic')")
    with node_session({}, "adder", 30.0) as send:
        for _ in range(2):
            with pytest.raises(BenchError, match=r"ended with code 1: error: adder: no such topic"):
                send({"numbers": [1] * 100_000})


def test_a_silent_process_times_out_and_is_ended(plays, monkeypatch: pytest.MonkeyPatch) -> None:
    plays("import sys, time; [time.sleep(600) for line in sys.stdin]")
    monkeypatch.setattr(module, "TIMEOUT_S", 0.2)
    with node_session({}, "adder", 0.1) as send, pytest.raises(BenchError, match="the adder process still ran after 0 s"):
        send({"numbers": [1]})
