"""Draws one box and checks what comes out: the shortest proof that this machine can draw."""

from __future__ import annotations

import math

import numpy as np

from gibson_sim.errors import RenderError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix
from gibson_sim.render.renderer import Renderer
from gibson_sim.robots.spec import Shape, VisualSpec
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import CameraSpec, Pose, SceneState


def self_test(device: int | None = None) -> str:
    """Returns one line on what draws here.

    Raises:
        RenderError: what was drawn is not a box of 1 m, 3 m ahead.
    """
    box = VisualSpec("box", "", Shape("box"), Pose((3.0, 0.0, 0.0)), (1.0, 0.0, 0.0, 1.0))
    camera = CameraSpec("eye", "", Pose((0.0, 0.0, 0.0), quat_from_matrix(R_LINK_OPTICAL)), 64, 64, math.pi / 2)
    state = SceneState(0, 0, 1, (), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 6)))
    with Renderer(DrawnScene("self test", 1, "", (), (box,), (camera,), LightSpec()), device=device) as renderer:
        frame = renderer.render(state, (camera,))[0]
        info = renderer.info
    assert frame.rgb is not None
    assert frame.depth is not None
    middle, corner = frame.depth[32, 32], frame.depth[0, 0]
    red, green, blue = (int(c) for c in frame.rgb[32, 32])
    if abs(middle - 2.5) > 1e-3 or corner != np.inf or red <= 2 * max(green, blue):
        raise RenderError(
            f"{info['renderer']} draws wrongly: a red box 2.5 m ahead came out at {middle:g} m, colour {red},{green},{blue}; "
            "try another device with --egl-device"
        )
    kind = "software, no GPU" if info["software"] else "GPU"
    return f"a box came out right on {info['renderer']} ({kind}), OpenGL {info['version']}"
