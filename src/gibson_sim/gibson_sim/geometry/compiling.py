"""Compiles numeric loops to machine code with Numba if it is installed (the extra ``fast``)."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

try:
    from numba import config, njit
    from numba.core import event
except ImportError:
    njit = None  # type: ignore[assignment]

Number = TypeVar("Number", bound=np.generic)
Function = TypeVar("Function", bound=Callable[..., Any])
CAN_COMPILE: bool = njit is not None and not config.DISABLE_JIT  # type: ignore[attr-defined]
"""Whether ``compiled`` compiles. Without compilation loops are far slower than NumPy, so callers use a NumPy version with equal results."""


def _defer_interrupts() -> None:
    """Defers Ctrl-C to the end of a compilation: during a compilation it causes a stack trace or a segmentation fault."""
    depth, handler, deferred = 0, None, False

    def defer(*_: object) -> None:
        nonlocal deferred
        deferred = True

    class Compilations(event.Listener):
        """Receives the events of every compilation, in the compiling thread."""

        def on_start(self, event: Any) -> None:
            nonlocal depth, handler, deferred
            if threading.current_thread() is not threading.main_thread():
                return
            depth += 1
            if depth == 1 and callable(signal.getsignal(signal.SIGINT)):
                deferred, handler = False, signal.signal(signal.SIGINT, defer)

        def on_end(self, event: Any) -> None:
            nonlocal depth, handler
            if threading.current_thread() is not threading.main_thread():
                return
            depth -= 1
            if depth == 0 and handler is not None:
                signal.signal(signal.SIGINT, handler)
                handler = None
                if deferred:
                    signal.raise_signal(signal.SIGINT)

    event.register("numba:compile", Compilations())  # type: ignore[no-untyped-call]


if CAN_COMPILE:
    _defer_interrupts()


def compiled(function: Function) -> Function:
    """Returns the function, compiled at its first call in an installation, which takes seconds; later processes load it from a cache.

    Operations are neither fused nor reordered, so that the results are bit-identical to those of NumPy.
    """
    if not CAN_COMPILE:
        return function
    try:
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:
        # Neither the folder of the module nor the user's cache is writable, so the function is compiled in every process.
        return cast(Function, njit(nogil=True, error_model="numpy")(function))


def fixed(values: NDArray[Number]) -> NDArray[Number]:
    """Returns a read-only, contiguous view or copy, since a loop is compiled again for every array type that it is called with."""
    view = np.ascontiguousarray(values).view()
    view.flags.writeable = False
    return view
