"""Materials and looks of a scene as rows of the arrays that shaders read. No OpenGL here."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.render.batches import LOOK, MATERIAL, PLAIN_LOOK
from gibson_sim.robots.spec import Look
from gibson_sim.scenes.looks import apply_look, is_drawn, pattern_colors, pattern_pictures, tint_matrix
from gibson_sim.scenes.mesh_types import Material

SOLID_ALPHA = 0.9
"""Where a blended material has at least this alpha it is drawn as solid, so that it also has a depth."""


class MaterialTable:
    """Rows of ``MATERIAL``, and of ``LOOK`` beside them."""

    def __init__(self, looks: Sequence[Look], warn: Callable[[str], None]) -> None:
        self.rows: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
        patterns = list(dict.fromkeys(look.pattern for look in looks if look.pattern is not None))
        self._layers, self.patterns = pattern_pictures(patterns, warn)

    def row(self, material: Material, look: Look | None) -> int:
        """Returns the row of a material under a look."""
        worn = material if look is None else apply_look(material, look)
        linear = linear_from_srgb(worn.base_color[:3]).tolist()
        # A look that says how rough it is means the surface, not a factor on a map.
        from_map = [float(look is None or value is None) for value in (look and look.metallic, look and look.roughness)]
        values = (
            *linear, worn.base_color[3],
            worn.metallic, worn.roughness, min(max(solid_alpha(worn), 0.0), 1.0), float(worn.unlit),
            *worn.emissive, 0.0,
            0.0 if worn.normal_texture is None else worn.normal_scale, worn.occlusion_strength, *from_map,
        )  # fmt: skip
        return self.rows.setdefault((values, self._look(material, look)), len(self.rows))

    def _look(self, material: Material, look: Look | None) -> tuple[float, ...]:
        if look is None or not is_drawn(material, look):
            return ()
        layer, size = -1, 1.0
        colors: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0,) * 3, (1.0,) * 3)
        if look.pattern is not None:
            layer, size, colors = self._layers[look.pattern], look.pattern.size, pattern_colors(look.pattern)
        first, second = linear_from_srgb(colors).tolist()
        tint = np.hstack([tint_matrix(look), np.zeros((3, 1))])
        return (*tint.ravel().tolist(), *first, float(layer), *second, 1.0 / size)

    def materials(self) -> NDArray[np.void]:
        """Returns (M,) of ``MATERIAL``."""
        return np.array([v for v, _ in self.rows], dtype=np.float32).reshape(-1, 16).view(MATERIAL)[:, 0]

    def looks(self) -> NDArray[np.void]:
        """Returns (M,) of ``LOOK``, or (0,) if there are none."""
        worn = [look for _, look in self.rows]
        if not any(worn):
            return np.zeros(0, dtype=LOOK)
        return np.array([look or PLAIN_LOOK for look in worn], dtype=np.float32).view(LOOK)[:, 0]


def solid_alpha(material: Material) -> float:
    """Returns the alpha from which a material is drawn as solid."""
    return material.alpha_cutoff if material.alpha_mode == "mask" else SOLID_ALPHA
