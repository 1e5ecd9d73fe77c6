"""Bakes the light maps of a building with Cycles: the light on white diffuse surfaces."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.making.blender.assembly import NO_ATLAS, Assembly
from gibson_sim_tools.making.blender.charts import outset_corners
from gibson_sim_tools.making.blender.materials import probe_material
from gibson_sim_tools.making.blender.stage import Stage, surfaces_of
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.pixels import fill_gaps_mirrored, hidden_texels, median_filtered

F32 = NDArray[np.float32]
_PROBE_SAMPLES = 8
_HIDDEN = 0.7
"""Share of views of the inner sides of solids, or of near surfaces, from which a texel is hidden."""
_NEAR_M = 0.05
"""Distance up to which a surface is near, m."""


class BakedStage(Stage):
    """A stage whose light maps can be baked.

    Args:
        building: its lights.
        assembly: its triangles.
        size_px: edge of each light map, texels.
    """

    def __init__(self, building: Building, assembly: Assembly, size_px: int) -> None:
        super().__init__(building, assembly)
        self._size_px = size_px
        for atlas, mesh_object in self.objects.items():
            mesh, rows = mesh_object.data, surfaces_of(assembly, atlas)
            thin = mesh.attributes.new("thin", "FLOAT", "FACE")
            thin.data.foreach_set("value", assembly.thin[rows].astype(np.float32))
            if atlas != NO_ATLAS:
                uv = outset_corners(assembly.uv[rows], assembly.charts, atlas, size_px)
                mesh.uv_layers.new(name="light").uv.foreach_set("vector", uv.astype(np.float32).ravel())

    def light(self, atlas: int, samples: int) -> F32:
        """Bakes the light on white of the visible surfaces, (H, W, 4), linear, row 0 at the bottom.

        The last channel is 1 on surfaces, but -1 where their light must not be used, as on a wall behind its skirting. A texel that is partly inside
        a solid has the light of its visible part.
        """
        image = self._bake(atlas, samples, [target for _, target in self.materials.values()])
        covered = image[..., 3] > 0.5
        inside, near = np.moveaxis(median_filtered(fill_gaps_mirrored(self._probe(atlas), covered)), 2, 0)
        image[..., :3] /= np.maximum(1.0 - inside, 1.0 - _HIDDEN)[..., None]
        image[hidden_texels(inside >= _HIDDEN, near >= _HIDDEN, covered), 3] = -1.0
        return image

    def _probe(self, atlas: int) -> F32:
        """Returns the shares of views of the inner sides of solids, and of views of near surfaces, from each texel, (H, W, 2)."""
        material, target = probe_material(_NEAR_M)
        lights = [item for item in self.scene.objects if item.type == "LIGHT"]
        materials = [(item.data, list(item.data.materials)) for item in self.objects.values()]
        cycles = self.scene.cycles
        bounces = cycles.max_bounces, cycles.diffuse_bounces
        cycles.max_bounces = cycles.diffuse_bounces = 1
        for light in lights:
            light.hide_render = True
        for mesh, slots in materials:
            for k in range(len(slots)):
                mesh.materials[k] = material
        image = self._bake(atlas, _PROBE_SAMPLES, [target])
        for mesh, slots in materials:
            for k, slot in enumerate(slots):
                mesh.materials[k] = slot
        for light in lights:
            light.hide_render = False
        cycles.max_bounces, cycles.diffuse_bounces = bounces
        bpy.data.materials.remove(material)
        return np.asarray(np.clip(image[..., :2], 0.0, 1.0))

    def _bake(self, atlas: int, samples: int, targets: list[object]) -> F32:
        """Bakes the diffuse light on an object, without its colour, (H, W, 4); the last channel is 1 on surfaces."""
        image = bpy.data.images.new("bake", self._size_px, self._size_px, float_buffer=True, alpha=True)
        image.generated_color = (0.0, 0.0, 0.0, 0.0)
        for target in targets:
            target.image = image  # type: ignore[attr-defined]
        self.scene.cycles.samples = samples
        bpy.ops.object.select_all(action="DESELECT")
        baked = self.objects[atlas]
        baked.select_set(True)
        bpy.context.view_layer.objects.active = baked
        bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, margin=0, use_clear=True)
        pixels = np.empty(self._size_px * self._size_px * 4, dtype=np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        return pixels.reshape(self._size_px, self._size_px, 4)
