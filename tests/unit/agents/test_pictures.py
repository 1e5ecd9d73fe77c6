"""Pictures for an agent."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from gibson_sim.agents.pictures import picture


def decoded(png: bytes) -> np.ndarray:
    assert png.startswith(b"\x89PNG")
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]


def test_colours_and_rows_are_kept() -> None:
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:10, :, 0] = 200  # red, at the top
    png, found = picture(pixels, 640)
    assert np.array_equal(decoded(png), pixels)
    assert found == {"width": 64, "height": 48}


def test_a_large_picture_is_scaled_down_with_its_aspect_ratio() -> None:
    png, found = picture(np.full((480, 640, 3), 77, np.uint8), 160)
    assert found == {"width": 160, "height": 120}
    assert decoded(png).shape == (120, 160, 3)
    assert (decoded(png) == 77).all()


def test_depth_has_its_distances_as_text_and_no_depth_is_black() -> None:
    depth = np.full((50, 50), 2.0, np.float32)
    depth[:10] = np.inf
    depth[10:20] = 4.0
    png, found = picture(depth, 640)
    assert (found["nearest_m"], found["farthest_m"], found["middle_m"]) == (2.0, 4.0, 2.0)
    colours = decoded(png).astype(int)
    assert (colours[:10] == 0).all()
    assert colours[15, 0, 0] < colours[30, 0, 0], "nearer is redder"


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_depth_without_any_depth_is_a_picture_too(value: float) -> None:
    png, found = picture(np.full((8, 8), value, np.float32), 640)
    assert not decoded(png).any()
    assert found["depth"] == "none"
