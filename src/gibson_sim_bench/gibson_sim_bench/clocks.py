"""Timers around the calls of a function, and around all OpenGL calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from gibson_sim.render.context import gl as GL


@dataclass(slots=True)
class Clock:
    """Accumulates time."""

    ns: int = 0

    def pop_ms(self) -> float:
        """Returns the accumulated milliseconds, and resets them to 0."""
        elapsed, self.ns = self.ns / 1e6, 0
        return elapsed

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Returns a wrapper of a function that adds the duration of each call."""

        def call(*arguments: Any, **named: Any) -> Any:
            began = time.perf_counter_ns()
            try:
                return function(*arguments, **named)
            finally:
                self.ns += time.perf_counter_ns() - began

        return call


@contextmanager
def calls_of(owner: Any, name: str) -> Iterator[Clock]:
    """Times all calls of ``owner.name`` inside the block."""
    clock, original = Clock(), getattr(owner, name)
    setattr(owner, name, clock.timed(original))
    try:
        yield clock
    finally:
        setattr(owner, name, original)


@contextmanager
def opengl_calls() -> Iterator[Clock]:
    """Times all OpenGL calls of the renderers that are created inside the block, also after it."""
    clock, original = Clock(), GL.Gl

    class Timed(original):  # type: ignore[misc, valid-type]
        def __getattr__(self, name: str) -> Callable[..., Any]:
            function = clock.timed(super().__getattr__(name))
            setattr(self, name, function)
            return function

    GL.Gl = Timed  # type: ignore[misc]
    try:
        yield clock
    finally:
        GL.Gl = original  # type: ignore[misc]


def copy_ms(size_bytes: int, times: int = 50) -> float:
    """Returns the median time of copying ``size_bytes``, milliseconds: a lower bound of the readback of a frame."""
    source, target = np.ones(max(1, size_bytes), dtype=np.uint8), np.empty(max(1, size_bytes), dtype=np.uint8)
    found = []
    for _ in range(times):
        began = time.perf_counter_ns()
        np.copyto(target, source)
        found.append((time.perf_counter_ns() - began) / 1e6)
    return float(np.median(found))
