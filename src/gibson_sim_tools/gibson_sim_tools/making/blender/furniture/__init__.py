"""Builds furniture of each kind in the catalogue. NumPy only.

Each function gets a builder and the size of the piece: depth (x, front at +x), width (y), height (z), metres. The piece fills exactly this size;
the origin is the centre of its underside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gibson_sim.types import Vec3
from gibson_sim_tools.making.blender.furniture import bath, kitchen, living, small, work
from gibson_sim_tools.making.blender.shapes import ObjectBuilder

Builder = Callable[[ObjectBuilder, float, float, float], None]
BUILDERS: dict[str, Builder] = {
    **living.BUILDERS,
    **kitchen.BUILDERS,
    **bath.BUILDERS,
    **work.BUILDERS,
    **small.BUILDERS,
}


def build_piece(kind: str, size: Vec3, seed: int, style: int = 0) -> ObjectBuilder:
    """Models a piece of furniture; deterministic for a seed and a style.

    Raises:
        KeyError: the kind is unknown.
    """
    solid = ObjectBuilder(np.random.default_rng(seed), style)
    BUILDERS[kind](solid, *size)
    if not solid.boxes:
        depth, width, height = size
        solid.collide((-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, height))
    return solid
