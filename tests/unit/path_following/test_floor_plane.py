"""An earlier image warped onto the present one: the floor covers itself, what stands on it does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.errors import ViewError
from gibson_path_following.obstacles.floor_plane import FloorPlane

WIDTH, HEIGHT, HFOV, CAMERA = 96, 64, math.radians(100.0), 0.46
FOCAL = WIDTH / 2.0 / math.tan(HFOV / 2.0)
POSE = np.array([-0.3, 0.08, 0.15])
"""Of the earlier camera in the frame of the present one."""


def seen(pose: NDArray[np.float64], height: float = 0.0) -> NDArray[np.uint8]:
    """Returns what a camera at a pose sees of a smooth pattern in a level plane at a height, by tracing rays; above the horizon grey."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    right, below = (u - (WIDTH - 1) / 2.0) / FOCAL, (v - (HEIGHT - 1) / 2.0) / FOCAL
    hits = below > 0.0
    ahead = (CAMERA - height) / np.where(hits, below, 1.0)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + c * ahead + s * right * ahead
    y = pose[1] + s * ahead - c * right * ahead
    value = 128.0 + 50.0 * np.sin(5.0 * x) + 50.0 * np.cos(4.0 * y)
    return np.repeat(np.where(hits, value, 128.0)[..., None], 3, axis=2).astype(np.uint8)


def difference(height: float) -> float:
    """Returns the mean difference, in the lower third of the image, of the earlier image warped onto the present one."""
    floor = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA)
    warped = floor.warp(seen(POSE, height), POSE)
    rows = slice(2 * HEIGHT // 3, None)
    known = warped[rows].any(axis=2)
    assert known.mean() > 0.7
    present = seen(np.zeros(3), height)[rows].astype(float)
    return float(np.abs(warped[rows].astype(float) - present)[known].mean())


def test_floor_covers_itself_and_what_is_above_it_does_not() -> None:
    assert difference(0.0) < 2.0
    assert difference(0.2) > 10.0


def test_image_from_the_same_place_stays_as_it_is() -> None:
    image = seen(np.zeros(3))
    warped = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).warp(image, np.zeros(3))
    assert np.abs(warped.astype(int) - image)[1:-1, 1:-1].max() <= 1


def test_far_pixels_move_with_the_rotation_alone() -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[: HEIGHT // 2, 48:50] = 255
    turn = 0.2  # the earlier camera looked farther to the left: what was in its middle is to the left now
    warped = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).warp(image, np.array([-0.4, 0.1, turn]))
    column = float(np.average(np.arange(WIDTH), weights=warped[HEIGHT // 2 - 3, :, 0].astype(float) + 1e-9))
    assert column == pytest.approx(48.5 - FOCAL * math.tan(turn), abs=1.0)


def test_pixels_that_the_earlier_camera_did_not_see_are_black() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    warped = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).warp(image, np.array([0.3, 0.0, 0.0]))
    assert not warped[-1, WIDTH // 2].any(), "nearer than the lowest row of a camera that stood ahead"
    with pytest.raises(ViewError, match="shape"):
        FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).warp(image[:, :50], POSE)
