"""Link frames from the inertial frames that an engine moves, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.physics.frames import FrameTable, right_multiplication

QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def table(offset: tuple[float, float, float]) -> FrameTable:
    """One group whose frame is its inertial frame, and one link at ``offset``, rotated by 90 degrees about z."""
    eye = np.eye(4)[None]
    turned = right_multiplication(QUARTER)[None]
    return FrameTable(np.zeros((1, 3)), eye, np.zeros(1, np.intp), np.array([offset]), turned)


def raw(x: float) -> list[float]:
    """At x, rotated by 90 degrees about z, moving along y at 1 m/s and rotating about z at 2 rad/s."""
    return [x, 0.0, 0.0, *QUARTER, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0]


def test_link_off_the_centre_moves_with_the_turn() -> None:
    positions, quats, twists = table((1.0, 0.0, 0.0)).links(np.array([raw(5.0)]))
    assert positions[0] == pytest.approx((5.0, 1.0, 0.0))
    assert quats[0] == pytest.approx((0.0, 0.0, 1.0, 0.0))
    # 1 m away along +y, turning at 2 rad/s: 2 m/s along -x, beside the 1 m/s along y.
    assert twists[0] == pytest.approx((-2.0, 1.0, 0.0, 0.0, 0.0, 2.0))


def test_tables_side_by_side_give_what_each_gives_alone() -> None:
    one, other = table((1.0, 0.0, 0.0)), table((0.0, 3.0, 0.0))
    both = FrameTable.joined([one, other]).links(np.array([raw(1.0), raw(2.0)]))
    for row, (alone, x) in enumerate(((one, 1.0), (other, 2.0))):
        for part, whole in zip(alone.links(np.array([raw(x)])), both, strict=True):
            assert part[0].tobytes() == whole[row].tobytes()


def test_empty_frame_table_has_no_frames() -> None:
    positions, quats, twists = FrameTable.joined([]).links(np.zeros((0, 13)))
    assert (positions.shape, quats.shape, twists.shape) == ((0, 3), (0, 4), (0, 6))


@pytest.mark.parametrize("links", [1, 2, 3, 62])
def test_compiled_loops_give_the_frames_of_numpy_to_the_bit(links: int) -> None:
    rng = np.random.default_rng(links)
    groups = (links + 1) // 2
    turns = [right_multiplication(tuple((q / np.linalg.norm(q)).tolist())) for q in rng.normal(size=(groups + links, 4))]
    rows = np.sort(rng.integers(0, groups, links)).astype(np.intp)
    frames = FrameTable(
        rng.normal(size=(groups, 3)), np.array(turns[:groups]), rows, rng.normal(size=(links, 3)), np.array(turns[groups:])
    )
    for _ in range(20):
        moving = rng.normal(size=(groups, 13))
        moving[:, 3:7] /= np.linalg.norm(moving[:, 3:7], axis=1, keepdims=True)
        moving[rng.random(groups) < 0.3, 7:] = 0.0
        for ours, theirs in zip(frames.links(moving, loops=True), frames.links(moving, loops=False), strict=True):
            assert ours.tobytes() == theirs.tobytes()
