"""Draws images whose shutter is open for a while, or whose rows are read one after the other, from pictures at several times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from gibson_sim.geometry.exposures import Exposure
from gibson_sim.render.context import GlContext
from gibson_sim.render.draw.effects import EffectsPass, copy_image
from gibson_sim.render.draw.pinhole_views import is_plain
from gibson_sim.render.draw.target import Feature, Target
from gibson_sim.types import CameraSpec, SceneState

Draw = Callable[[Target, CameraSpec, SceneState], None]
"""Draws what a camera sees in a state into the top left corner of a target, finished but for the effects on colours."""
_MAX_PARTS = 4


class Exposing:
    """Puts images together from ``exposures``.

    Args:
        context: where; it must be current in every call.
        effects: averages the colours.
    """

    def __init__(self, context: GlContext, effects: EffectsPass) -> None:
        self._context, self._effects = context, effects
        self._parts: dict[tuple[int, int, tuple[Feature, ...]], Target] = {}

    def image(self, target: Target, camera: CameraSpec, plan: Sequence[Exposure], x: int, y: int, draw: Draw) -> bool:
        """Draws an image into its place in a target; returns whether its colours are in the average of the effects instead.

        Args:
            target: where to, without multisampling.
            camera: of the image.
            plan: what ``exposures`` says.
            x: column of the image's left edge in the target.
            y: row of its top edge.
            draw: draws one picture.
        """
        averaged = any(exposure.weight < 1.0 for exposure in plan)
        if averaged:
            self._effects.begin(camera.width, camera.height)
        # A non-pinhole camera is drawn as a whole each time: a table of where its pixels look for each band would take longer.
        cut = is_plain(camera)
        height = max(e.rows.stop - e.rows.start for e in plan) if cut else camera.height
        for exposure in plan:
            rows = exposure.rows
            part = self._part(camera.width, height, target.features if exposure.geometry else ())
            draw(part, rows_of(camera, rows) if cut else camera, exposure.state)
            first = 0 if cut else rows.start
            if averaged:
                self._effects.add(part.textures["color"], rows, exposure.weight, first)
            if exposure.geometry:
                rectangle = (0, first, camera.width, rows.stop - rows.start)
                copy_image(self._context, part, target, tuple(target.textures), rectangle, (x, y + rows.start))
        return averaged

    def _part(self, width: int, height: int, features: tuple[Feature, ...]) -> Target:
        key = (width, height, features)
        if key not in self._parts:
            if len(self._parts) >= _MAX_PARTS:
                self._parts.pop(next(iter(self._parts))).close()
            self._parts[key] = Target(self._context, width, height, features)
        return self._parts[key]

    def close(self) -> None:
        """Frees everything; a second call does nothing. The context must be current."""
        parts, self._parts = self._parts, {}
        for part in parts.values():
            part.close()


def rows_of(camera: CameraSpec, rows: slice) -> CameraSpec:
    """Returns the camera that sees some rows of a pinhole's image, pixel by pixel."""
    k = camera.intrinsics()
    k[1, 2] -= rows.start
    return replace(camera, height=rows.stop - rows.start, matrix=tuple(float(n) for n in k.ravel()))
