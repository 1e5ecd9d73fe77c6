"""Inputs of our filling networks."""

import numpy as np
import pytest

from gibson_sim.filling.inputs import network_input, packed

COLOUR = np.array([[[255, 0, 51], [9, 9, 9], [8, 8, 8], [255, 0, 51]]], dtype=np.uint8)
DEPTH = np.array([[2.0, np.inf, 4.0, 0.1]], dtype=np.float32)
NORMALS = np.array([[[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.6, 0.0, -0.8], [0.0, -1.0, 0.0]]], dtype=np.float32)
HOLE = np.array([[0, 1, 2, 0]], dtype=np.uint8)


@pytest.mark.parametrize("loops", [False, True])
def test_channels_are_colour_inverse_depth_normals_hole_and_back_face(loops: bool) -> None:
    channels = network_input(COLOUR, DEPTH, NORMALS, HOLE, loops=loops)
    assert channels.shape == (1, 9, 1, 4) and channels.dtype == np.float32
    assert np.allclose(channels[0, :, 0].T, [
        [1.0, 0.0, 0.2, 0.5, 0.0, 0.0, -1.0, 0.0, 0.0],
        [1.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],  # nothing: the colours around it
        [1.0, 0.0, 0.2, 0.25, 0.0, 0.0, 0.0, 1.0, 1.0],  # a back face: its depth is known
        [1.0, 0.0, 0.2, 5.0, 0.0, -1.0, 0.0, 0.0, 0.0],  # nearer than 0.2 m counts as 0.2 m
    ])  # fmt: skip


def test_loops_and_numpy_agree_to_the_bit() -> None:
    rng = np.random.default_rng(3)
    colour = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    depth = rng.uniform(0.05, 9.0, (20, 30)).astype(np.float32)
    normals = rng.standard_normal((20, 30, 3)).astype(np.float32)
    hole = rng.integers(0, 4, (20, 30)).astype(np.uint8)
    depth[hole == 1] = np.inf
    one, other = (packed(colour, depth, normals, hole, loops=loops) for loops in (False, True))
    assert np.array_equal(one, other)
