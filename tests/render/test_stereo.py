"""Images of a stereo pair."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.render.renderer import Renderer
from gibson_sim.sensors.stereo import stereo_pair
from render.drawing import EYE, facing_quad, loader_of, mesh_visual, scene, state

pytestmark = pytest.mark.egl


def _speckle() -> Material:
    """Returns a texture of soft spots, which can be matched with subpixel accuracy."""
    noise = np.random.default_rng(5).random((256, 256, 3)).astype(np.float32)
    spots = cv2.GaussianBlur(noise, (0, 0), 3.0)
    spots = (spots - spots.min()) / (spots.max() - spots.min())
    return Material(texture=TextureSource("spots", (255.0 * spots).astype(np.uint8)), unlit=True)


@pytest.mark.parametrize("distance", [2.0, 3.7])
def test_disparity_of_a_wall_is_the_focal_length_times_the_baseline_by_its_distance(distance: float) -> None:
    left, right = stereo_pair(replace(EYE, width=256, height=256), 0.1)
    with Renderer(scene(mesh_visual()), meshes=loader_of(facing_quad(distance, distance, _speckle()))) as renderer:
        images = [cv2.cvtColor(f.rgb, cv2.COLOR_RGB2GRAY).astype(np.float64) for f in renderer.render(state(), [left, right])]
    # Focal length 128 px: at 2 m 6.4 px, at 3.7 m 3.459 px. A point is farther left in the right image.
    expected = 128.0 * 0.1 / distance
    rows, columns = np.mgrid[32:224, 32:224].astype(np.float32)
    shifts = np.arange(expected - 1.0, expected + 1.0, 0.05)
    errors = []
    for shift in shifts:
        moved = cv2.remap(images[1].astype(np.float32), columns - np.float32(shift), rows, cv2.INTER_CUBIC)
        errors.append(np.mean((moved - images[0][32:224, 32:224]) ** 2))
    assert shifts[int(np.argmin(errors))] == pytest.approx(expected, abs=0.1)
    assert min(errors) < 1.0
