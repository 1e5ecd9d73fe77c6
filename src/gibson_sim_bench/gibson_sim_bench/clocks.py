"""Stop-watches: how long calls of a function took that others make, and all calls of OpenGL."""

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
    """Adds up time."""

    ns: int = 0

    def take(self) -> float:
        """Returns the milliseconds since the last call, and begins at 0 again."""
        taken, self.ns = self.ns / 1e6, 0
        return taken

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Returns a function that does the same and adds its time here."""

        def call(*arguments: Any, **named: Any) -> Any:
            began = time.perf_counter_ns()
            try:
                return function(*arguments, **named)
            finally:
                self.ns += time.perf_counter_ns() - began

        return call


@contextmanager
def calls_of(owner: Any, name: str) -> Iterator[Clock]:
    """Measures all calls of ``owner.name`` while the block lasts."""
    clock, original = Clock(), getattr(owner, name)
    setattr(owner, name, clock.timed(original))
    try:
        yield clock
    finally:
        setattr(owner, name, original)


@contextmanager
def opengl_calls() -> Iterator[Clock]:
    """Measures all OpenGL calls of renderers that are made in the block, for as long as they live."""
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
    """Returns how long copying so many bytes takes, milliseconds, median: no frame can come back to the host in less."""
    source, target = np.ones(max(1, size_bytes), dtype=np.uint8), np.empty(max(1, size_bytes), dtype=np.uint8)
    found = []
    for _ in range(times):
        began = time.perf_counter_ns()
        np.copyto(target, source)
        found.append((time.perf_counter_ns() - began) / 1e6)
    return float(np.median(found))
