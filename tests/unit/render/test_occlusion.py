"""Boxes that are called hidden cannot be seen, whatever the depth image, the box and the pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.render.culling.occlusion import DepthPyramid, ScreenBounds, pixels_from_links
from gibson_sim.render.culling.occlusion_culling import TILE_PX, SubclusterTable, cull_hidden

NEAR = 0.05
K = np.array([[40.0, 1.5, 24.2], [0.0, 43.0, 15.7], [0.0, 0.0, 1.0]])
"""K of an image of 50 x 33 pixels."""
WIDTH, HEIGHT = 50, 33
BOTH = pytest.mark.parametrize("loops", [False, True], ids=["NumPy", "loops"])
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def _whole(*numbers: int) -> tuple[NDArray[np.int64], ...]:
    return tuple(np.array([n]) for n in numbers)


@given(st.integers(1, 37), st.integers(1, 37), st.integers(0, 2**32 - 1))
def test_the_bound_of_a_rectangle_is_below_all_its_values_and_is_one_of_those_around_it(
    width: int, height: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.random((height, width)).astype(np.float32)
    pyramid = DepthPyramid(depth)
    for _ in range(8):
        x0, x1 = np.sort(rng.integers(0, width, 2)).tolist()
        y0, y1 = np.sort(rng.integers(0, height, 2)).tolist()
        bound = float(pyramid.least(*_whole(x0, y0, x1, y1))[0])
        # At most two tiles a side, each at most twice as wide as the smallest tiles that the rectangle touches: no farther than this.
        reach = 2 * max(x1 - x0, y1 - y0) + 2 * TILE_PX
        around = depth[max(y0 - reach, 0) : y1 + reach + 1, max(x0 - reach, 0) : x1 + reach + 1]
        assert around.min() <= bound <= depth[y0 : y1 + 1, x0 : x1 + 1].min()


def test_the_bound_of_a_single_pixel_is_the_least_of_its_tile() -> None:
    depth = np.random.default_rng(1).random((7, 5)).astype(np.float32)
    y, x = (g.ravel() for g in np.mgrid[:7, :5])
    rows, columns = TILE_PX * (y // TILE_PX), TILE_PX * (x // TILE_PX)
    squares = [depth[row : row + TILE_PX, column : column + TILE_PX].min() for row, column in zip(rows, columns, strict=True)]
    np.testing.assert_array_equal(DepthPyramid(depth).least(x, y, x, y), squares)


def _hidden(
    loops: bool, depth: NDArray[np.float32], boxes: NDArray[np.float64], *T_camera_box: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Returns which boxes are hidden, by NumPy or by compiled loops; they have one pose, or one each."""
    T, n = np.stack(T_camera_box), len(boxes)
    if not loops:
        pixels = np.broadcast_to(pixels_from_links(T, K), (n, 3, 4))
        return ScreenBounds(boxes, pixels, (WIDTH, HEIGHT), NEAR).hidden(DepthPyramid(depth))
    every, link = np.arange(n), np.arange(n) if len(T) == n else np.zeros(n, dtype=np.int64)
    # Each box is a cluster of one subcluster, and no index range continues the one before.
    draws, span = np.zeros((n, 5), dtype=np.uint32), np.stack([np.full(n, 3), 100 * every], axis=1).astype(np.uint32)
    subclusters = SubclusterTable(every, np.ones(n, dtype=np.int64), boxes, span)
    seen, *_ = cull_hidden(depth, every, np.zeros(n, dtype=np.int64), draws, n, subclusters, link, T, K, NEAR)
    covered = np.ones(n, dtype=bool)
    covered[seen] = False
    return covered


def _pose(rng: np.random.Generator) -> NDArray[np.float64]:
    T = np.eye(4)
    quat = rng.normal(size=4)
    T[:3, :3] = matrix_from_quat(quat / np.linalg.norm(quat))
    T[:3, 3] = rng.uniform(-1.5, 1.5, 3)
    return T


def _blocks(rng: np.random.Generator) -> NDArray[np.float32]:
    """Returns a depth image of rectangles at several depths, with gaps."""
    depth = np.full((HEIGHT, WIDTH), NEAR / rng.uniform(1.0, 6.0), dtype=np.float32)
    for _ in range(rng.integers(0, 4)):
        x, y = rng.integers(0, WIDTH), rng.integers(0, HEIGHT)
        depth[y : y + rng.integers(1, 20), x : x + rng.integers(1, 25)] = rng.choice([0.0, NEAR / rng.uniform(0.2, 6.0)])
    return depth


def _seen(depth: NDArray[np.float32], box: NDArray[np.float64], T: NDArray[np.float64]) -> bool:
    """Returns whether any ray through a pixel's centre hits the box in front of the depth there."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([u, v, np.ones(u.shape)], axis=-1) @ np.linalg.inv(K).T
    way, eye = rays @ T[:3, :3], -T[:3, :3].T @ T[:3, 3]  # in the frame of the box
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (box[:3] - box[3:] - eye) / way, (box[:3] + box[3:] - eye) / way
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        first = np.maximum(enter, NEAR)
        return bool(((first <= leave) & (NEAR / first > depth)).any())


@BOTH
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_a_box_that_a_pixel_would_show_is_never_called_hidden(loops: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth, T = _blocks(rng), _pose(rng)
    boxes = np.concatenate([rng.uniform(-4, 4, (40, 3)), rng.uniform(0.01, 1.0, (40, 3)) ** 2], axis=1)
    for box, covered in zip(boxes, _hidden(loops, depth, boxes, T), strict=True):
        assert not (covered and _seen(depth, box, T))


@BOTH
def test_most_hidden_boxes_are_culled(loops: bool) -> None:
    # Otherwise "never hidden" would pass the test above.
    rng = np.random.default_rng(5)
    found, unseen = 0, 0
    for _ in range(20):
        depth, T = _blocks(rng), _pose(rng)
        boxes = np.concatenate([rng.uniform(-4, 4, (40, 3)), np.full((40, 3), 0.1)], axis=1)
        ahead = (boxes[:, :3] @ T[:3, :3].T + T[:3, 3])[:, 2] > 0.5
        covered = _hidden(loops, depth, boxes, T)[ahead]
        found += covered.sum()
        unseen += sum(not _seen(depth, box, T) for box in boxes[ahead])
    assert unseen > 200
    assert found > 0.9 * unseen


@BOTH
@pytest.mark.parametrize(
    ("centre", "expected"),
    [
        ((0.0, 0.0, 3.0), True),  # 2.9 m away, behind the wall
        ((0.0, 0.0, 2.05), False),  # it sticks out of the wall
        ((0.0, 0.0, 1.0), False),  # before it
        ((0.0, 0.0, -1.0), False),  # behind the camera: left to frustum culling
        ((0.0, 0.0, 0.1), False),  # around the near plane
        ((60.0, 0.0, 3.0), True),  # beside the image
    ],
)
def test_a_wall_hides_what_is_behind_it(loops: bool, centre: tuple[float, float, float], expected: bool) -> None:
    wall = np.full((HEIGHT, WIDTH), NEAR / 2.0, dtype=np.float32)
    box = np.array([[*centre, 0.1, 0.1, 0.1]])
    assert _hidden(loops, wall, box, np.eye(4)).tolist() == [expected]


@BOTH
def test_one_open_pixel_shows_what_is_behind_the_wall(loops: bool) -> None:
    wall = np.full((HEIGHT, WIDTH), NEAR / 2.0, dtype=np.float32)
    box = np.array([[0.0, 0.0, 4.0, 0.1, 0.1, 0.1]])
    wall[16, 24] = 0.0  # (0, 0, z) is at (24.2, 15.7)
    assert not _hidden(loops, wall, box, np.eye(4))[0]


@BOTH
def test_each_box_may_have_a_pose_of_its_own(loops: bool) -> None:
    wall = np.full((HEIGHT, WIDTH), NEAR / 2.0, dtype=np.float32)
    far, near = np.eye(4), np.eye(4)
    far[2, 3], near[2, 3] = 3.0, 1.0
    boxes = np.array([[0.0, 0.0, 0.0, 0.1, 0.1, 0.1]] * 2)
    assert _hidden(loops, wall, boxes, far, near).tolist() == [True, False]
