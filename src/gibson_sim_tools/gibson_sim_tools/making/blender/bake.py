"""Bakes the atlases of a building with Cycles: colours, and light at half the texel density."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.making.blender.assembly import Assembly
from gibson_sim_tools.making.blender.stage import Stage
from gibson_sim_tools.making.building import Building

F32 = NDArray[np.float32]
_COLOR_SAMPLES, _OPENNESS_SAMPLES = 3, 4
_OCCLUSION_DISTANCE_M = 0.02
"""Distance within which geometry occludes a surface, m."""


class BakedStage(Stage):
    """A stage whose atlases can be baked. ``samples``: samples of the light pass."""

    def __init__(self, building: Building, assembly: Assembly, samples: int) -> None:
        super().__init__(building, assembly)
        self._samples = samples

    def color(self, atlas: int, size_px: int) -> F32:
        """Bakes linear colours, (H, W, 4), row 0 at the bottom; the last channel is 1 on surfaces."""
        return self._bake(atlas, size_px, {"COLOR"}, _COLOR_SAMPLES)

    def light(self, atlas: int, size_px: int, factor: float = 1.0) -> F32:
        """Bakes light on white, (H, W, 4), linear, row 0 at the bottom. ``factor``: multiple of the usual number of samples."""
        return self._bake(atlas, size_px, {"DIRECT", "INDIRECT"}, round(self._samples * factor))

    def openness(self, atlas: int, size_px: int) -> F32:
        """Bakes ambient occlusion, (H, W): fraction of directions without near geometry; row 0 at the bottom."""
        self.scene.world.light_settings.distance = _OCCLUSION_DISTANCE_M
        return self._bake(atlas, size_px, None, _OPENNESS_SAMPLES)[..., 0]

    def _bake(self, atlas: int, size_px: int, passes: set[str] | None, samples: int) -> F32:
        """Bakes passes of the diffuse component; ``passes`` None = ambient occlusion."""
        image = bpy.data.images.new("bake", size_px, size_px, float_buffer=True, alpha=True)
        image.generated_color = (0.0, 0.0, 0.0, 0.0)
        for _, target in self.materials.values():
            target.image = image
        self.scene.cycles.samples = samples
        bpy.ops.object.select_all(action="DESELECT")
        target_object = self.objects[atlas]
        target_object.select_set(True)
        bpy.context.view_layer.objects.active = target_object
        if passes is None:
            bpy.ops.object.bake(type="AO", margin=0, use_clear=True)
        else:
            bpy.ops.object.bake(type="DIFFUSE", pass_filter=passes, margin=0, use_clear=True)
        pixels = np.empty(size_px * size_px * 4, dtype=np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        return pixels.reshape(size_px, size_px, 4)
