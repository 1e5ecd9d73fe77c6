"""Poses of links in the frames of other links, by hand and against matrices."""

from __future__ import annotations

import numpy as np

from gibson_sim.geometry.transforms import invert, matrices_from_poses, matrix_from_pose
from gibson_sim.ros.wire.fast_publish import RelativePoses
from gibson_sim.types import Pose

HALF = 0.5**0.5


def test_child_ahead_of_a_parent_that_looks_left_is_to_its_right() -> None:
    # The parent looks along +y of the world; the child is one metre along +x of the world, which is the parent's right, -y.
    positions = np.array([[2.0, 3.0, 0.0], [3.0, 3.0, 0.5]])
    quats = np.array([[0.0, 0.0, HALF, HALF], [0.0, 0.0, 0.0, 1.0]])
    found = RelativePoses([(0, 1)]).of(positions, quats)
    np.testing.assert_allclose(found, [[0.0, -1.0, 0.5, 0.0, 0.0, -HALF, HALF]], atol=1e-15)


def test_poses_agree_with_products_of_matrices() -> None:
    rng = np.random.default_rng(3)
    positions, quats = rng.normal(size=(5, 3)), rng.normal(size=(5, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    world_from = matrices_from_poses(positions, quats)
    pairs = [(0, 1), (0, 2), (3, 1), (4, 0), (2, 2)]
    for row, (parent, child) in zip(RelativePoses(pairs).of(positions, quats), pairs, strict=True):
        x, y, z, qx, qy, qz, qw = row
        assert qw >= 0.0
        T_parent_child = matrix_from_pose(Pose((x, y, z), (qx, qy, qz, qw)))
        np.testing.assert_allclose(T_parent_child, invert(world_from[parent]) @ world_from[child], atol=1e-12)
