"""Re-rendered photographs."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.from_photographs.rerendering import FRONTS, HOLES, contact_sheet, photograph_renderer
from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.texturing.evaluation import image_similarity
from support.photographed_room import HEIGHT, WIDTH, write_mesh, write_nerfstudio

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_a_rerendered_photograph_is_similar_to_it(tmp_path):
    photographs = open_photographs(write_nerfstudio(tmp_path / "photographs"))
    scene = load_scene(write_mesh(tmp_path / "room.ply", np.eye(4)))
    (name,) = {visual.name for visual in scene.visuals}
    with photograph_renderer(scene, photographs, "unseen_floor") as render:
        similarity = image_similarity(photographs, render, numbers=[0, 4, 7])
        sheet = contact_sheet(photographs, render, [0, 4, 7], "colours")
    # Colours that are linear between vertices 0.2 m apart, of waves of 2 m.
    assert similarity.psnr > 30.0 and similarity.pixels > 0.9 * 3 * WIDTH * HEIGHT
    with photograph_renderer(scene, photographs, name) as render:
        # The unseen object is rendered, but is not part of the observed surface.
        assert render(0).rgb.std() > 0.1 and not render(0).visible.any()
    # Two pairs of images of 400x300 pixels with captions in each of two rows, the last one empty.
    assert sheet.shape == (2 * (300 + 26), 4 * (400 + 6), 3)


def test_filled_images_are_compared_in_holes_and_on_front_faces(tmp_path):
    photographs = open_photographs(write_nerfstudio(tmp_path / "photographs"))
    scene = load_scene(write_mesh(tmp_path / "room.ply", np.eye(4)))  # without the floor at x < 0.6
    with photograph_renderer(scene, photographs, "unseen_floor") as render:
        everywhere = range(len(photographs))
        found = {
            (fill, region): image_similarity(
                photographs, lambda k, fill=fill, region=region: render(k, fill, region), numbers=everywhere
            )
            for fill in ("", "push_pull")
            for region in (FRONTS, HOLES)
        }
        rendered = render(0)
    assert found["", HOLES].pixels > 100 and found["", HOLES].pixels + found["", FRONTS].pixels <= rendered.visible.size * len(
        photographs
    )
    # A hole is black; push-pull fills it from its surroundings and leaves the rest unchanged.
    assert found["push_pull", HOLES].psnr > found["", HOLES].psnr + 3.0
    assert found["push_pull", FRONTS].psnr == pytest.approx(found["", FRONTS].psnr, abs=1.0)  # their common border gains, too
