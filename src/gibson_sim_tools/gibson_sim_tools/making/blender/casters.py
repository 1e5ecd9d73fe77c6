"""Boxes that cast the shadows of large movable bodies in the bake, but are not part of the scene. NumPy only."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface, pose_matrix
from gibson_sim_tools.making.building import Body

_Box = tuple[tuple[float, float, float], tuple[float, float, float]]
_CASTERS: dict[str, tuple[_Box, ...]] = {
    "fridge_body": (((-0.34, -0.3, 0.02), (0.31, 0.3, 1.78)),),
    "oven_body": (((-0.3, -0.297, 0.02), (0.27, 0.297, 0.6)),),
    "cabinet_drawers": (((-0.22, -0.3, 0.03), (0.2, 0.3, 0.72)),),
    "cabinet_doors": (((-0.22, -0.4, 0.03), (0.2, 0.4, 0.76)),),
    "chair_wooden": (((-0.2, -0.2, 0.435), (0.22, 0.2, 0.455)), ((-0.24, -0.19, 0.7), (-0.22, 0.19, 0.85))),
    "stool": (((-0.17, -0.17, 0.43), (0.17, 0.17, 0.46)),),
    "table_side": (((-0.21, -0.21, 0.47), (0.21, 0.21, 0.5)),),
    "box_cardboard": (((-0.145, -0.195, 0.0), (0.145, 0.195, 0.28)),),
    "basket": (((-0.12, -0.17, 0.0), (0.12, 0.17, 0.22)),),
    "bin_waste": (((-0.1, -0.1, 0.0), (0.1, 0.1, 0.32)),),
    "ball": (((-0.06, -0.06, 0.02), (0.06, 0.06, 0.2)),),
}
"""Lower and upper corners of the boxes for models of ``scenes/objects``, m."""


def shadow_caster(body: Body) -> ObjectBuilder | None:
    """Returns the shadow caster of a body, in the world frame; None for small bodies."""
    boxes = _CASTERS.get(body.model)
    if boxes is None:
        return None
    solid = ObjectBuilder(np.random.default_rng(0))
    for low, high in boxes:
        solid.box(low, high, Surface("outside", (0.5, 0.5, 0.5)), 0)
    solid.transform(0, pose_matrix(body.position, body.yaw))
    return solid
