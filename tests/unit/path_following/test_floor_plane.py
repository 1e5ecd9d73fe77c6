"""An earlier image brought onto the present one: the floor covers itself, what stands on it does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.errors import ViewError
from gibson_path_following.floor_plane import FloorPlane, ViewTrack
from gibson_path_following.types import Step

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
    """Returns the mean difference, in the lower third of the image, of the earlier image as brought and the present one."""
    floor = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA)
    brought = floor.brought(seen(POSE, height), POSE)
    rows = slice(2 * HEIGHT // 3, None)
    known = brought[rows].any(axis=2)
    assert known.mean() > 0.7
    present = seen(np.zeros(3), height)[rows].astype(float)
    return float(np.abs(brought[rows].astype(float) - present)[known].mean())


def test_floor_covers_itself_and_what_is_above_it_does_not() -> None:
    assert difference(0.0) < 2.0
    assert difference(0.2) > 10.0


def test_image_from_the_same_place_stays_as_it_is() -> None:
    image = seen(np.zeros(3))
    brought = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).brought(image, np.zeros(3))
    assert np.abs(brought.astype(int) - image)[1:-1, 1:-1].max() <= 1


def test_what_is_far_moves_with_the_turn_alone() -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[: HEIGHT // 2, 48:50] = 255
    turn = 0.2  # the earlier camera looked farther to the left: what was in its middle is to the left now
    brought = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).brought(image, np.array([-0.4, 0.1, turn]))
    column = float(np.average(np.arange(WIDTH), weights=brought[HEIGHT // 2 - 3, :, 0].astype(float) + 1e-9))
    assert column == pytest.approx(48.5 - FOCAL * math.tan(turn), abs=1.0)


def test_what_the_earlier_camera_did_not_see_is_black() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    brought = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).brought(image, np.array([0.3, 0.0, 0.0]))
    assert not brought[-1, WIDTH // 2].any(), "nearer than the lowest row of a camera that stood ahead"
    with pytest.raises(ViewError, match="shape"):
        FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA).brought(image[:, :50], POSE)


def test_the_earlier_view_is_the_one_from_about_a_quarter_of_a_metre_before() -> None:
    track = ViewTrack(0.1)
    images = [np.full((2, 2, 3), k, np.uint8) for k in range(6)]
    assert track.earlier() is None
    for image in images:
        track.add(image)
        track.move(Step(0.12, 0.0))
    found = track.earlier()
    assert found is not None
    np.testing.assert_array_equal(found[0], images[4])
    np.testing.assert_allclose(found[1], [-0.24, 0.0, 0.0], atol=1e-9)


def test_a_turn_in_place_gives_no_earlier_view() -> None:
    track = ViewTrack(0.0)
    for _ in range(8):
        track.add(np.zeros((2, 2, 3), np.uint8))
        track.move(Step(0.0, 0.1))
    assert track.earlier() is None
    track.move(Step(0.3, 0.0))
    assert track.earlier() is not None
    for _ in range(12):
        track.move(Step(0.0, 0.1))
    assert track.earlier() is None, "it looks elsewhere by now"


def test_a_cleared_track_has_no_views() -> None:
    track = ViewTrack(0.0)
    track.add(np.zeros((2, 2, 3), np.uint8))
    track.move(Step(0.3, 0.0))
    assert track.earlier() is not None
    track.clear()
    assert track.earlier() is None
