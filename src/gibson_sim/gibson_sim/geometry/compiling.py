"""Loops over numbers become machine code, by Numba, where it is installed (the extra ``fast``)."""

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
"""Whether ``compiled`` compiles. If not, NumPy is far quicker than loops: callers have the same in NumPy, which must give equal results."""


def _hold_interrupts_back() -> None:
    """Lets Ctrl-C interrupt what compiles only between compilations: in the middle of one it ends in a stack or a segmentation fault."""
    depth, handler, kept = 0, None, False

    def keep(*_: object) -> None:
        nonlocal kept
        kept = True

    class Compilations(event.Listener):
        """Hears of every compilation, in the thread that compiles."""

        def on_start(self, event: Any) -> None:
            nonlocal depth, handler, kept
            if threading.current_thread() is not threading.main_thread():
                return
            depth += 1
            if depth == 1 and callable(signal.getsignal(signal.SIGINT)):
                kept, handler = False, signal.signal(signal.SIGINT, keep)

        def on_end(self, event: Any) -> None:
            nonlocal depth, handler
            if threading.current_thread() is not threading.main_thread():
                return
            depth -= 1
            if depth == 0 and handler is not None:
                signal.signal(signal.SIGINT, handler)
                handler = None
                if kept:
                    signal.raise_signal(signal.SIGINT)

    event.register("numba:compile", Compilations())  # type: ignore[no-untyped-call]


if CAN_COMPILE:
    _hold_interrupts_back()


def compiled(function: Function) -> Function:
    """Returns the function compiled, at its first call in an installation, which takes seconds; later processes find it in a cache.

    Arithmetic is done as it is written, without fused or reordered operations: the numbers are those of NumPy, to the bit.
    """
    if not CAN_COMPILE:
        return function
    try:
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:
        # Neither beside the module nor in the user's cache can anything be kept: it is compiled anew in every process.
        return cast(Function, njit(nogil=True, error_model="numpy")(function))


def fixed(values: NDArray[Number]) -> NDArray[Number]:
    """Returns an array that cannot be written to, without gaps: loops are compiled anew for every kind of array that they meet."""
    view = np.ascontiguousarray(values).view()
    view.flags.writeable = False
    return view
