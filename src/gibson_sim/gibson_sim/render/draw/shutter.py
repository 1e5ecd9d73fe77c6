"""Motion blur and rolling shutter: composes an image from pictures at several times of its exposure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from gibson_sim.geometry.exposures import Exposure
from gibson_sim.render.context import GlContext
from gibson_sim.render.draw.effects import EffectsPass, copy_image
from gibson_sim.render.draw.pinhole_views import is_plain
from gibson_sim.render.draw.target import Feature, RenderTarget
from gibson_sim.types import CameraSpec, SceneState

Draw = Callable[[RenderTarget, CameraSpec, SceneState], None]
"""Draws a camera's image of a state into the top left corner of a target, without colour effects."""
_MAX_TARGETS = 4


class Shutter:
    """Composes images from their ``exposures``.

    Args:
        context: it must be current in every call.
        effects: pass that averages colours.
    """

    def __init__(self, context: GlContext, effects: EffectsPass) -> None:
        self._context, self._effects = context, effects
        self._targets: dict[tuple[int, int, tuple[Feature, ...]], RenderTarget] = {}

    def image(self, target: RenderTarget, camera: CameraSpec, plan: Sequence[Exposure], x: int, y: int, draw: Draw) -> bool:
        """Draws an image into its rectangle of a target.

        Args:
            target: target without multisampling.
            camera: camera of the image.
            plan: ``exposures`` of the image.
            x: column of the image's left edge in the target.
            y: row of its top edge.
            draw: draws one picture.

        Returns:
            Whether the colours are in the average of ``effects`` instead of the target.
        """
        averaged = any(exposure.weight < 1.0 for exposure in plan)
        if averaged:
            self._effects.begin(camera.width, camera.height)
        # Non-pinhole cameras draw the whole image for each exposure: a lookup table for each band of rows would take longer.
        in_bands = is_plain(camera)
        height = max(e.rows.stop - e.rows.start for e in plan) if in_bands else camera.height
        colours: tuple[Feature, ...] = ("NORMALS",) if camera.fill else ()
        for exposure in plan:
            rows = exposure.rows
            picture = self._target(camera.width, height, target.features if exposure.geometry else colours)
            draw(picture, rows_of(camera, rows) if in_bands else camera, exposure.state)
            first = 0 if in_bands else rows.start
            if averaged:
                normals = picture.textures["NORMALS"] if camera.fill else None  # they mark holes
                self._effects.add(picture.textures["color"], rows, exposure.weight, first, normals)
            if exposure.geometry:
                rectangle = (0, first, camera.width, rows.stop - rows.start)
                copy_image(self._context, picture, target, tuple(target.textures), rectangle, (x, y + rows.start))
        return averaged

    def _target(self, width: int, height: int, features: tuple[Feature, ...]) -> RenderTarget:
        key = (width, height, features)
        if key not in self._targets:
            if len(self._targets) >= _MAX_TARGETS:
                self._targets.pop(next(iter(self._targets))).close()
            self._targets[key] = RenderTarget(self._context, width, height, features)
        return self._targets[key]

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing. The context must be current."""
        targets, self._targets = self._targets, {}
        for target in targets.values():
            target.close()


def rows_of(camera: CameraSpec, rows: slice) -> CameraSpec:
    """Returns the camera whose image consists of the given rows of a pinhole camera's image."""
    k = camera.intrinsics()
    k[1, 2] -= rows.start
    return replace(camera, height=rows.stop - rows.start, matrix=tuple(float(n) for n in k.ravel()))
