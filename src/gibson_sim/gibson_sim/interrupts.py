"""Handling of Ctrl-C (SIGINT) over the whole life of a process, which ends, or cleans up and ends, without a traceback.

Python's own handler raises KeyboardInterrupt at any point, also in the middle of an import, where it prints a traceback, becomes another
exception, or is printed and lost. Programs of this package therefore let SIGINT end them during imports, raise KeyboardInterrupt only
during their work, and let SIGINT end them again during the interpreter's shutdown. Imports the standard library alone.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED = 128 + signal.SIGINT
"""Exit code of a process that SIGINT ended, as shells report it."""
_RETRY_S = 0.01
"""Delay after which an interrupt that was lost in a destructor is raised again, seconds of wall time."""


def end_silently() -> None:
    """Lets SIGINT end this process, also one that ``held_back`` has blocked so far; it stays ignored if a shell ignores it."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def die() -> NoReturn:
    """Ends this process by SIGINT, so that a shell that runs it in a loop ends the loop."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # its reader has ended
            continue
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGINT)
    os._exit(INTERRUPTED)  # if SIGINT is blocked


@contextmanager
def held_back() -> Iterator[None]:
    """Blocks SIGINT in this thread; processes started in the block receive it only once they call ``end_silently``."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Interruptible:
    """Raises KeyboardInterrupt for SIGINT in a block, so that the block cleans up; restores the previous handlers afterwards.

    After an interrupt, an exception of any type that leaves the block results from it, because imports turn KeyboardInterrupt into others.
    """

    def __init__(self, *numbers: signal.Signals) -> None:
        """``numbers``: signals that interrupt; none = SIGINT, unless a shell ignores it."""
        self._numbers = numbers
        self.was_interrupted = False
        self._before: dict[signal.Signals, Any] = {}
        self._hook = sys.unraisablehook

    def __enter__(self) -> Interruptible:
        self.was_interrupted = False
        ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        self._hook, sys.unraisablehook = sys.unraisablehook, self._on_unraisable
        for number in self._numbers or (() if ignored else (signal.SIGINT,)):
            self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()
        sys.unraisablehook = self._hook

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.was_interrupted = True
        raise KeyboardInterrupt

    def _on_unraisable(self, what: Any) -> None:
        """Raises an interrupt again that Python could not raise at its place, such as in a destructor."""
        if what.exc_type is not None and issubclass(what.exc_type, KeyboardInterrupt):
            threading.Timer(_RETRY_S, _thread.interrupt_main).start()  # an exception in this hook would be printed as well
        else:
            self._hook(what)
