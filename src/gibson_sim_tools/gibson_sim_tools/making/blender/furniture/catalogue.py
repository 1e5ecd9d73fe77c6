"""Pieces of furniture, by the kinds of the catalogue. NumPy only.

Each function gets a solid and the size of the piece, depth (x, front at +x), width (y), height (z), and fills just that size; the origin lies in
the middle of the underside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gibson_sim.types import Vec3
from gibson_sim_tools.making.blender.furniture import bath, bed, kitchen, living, small, work
from gibson_sim_tools.making.blender.shapes import Solid

Builder = Callable[[Solid, float, float, float], None]
BUILDERS: dict[str, Builder] = {
    **living.BUILDERS,
    **kitchen.BUILDERS,
    **bath.BUILDERS,
    **bed.BUILDERS,
    **work.BUILDERS,
    **small.BUILDERS,
}


def build_piece(kind: str, size: Vec3, seed: int, style: int = 0) -> Solid:
    """Returns a piece of furniture; the same seed and style give the same one.

    Raises:
        KeyError: there is no such kind.
    """
    solid = Solid(np.random.default_rng(seed), style)
    BUILDERS[kind](solid, *size)
    if not solid.boxes:
        depth, width, height = size
        solid.collide((-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, height))
    return solid
