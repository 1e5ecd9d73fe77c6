"""Photographs beside the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.from_photographs.sheet import contact_sheet, photograph_renderer
from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.texturing.measure import compare
from support.photographed_room import HEIGHT, WIDTH, write_mesh, write_nerfstudio

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_the_simulation_at_the_place_of_a_photograph_looks_like_it(tmp_path):
    photographs = open_photographs(write_nerfstudio(tmp_path / "photographs"))
    scene = load_scene(write_mesh(tmp_path / "room.ply", np.eye(4)))
    (name,) = {visual.name for visual in scene.visuals}
    with photograph_renderer(scene, photographs, "unseen_floor") as draw:
        alike = compare(photographs, draw, numbers=[0, 4, 7])
        sheet = contact_sheet(photographs, draw, [0, 4, 7], "colours")
    # Colours that are linear between vertices 0.2 m apart, of waves of 2 m.
    assert alike.psnr > 30.0 and alike.pixels > 0.9 * 3 * WIDTH * HEIGHT
    with photograph_renderer(scene, photographs, name) as draw:
        # What no photograph shows is drawn, and does not count.
        assert draw(0).rgb.std() > 0.1 and not draw(0).seen.any()
    # Two pairs of pictures of 400x300 pixels with captions in each of two rows, the last one empty.
    assert sheet.shape == (2 * (300 + 26), 4 * (400 + 6), 3)
