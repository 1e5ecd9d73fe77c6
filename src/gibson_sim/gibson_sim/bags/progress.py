"""A progress bar in the terminal for work on bags."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

Advance = Callable[[float], None]
"""Callable that receives the completed fraction of the work, 0 to 1."""
_STEP = 0.001
"""Minimum progress that redraws the bar: drawing takes longer than processing many messages."""


def no_progress(part: float) -> None:
    """Ignores the progress."""


@contextmanager
def progress_bar(what: str, duration_s: float | None = None) -> Iterator[Advance]:
    """Shows a bar on stderr during the block, if stderr is a terminal; yields the callable that advances it.

    Args:
        what: name of the work.
        duration_s: wall time of the whole work without pauses, s; None = the remaining time is estimated from the progress.
    """
    console = Console(stderr=True)
    remaining = TimeRemainingColumn() if duration_s is None else _RemainingColumn(duration_s)
    columns = (TextColumn(what), BarColumn(), TextColumn("{task.percentage:3.0f} %"), remaining)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task, shown = progress.add_task(what, total=1.0), 0.0

        def advance(part: float) -> None:
            nonlocal shown
            if abs(part - shown) >= _STEP:
                shown = part
                progress.update(task, completed=part)

        yield advance


class _RemainingColumn(ProgressColumn):
    """Remaining time of work whose duration is known. An estimate from the progress would count pauses as slow progress."""

    def __init__(self, duration_s: float) -> None:
        super().__init__()
        self._duration_s = duration_s

    def render(self, task: Task) -> Text:
        """Returns hours, minutes and seconds."""
        return Text(str(timedelta(seconds=math.ceil((1.0 - task.completed) * self._duration_s))), style="progress.remaining")
