"""The filler network in the package."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest

from gibson_sim.filling.fillers import LEARNED, open_filler
from gibson_sim.filling.holes import BACK_FACE, NOTHING, OUTSIDE, UNSEEN

SIZE = (96, 128)


def wall() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns colour, depth, normals and hole of a beige wall, 3 m away, with a dark lower half, two holes and a strip of sky."""
    colour = np.full((*SIZE, 3), (200, 190, 170), np.uint8)
    colour[48:] = 60, 50, 40
    hole = np.zeros(SIZE, np.uint8)
    hole[20:36, 30:60], hole[60:80, 80:110], hole[:, :4] = NOTHING, BACK_FACE, UNSEEN
    depth = np.where(np.isin(hole, (NOTHING, UNSEEN)), np.inf, 3.0).astype(np.float32)
    normals = np.zeros((*SIZE, 3), np.float32)
    normals[hole == 0] = 0.0, 0.0, -1.0
    colour[hole != 0] = 255, 0, 255  # what was drawn there must not be seen
    return colour, depth, normals, hole


def test_network_fills_holes_from_their_surroundings_and_leaves_the_sky() -> None:
    colour, depth, normals, hole = wall()
    found = open_filler("learned").fill(colour, depth, normals, hole, with_depth=False).colour.astype(int)
    assert found.shape == (*SIZE, 3)
    for region, expected in ((hole == NOTHING, (200, 190, 170)), (hole == BACK_FACE, (60, 50, 40))):
        assert np.abs(found[region] - expected).mean() < 20.0
    assert (found[hole == UNSEEN] == (255, 0, 255)).all()
    assert np.abs(found[hole == 0] - colour[hole == 0]).mean() < 5.0, "what is seen is corrected, not repainted"


def test_the_black_rim_of_a_fisheye_does_not_darken_what_is_seen_beside_it() -> None:
    colour, depth, normals, hole = wall()
    hole[:, :16] = OUTSIDE
    colour[:, :16], depth[:, :16], normals[:, :16] = 0, np.inf, 0.0
    found = open_filler("learned").fill(colour, depth, normals, hole, with_depth=False).colour.astype(int)
    assert not found[:, :16].any()
    assert np.abs(found[4:44, 16:20] - colour[4:44, 16:20]).mean() < 8.0


def test_the_same_image_gives_the_same_bits() -> None:
    one, other = (open_filler("learned").fill(*wall(), with_depth=False).colour for _ in range(2))
    assert one.tobytes() == other.tobytes()


def test_network_file_is_small_and_states_its_origin() -> None:
    assert LEARNED.stat().st_size < 10_000_000
    card = LEARNED.with_suffix(".md").read_text()
    metadata = onnxruntime.InferenceSession(str(LEARNED)).get_modelmeta().custom_metadata_map
    for key in ("data", "command"):
        assert metadata[key] in card
    assert metadata["license"] == "Apache-2.0" and metadata["gibson_filler"] == "1"


@pytest.mark.parametrize("size", [(64, 64), (97, 131)])
def test_images_of_any_size_are_filled(size: tuple[int, int]) -> None:
    hole = np.zeros(size, np.uint8)
    hole[20:40, 20:40] = NOTHING
    shape = (*size, 3)
    found = open_filler("learned").fill(
        np.full(shape, 128, np.uint8), np.full(size, 2.0, np.float32), np.zeros(shape, np.float32), hole, with_depth=True
    )
    assert found.colour.shape == shape and found.depth is not None and np.allclose(found.depth, 2.0, atol=0.01)
