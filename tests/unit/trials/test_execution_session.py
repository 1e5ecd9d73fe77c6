"""Stacks that are started before their run, without processes: which session a run gets."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import ClassVar

import pytest

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.trials.execution import session
from gibson_sim.trials.execution.session import SessionPool
from gibson_sim.trials.scenario.spec import StackSpec

STACK, OTHER = StackSpec(("mine",)), StackSpec(("yours",))
DOMAINS = (7, 8)


class Session:
    """A session without processes."""

    made: ClassVar[list[Session]] = []

    def __init__(self, stack: StackSpec, domains: Sequence[int]) -> None:
        if not domains:
            raise AlreadyRunningError("a simulation runs in each of the ROS domains")
        self.stack, self.has_stack, self.closed = stack, False, False
        self.server = SimpleNamespace(poll=lambda: None)
        self.made.append(self)

    def start_stack(self) -> None:
        self.has_stack = True

    def fits(self, stack: StackSpec, domains: Sequence[int]) -> bool:
        return stack == self.stack

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> SessionPool:
    monkeypatch.setattr(session, "Session", Session)
    monkeypatch.setattr(Session, "made", [])
    return SessionPool()


def test_run_gets_the_stack_that_was_started_for_it_and_no_other_run_does(pool: SessionPool) -> None:
    pool.prepare(STACK, DOMAINS)
    first, second = pool.acquire_fresh(STACK, DOMAINS), pool.acquire_fresh(STACK, DOMAINS)
    assert first is Session.made[0] and first.has_stack
    assert second is Session.made[1] and not second.has_stack


def test_stack_that_ended_before_its_run_is_started_with_the_run(pool: SessionPool) -> None:
    pool.prepare(STACK, DOMAINS)
    Session.made[0].has_stack = False
    found = pool.acquire_fresh(STACK, DOMAINS)
    assert found is Session.made[1] and not found.has_stack
    assert Session.made[0].closed


def test_stack_of_another_scenario_is_ended(pool: SessionPool) -> None:
    pool.prepare(OTHER, DOMAINS)
    assert pool.acquire_fresh(STACK, DOMAINS) is Session.made[1]
    assert Session.made[0].closed


def test_stack_without_a_free_domain_is_not_started(pool: SessionPool) -> None:
    pool.prepare(STACK, ())
    assert pool.prepared == ()


def test_stacks_that_wait_for_a_run_end_with_the_pool(pool: SessionPool) -> None:
    pool.prepare(STACK, DOMAINS)
    pool.close()
    assert Session.made[0].closed and pool.prepared == ()
