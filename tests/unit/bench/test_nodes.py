"""The nodes that the benchmarks run: those that a command starts exist, and none waits for ever."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

import gibson_sim_bench.cli  # noqa: E402
from gibson_sim_bench.nodes import spinning  # noqa: E402
from gibson_sim_bench.nodes.__main__ import NODES  # noqa: E402
from gibson_sim_bench.nodes.lockstep import controller, one_process  # noqa: E402


def _requested(tree: ast.AST) -> set[str]:
    """Returns the names of nodes, the second argument of the functions that start one."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    starts = [
        call.args[1]
        for call in calls
        if call.func.id in ("background_node", "node_result", "node_session") and len(call.args) > 1
    ]  # type: ignore[attr-defined]
    return {argument.value for argument in starts if isinstance(argument, ast.Constant)}


def test_every_node_that_a_command_starts_exists() -> None:
    folder = Path(str(gibson_sim_bench.cli.__file__)).parent
    requested = set().union(*(_requested(ast.parse(file.read_text())) for file in folder.glob("*.py")))
    assert {"ping", "pong", "controller", "soak_subscriber"} <= requested
    assert requested - set(NODES) == set()
    assert (NODES["controller"], NODES["one_process"]) == (controller, one_process)


class _Spinner:
    """Spins without messages, and counts."""

    def __init__(self) -> None:
        self.spins = 0

    def spin_once(self, timeout_sec: float | None = None) -> None:
        self.spins += 1


def test_spinning_ends_with_the_condition(monkeypatch: pytest.MonkeyPatch) -> None:
    spinner: Any = _Spinner()
    spinning.spin_until(lambda: spinner.spins == 3, spinner)
    assert spinner.spins == 3


def test_spinning_times_out_only_without_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(spinning.time, "monotonic", lambda: now[0])

    class Slow(_Spinner):
        def spin_once(self, timeout_sec: float | None = None) -> None:
            super().spin_once(timeout_sec)
            now[0] += 40.0

    slow: Any = Slow()
    spinning.spin_until(lambda: slow.spins == 5, slow, progress=lambda: slow.spins)
    assert now[0] == 200.0, "longer than the timeout, but with progress each time"
    with pytest.raises(TimeoutError, match="no message within 60 s"):
        spinning.spin_until(lambda: False, slow)
