"""A progress bar in the terminal for work on bags."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

Advance = Callable[[float], None]
"""Callable that receives the completed fraction of the work, 0 to 1."""
_STEP = 0.001
"""Minimum progress that redraws the bar: drawing takes longer than processing many messages."""


def no_progress(part: float) -> None:
    """Ignores the progress."""


@contextmanager
def progress_bar(what: str) -> Iterator[Advance]:
    """Shows a bar on stderr during the block, if stderr is a terminal; yields the callable that advances it."""
    console = Console(stderr=True)
    columns = (TextColumn(what), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task, shown = progress.add_task(what, total=1.0), 0.0

        def advance(part: float) -> None:
            nonlocal shown
            if abs(part - shown) >= _STEP:
                shown = part
                progress.update(task, completed=part)

        yield advance
