"""Loops over numbers become machine code, by Numba, where it is installed (the extra ``fast``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

try:
    from numba import config, njit
except ImportError:
    njit = None  # type: ignore[assignment]

Number = TypeVar("Number", bound=np.generic)
Function = TypeVar("Function", bound=Callable[..., Any])
CAN_COMPILE: bool = njit is not None and not config.DISABLE_JIT  # type: ignore[attr-defined]
"""Whether ``compiled`` compiles. If not, NumPy is far quicker than loops: callers have the same in NumPy, which must give equal results."""


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
