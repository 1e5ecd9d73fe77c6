"""Programs that trace the colours of a re-rendered bag. Other packages add them by entry points of the group ``gibson_sim.tracers``: the name is
that of the program, the value a function ``(python, samples)`` that returns a ``Tracer``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import CameraSpec, Frame, SceneState

GROUP = "gibson_sim.tracers"
Draw = Callable[[SceneState, Sequence[CameraSpec]], list[Frame]]
"""Draws cameras by our renderer."""


class Tracer(Protocol):
    """Traces colours; close it."""

    def load(self, scene: DrawnScene, state: SceneState, draw: Draw) -> None:
        """Loads a scene, which replaces the one before.

        Args:
            scene: the scene, with local files.
            state: a state of it.
            draw: draws the scene by our renderer, for the exposure.
        """
        ...

    def colors(self, state: SceneState, frame: Frame) -> NDArray[np.uint8]:
        """Returns the traced colours, (H, W, 3), sRGB, of a frame that our renderer drew of a state."""
        ...

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        ...


def open_tracer(name: str, python: str, samples: int) -> Tracer:
    """Returns a tracer.

    Args:
        name: name of the program.
        python: Python interpreter that has it; empty = this one.
        samples: paths per pixel.

    Raises:
        ConfigError: no installed package has a program of this name.
    """
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(found) or "none; cycles comes with the package gibson_sim_tools"
        raise ConfigError(f"setting 'tracer' is {quoted(name)}, must be a program that is installed: {known}")
    tracer: Tracer = found[name].load()(python or sys.executable, samples)
    return tracer
