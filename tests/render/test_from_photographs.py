"""Photographs beside the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.from_photographs.sheet import contact_sheet, draw_photographs, likeness
from gibson_sim_tools.texturing.photograph_layouts import open_photographs
from support.photographed_room import HEIGHT, WIDTH, write_mesh, write_nerfstudio

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_the_simulation_at_the_place_of_a_photograph_looks_like_it(tmp_path):
    photographs = open_photographs(write_nerfstudio(tmp_path / "photographs"))
    scene = load_scene(write_mesh(tmp_path / "room.ply", np.eye(4)))
    told = []
    drawn = draw_photographs(scene, photographs, [0, 4, 7], "unseen_floor", told.append)
    assert list(drawn) == [0, 4, 7] and told[-1] == 1.0
    alike = likeness(photographs, drawn)
    # Colours that are linear between vertices 0.2 m apart, of waves of 2 m.
    assert alike.psnr > 30.0 and alike.pixels > 0.9 * 3 * WIDTH * HEIGHT
    # What no photograph shows is drawn, and does not count.
    (name,) = {visual.name for visual in scene.visuals}
    assert not any(picture.seen.any() for picture in draw_photographs(scene, photographs, [0], name).values())
    # Two pairs of pictures of 400x300 pixels with captions in each of two rows, the last one empty.
    assert contact_sheet(photographs, drawn).shape == (2 * (300 + 26), 4 * (400 + 6), 3)
