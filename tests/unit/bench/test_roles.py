"""The roles that processes of the benchmarks run: those that are requested exist, and none waits for ever."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

import gibson_sim_bench.cli  # noqa: E402
from gibson_sim_bench.roles import waiting  # noqa: E402
from gibson_sim_bench.roles.__main__ import ROLES  # noqa: E402
from gibson_sim_bench.roles.lockstep import controller, one_process  # noqa: E402


def _requested(tree: ast.AST) -> set[str]:
    """Returns the names of roles, the second argument of the functions that start one."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    starts = [call.args[1] for call in calls if call.func.id in ("answer", "conversation", "role") and len(call.args) > 1]  # type: ignore[attr-defined]
    return {argument.value for argument in starts if isinstance(argument, ast.Constant)}


def test_every_role_that_a_command_starts_exists() -> None:
    folder = Path(str(gibson_sim_bench.cli.__file__)).parent
    requested = set().union(*(_requested(ast.parse(file.read_text())) for file in folder.glob("*.py")))
    assert {"ping", "pong", "controller", "soak_subscriber"} <= requested
    assert requested - set(ROLES) == set()
    assert (ROLES["controller"], ROLES["one_process"]) == (controller, one_process)


class _Waiter:
    """Spins without messages, and counts."""

    def __init__(self) -> None:
        self.spins = 0

    def spin_once(self, timeout_sec: float | None = None) -> None:
        self.spins += 1


def test_waiting_ends_with_the_condition(monkeypatch: pytest.MonkeyPatch) -> None:
    waiter: Any = _Waiter()
    waiting.wait_until(lambda: waiter.spins == 3, waiter)
    assert waiter.spins == 3


def test_waiting_is_given_up_only_without_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(waiting.time, "monotonic", lambda: now[0])

    class Slow(_Waiter):
        def spin_once(self, timeout_sec: float | None = None) -> None:
            super().spin_once(timeout_sec)
            now[0] += 40.0

    slow: Any = Slow()
    waiting.wait_until(lambda: slow.spins == 5, slow, progress=lambda: slow.spins)
    assert now[0] == 200.0, "longer than the patience, but something came each time"
    with pytest.raises(TimeoutError, match="nothing came within 60 s"):
        waiting.wait_until(lambda: False, slow)
