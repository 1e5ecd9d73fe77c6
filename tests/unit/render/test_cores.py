"""Threads of a software renderer are pinned to a core each, but only if there are at least as many as cores."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gibson_sim.render.context import cores


class Machine:
    """Tasks of a process, and the cores that it may use."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.usable, self.moved, self.gone = folder, {4, 6}, dict[int, set[int]](), set[int]()
        monkeypatch.setattr(cores, "_TASKS", folder)
        monkeypatch.setattr(os, "sched_getaffinity", lambda number: self.usable)
        monkeypatch.setattr(os, "sched_setaffinity", self._move)

    def add(self, number: int, name: str) -> None:
        (self.folder / str(number)).mkdir()
        (self.folder / str(number) / "comm").write_text(name + "\n")

    def _move(self, number: int, to: set[int]) -> None:
        if number in self.gone:
            raise ProcessLookupError(3, "No such process")
        self.moved[number] = to


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    found = Machine(tmp_path, monkeypatch)
    for number, name in ((100, "python"), (101, "llvmpipe-0"), (102, "llvmpipe-1"), (103, "llvmpipe-disk")):
        found.add(number, name)
    return found


def test_each_thread_is_pinned_to_a_usable_core_and_other_threads_are_not(machine: Machine) -> None:
    assert cores.spread_threads() == {101: 4, 102: 6}
    assert machine.moved == {101: {4}, 102: {6}}


def test_threads_of_a_second_renderer_share_the_cores_of_the_first(machine: Machine) -> None:
    machine.add(110, "llvmpipe-0")
    machine.add(111, "llvmpipe-1")
    assert cores.spread_threads() == {101: 4, 102: 6, 110: 4, 111: 6}


@pytest.mark.parametrize("usable", [{0}, {0, 1, 2}])
def test_threads_are_not_pinned_with_one_core_or_fewer_threads_than_cores(machine: Machine, usable: set[int]) -> None:
    machine.usable = usable
    assert cores.spread_threads() == {}
    assert machine.moved == {}


def test_a_thread_that_ends_meanwhile_does_not_keep_the_others_from_their_cores(machine: Machine) -> None:
    machine.gone = {101}
    (machine.folder / "120").mkdir()  # ended between the listing and the read of its name
    cores.spread_threads()
    assert machine.moved == {102: {6}}


def test_without_a_list_of_tasks_nothing_happens(machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores, "_TASKS", tmp_path / "none")
    assert cores.spread_threads() == {}
    assert machine.moved == {}
