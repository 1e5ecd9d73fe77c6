"""Ctrl-C (SIGINT), from the first to the last moment of a process: it ends, or cleans up and ends, and prints no stack.

Python's own handler raises KeyboardInterrupt in whatever the process is doing, also in the middle of an import, where it ends in a stack,
is turned into another exception, or is printed and lost. A program of ours therefore lets SIGINT end it while it loads what it needs,
raises KeyboardInterrupt only while it does its work, and lets SIGINT end it again while the interpreter shuts down. Imports nothing but
the standard library.
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
"""Exit code, as shells see it, of a process that SIGINT ended."""
_AGAIN_S = 0.01
"""Wall time after which an interrupt is raised again that was lost in a destructor, s."""


def end_silently() -> None:
    """Lets SIGINT end this process at once, and receives one that ``held_back`` kept; ignored as before where a shell has it ignored."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def die() -> NoReturn:
    """Ends this process as SIGINT does: a shell that runs it in a loop ends the loop."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # its reader has ended
            continue
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGINT)
    os._exit(INTERRUPTED)  # where SIGINT is blocked


@contextmanager
def held_back() -> Iterator[None]:
    """Holds SIGINT back in this thread; processes started in the block receive it only once they call ``end_silently``."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Interruptible:
    """Raises KeyboardInterrupt for SIGINT in a block, so that it cleans up; afterwards what was before holds again.

    An exception that leaves the block after an interrupt comes of it, whatever its type: imports turn KeyboardInterrupt into others.
    """

    def __init__(self, *numbers: signal.Signals) -> None:
        """``numbers``: signals that interrupt; none = SIGINT, unless a shell has it ignored."""
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
        """Raises again what Python cannot raise where it is, such as in a destructor."""
        if what.exc_type is not None and issubclass(what.exc_type, KeyboardInterrupt):
            threading.Timer(_AGAIN_S, _thread.interrupt_main).start()  # an exception in this hook would be printed as well
        else:
            self._hook(what)
