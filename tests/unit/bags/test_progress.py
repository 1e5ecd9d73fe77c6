"""The progress bar of work on bags."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from gibson_sim.bags import progress


def test_the_remaining_time_of_work_of_a_known_duration_does_not_depend_on_its_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(
        progress, "Console", lambda **_: Console(file=terminal, force_terminal=True, color_system=None, width=100)
    )
    with progress.progress_bar("playing", 100.0) as advance:
        advance(0.25)
    assert "25 % 0:01:15" in terminal.getvalue(), "three quarters of 100 s, however long the first quarter took"
