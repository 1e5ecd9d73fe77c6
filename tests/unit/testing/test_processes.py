"""Programs of a test, and the domains of its simulations."""

from __future__ import annotations

import itertools
import os
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.processes.domain_lock import DomainLock, domains_in_use
from gibson_sim.testing import processes
from gibson_sim.testing.processes import Program, free_domains, variables_set
from support.simulation import wait_until

Start = Callable[..., Program]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts a program in Python, which is ended after the test."""
    programs: list[Program] = []

    def begin(source: str, **options: bool) -> Program:
        programs.append(Program([sys.executable, "-c", source], os.environ, tmp_path, **options))
        return programs[-1]

    yield begin
    for program in programs:
        program.stop()


def test_a_program_that_fails_is_named_with_its_last_line(start: Start) -> None:
    program = start("print('one'); raise SystemExit('no map')")
    wait_until(lambda: program.returncode is not None, "end of the program")
    with pytest.raises(GibsonSimError, match="ended with code 1: no map"):
        program.check()
    assert program.output == "one\nno map\n"


def test_a_program_may_end_well_or_be_allowed_to_fail(start: Start) -> None:
    good, allowed = start("pass"), start("raise SystemExit(3)", may_fail=True)
    wait_until(lambda: good.returncode is not None and allowed.returncode is not None, "end of both")
    assert (good.returncode, allowed.returncode) == (0, 3)
    good.check()
    allowed.check()


def test_the_output_of_a_stopped_program_can_still_be_read(start: Start) -> None:
    program = start("import time; print('here', flush=True); time.sleep(1000)")
    wait_until(lambda: program.output == "here\n", "its output")
    program.stop()
    assert program.output.startswith("here\n")
    assert program.returncode is not None


@pytest.mark.parametrize("command", ["ros2 run a b", [], [1]])
def test_a_command_is_a_list_of_words(command: object, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="must be a list"):
        Program(command, {}, tmp_path)  # type: ignore[arg-type]


def test_a_domain_with_a_simulation_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "domains_in_use", set)  # those above 101 have ports that any program may use
    lock = DomainLock(211)
    try:
        found = free_domains("210-212", 1)  # begins with 211
        assert [next(found), next(found)] == [212, 210]
        with pytest.raises(ConfigError, match="a simulation runs in each"):
            next(found)
    finally:
        lock.close()


@pytest.mark.parametrize(("family", "address"), [(socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")])
def test_a_domain_with_nodes_is_used_last(family: int, address: str) -> None:
    """A stack of another user talks there: a simulation of a test would drive its robot."""
    begin = next(free_domains("0-50", os.getpid()))
    with socket.socket(family, socket.SOCK_DGRAM) as participant:
        participant.bind((address, 7400 + 250 * begin + 249))
        found = list(itertools.islice(free_domains("0-50", begin), 51 - len(domains_in_use() & set(range(51)))))
    assert begin not in found and found[0] == next(free_domains("0-50", begin + 1))
    assert list(itertools.islice(free_domains(str(begin), 0), 1)) == [begin]


@pytest.mark.parametrize("text", ["", "a", "5-3", "200-232", "-3"])
def test_domains_are_a_range(text: str) -> None:
    with pytest.raises(ConfigError, match="must be a range"):
        next(free_domains(text, 0))


def test_variables_are_as_before_after_a_test(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("MINE", "x")
    before = dict(os.environ)
    with variables_set({"PATH": os.environ["PATH"], "ROS_DOMAIN_ID": "8", "NEW": "1", "GIBSON_SIM_PARENT_PID": "1"}):
        assert (os.environ["ROS_DOMAIN_ID"], os.environ["NEW"]) == ("8", "1")
        assert "MINE" not in os.environ
        assert "GIBSON_SIM_PARENT_PID" not in os.environ
    assert dict(os.environ) == before
