"""Traces the colours of re-rendered bags with Cycles: ``gibson-sim render BAG --with cycles``."""

from __future__ import annotations

import dataclasses
import logging
import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.tracers import Draw
from gibson_sim.errors import ConfigError
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import Frame, SceneState
from gibson_sim_tools.making.baking import check_blender
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.pictures import EYE_HEIGHT, eye_camera
from gibson_sim_tools.tracing.export import traced_scene
from gibson_sim_tools.tracing.pictures import Outside, curve_of, developed, exposure_samples, fit_exposure
from gibson_sim_tools.tracing.tracer import CyclesTracer

logger = logging.getLogger(__name__)
_PROBE_WIDTH, _PROBE_HEIGHT, _PROBE_SAMPLES = 160, 120, 32
"""Size, pixels, and paths per pixel of the pictures by which the exposure is found."""
_MAX_PROBES = 8


class CyclesColors:
    """Traces colours of the frames of a bag; a ``gibson_sim.bags.tracers.Tracer``.

    The exposure is one for each scene. For a generated scene it brings the views from the plan's start poses nearest to ours; in other scenes
    light is exposed as our renderer does.

    Args:
        python: Python interpreter with Blender.
        samples: paths per pixel.

    Raises:
        SceneError: the interpreter has no Blender.
    """

    def __init__(self, python: str, samples: int) -> None:
        check_blender(python)
        self._python, self._samples = python, samples
        self._tracer: CyclesTracer | None = None
        self._factors, self._generated = np.ones(3), False
        self._outside: Outside | None = None

    def load(self, scene: DrawnScene, state: SceneState, draw: Draw) -> None:
        """Loads a scene and finds its exposure; see ``gibson_sim.bags.tracers.Tracer``."""
        self.close()
        exported = traced_scene(scene)
        for warning in exported.warnings:
            logger.warning("%s", warning)
        self._tracer = CyclesTracer(exported, self._python, self._samples)
        self._outside, self._generated = Outside.of(scene.light), exported.building is not None
        if exported.building is not None:
            with CyclesTracer(exported, self._python, _PROBE_SAMPLES) as probes:
                self._factors = _exposure(exported.building, probes, state, draw)

    def colors(self, state: SceneState, frame: Frame) -> NDArray[np.uint8]:
        """Returns the traced colours of a frame; see ``gibson_sim.bags.tracers.Tracer``."""
        if self._tracer is None or self._outside is None:
            raise ConfigError("no scene is loaded; call load first")
        picture = self._tracer.picture(frame.camera, frame.T_world_camera, state)
        seen = self._outside.seen(frame.camera, frame.T_world_camera)
        return developed(picture, self._factors, curve_of(generated=self._generated), seen)

    def close(self) -> None:
        """Ends Blender; a second call does nothing."""
        tracer, self._tracer = self._tracer, None
        if tracer is not None:
            tracer.close()


def _exposure(building: Building, probes: CyclesTracer, state: SceneState, draw: Draw) -> NDArray[np.float64]:
    """Returns the factors of exposure and white balance, from views at the start poses of a plan."""
    cameras = [
        dataclasses.replace(
            eye_camera((start.position[0], start.position[1], start.position[2] + EYE_HEIGHT), start.yaw + turn),
            width=_PROBE_WIDTH,
            height=_PROBE_HEIGHT,
        )
        for turn in (0.0, math.pi)
        for start in building.starts
    ][:_MAX_PROBES]
    frames = draw(state, cameras)
    pictures = [probes.picture(frame.camera, frame.T_world_camera, state) for frame in frames]
    pairs = [(picture, frame.rgb) for picture, frame in zip(pictures, frames, strict=True) if frame.rgb is not None]
    used = [~picture.moving & (picture.alpha > 0.999) & (picture.material == 0) for picture in pictures]
    return fit_exposure(*exposure_samples(pairs, used), curve_of(generated=True))
