"""Views of a path's camera from the images of a robot's cameras."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_path_following.errors import SettingError, ViewError
from gibson_path_following.images.cameras import Calibration, ViewAssembler, ViewCamera


def _columns(width: int, height: int) -> np.ndarray:
    """Returns an image whose red is its column."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = np.arange(width)
    return image


def _calibration(width: int, height: int, focal: float, d: tuple[float, ...] = (), model: str = "") -> Calibration:
    return Calibration(width, height, (focal, 0.0, (width - 1) / 2, 0.0, focal, (height - 1) / 2, 0.0, 0.0, 1.0), d, model)


def test_the_field_of_view_is_that_of_the_sides() -> None:
    assert math.degrees(_calibration(200, 100, 100.0).hfov()) == pytest.approx(90.0, abs=0.5)  # tan 45 degrees = 100 / 100
    fisheye = _calibration(200, 200, 200 / math.pi, (0.0, 0.0, 0.0, 0.0), "equidistant")  # 100 pixels at 90 degrees
    assert math.degrees(fisheye.hfov()) == pytest.approx(180.0, abs=1.0)


def test_an_image_of_the_same_camera_is_only_scaled() -> None:
    view = ViewCamera("pinhole", (100, 50), math.radians(90.0)).image(_columns(200, 100), _calibration(200, 100, 100.0))
    # Column 0 of the path's camera looks to where columns 0 and 1 of the robot's do.
    assert view.shape == (50, 100, 3)
    assert [abs(int(view[25, column, 0]) - (2 * column + 0.5)) <= 1.5 for column in (10, 49, 90)] == [True] * 3


def test_a_narrower_view_is_the_middle_of_the_image() -> None:
    hfov = 2.0 * math.atan(0.5)  # half the width at the same focal length
    calibrated = ViewCamera("pinhole", (50, 25), hfov).image(_columns(200, 100), _calibration(200, 100, 100.0))
    cut = ViewCamera("pinhole", (50, 25), hfov).image(_columns(200, 100), None, math.radians(90.0))
    for view in (calibrated, cut):
        assert abs(int(view[12, 0, 0]) - 50.5) <= 1.5 and abs(int(view[12, 49, 0]) - 148.5) <= 1.5


def test_distortion_is_removed() -> None:
    # Barrel distortion: at a tangent of 0.5 a point is seen at 0.5 (1 - 0.2 * 0.25) = 0.475.
    lens = _calibration(200, 100, 100.0, (-0.2, 0.0, 0.0, 0.0, 0.0), "plumb_bob")
    hfov = 2.0 * math.atan(0.5)
    view = ViewCamera("pinhole", (101, 51), hfov).image(_columns(200, 100), lens)
    assert int(view[25, 100, 0]) == pytest.approx(99.5 + 47.5, abs=1.0)
    assert int(view[25, 50, 0]) == pytest.approx(99.5, abs=1.0)


def test_a_fisheye_becomes_a_centred_circle() -> None:
    lens = _calibration(200, 200, 200 / math.pi, (0.0, 0.0, 0.0, 0.0), "equidistant")
    view = ViewCamera("fisheye_pair", (100, 100), math.pi).image(_columns(200, 200), lens)
    assert [int(view[50, column, 0]) for column in (0, 50, 99)] == pytest.approx([0.5, 100.5, 198.5], abs=1.5)


def test_a_camera_that_sees_less_is_refused() -> None:
    camera = ViewCamera("pinhole", (96, 64), math.radians(100.0))
    with pytest.raises(ViewError, match="the camera sees 90 degrees, that of the path 100"):
        camera.image(_columns(200, 133), _calibration(200, 133, 100.0))
    with pytest.raises(ViewError, match="sees 60 degrees, that of the path 100"):
        camera.image(_columns(200, 133), None, math.radians(60.0))
    for calibration in (None, _calibration(200, 60, 80.0)):
        with pytest.raises(ViewError, match="less upwards and downwards"):
            camera.image(_columns(200, 60), calibration)
    with pytest.raises(ViewError, match="200x100 pixels, its camera_info 100x50"):
        camera.image(_columns(200, 100), _calibration(100, 50, 20.0))


@pytest.mark.parametrize(
    ("values", "part"),
    [({"model": "magic"}, "distortion_model is 'magic'"), ({"d": (1.0,), "model": "plumb_bob"}, "d has 1 values"),
     ({"d": (math.nan,) * 4, "model": "plumb_bob"}, r"d is \(nan"), ({"d": (1e30,) * 4, "model": "plumb_bob"}, r"d is \(1e\+30"),
     ({"focal": -1.0}, "k is "), ({"focal": math.nan}, "k is "), ({"focal": 1e9}, "the focal lengths are 1e\\+09 and")],
)  # fmt: skip
def test_an_impossible_calibration_is_refused(values: dict[str, object], part: str) -> None:
    with pytest.raises(SettingError, match=part):
        _calibration(**{"width": 100, "height": 50, "focal": 50.0, **values})  # type: ignore[arg-type]


def test_images_of_one_time_make_a_view() -> None:
    front, back = _columns(8, 8), _columns(8, 8)
    pair = ViewAssembler("fisheye_pair", tolerance_ns=5)
    assert pair.add("front", 100, front) is None
    assert pair.add("back", 200, back) is None
    assert pair.add("front", 204, front) is not None
    assert pair.add("back", 205, back) is None, "each image is used once"
    stamp, view = ViewAssembler("pinhole").add("front", 7, front) or (0, ())
    assert stamp == 7 and len(view) == 1


@pytest.mark.parametrize(("cx", "cy"), [(0.0, 25.0), (-10.0, 25.0), (1e6, 25.0), (50.0, 49.0)])
def test_a_principal_point_outside_of_the_image_is_refused(cx: float, cy: float) -> None:
    with pytest.raises(SettingError, match=r"the principal point is .* must be within the 100x50 pixels of the images"):
        Calibration(100, 50, (50.0, 0.0, cx, 0.0, 50.0, cy, 0.0, 0.0, 1.0), (), "")


def test_a_lost_image_and_a_slow_camera_do_not_end_the_views() -> None:
    pair: ViewAssembler[str] = ViewAssembler("fisheye_pair", tolerance_ns=5)
    assert pair.gap_ns is None
    # The back camera's images arrive after the next two of the front; that of 100 is lost.
    assert [pair.add("front", stamp, f"front {stamp}") for stamp in (0, 50, 100)] == [None] * 3
    assert pair.add("back", 0, "back 0") == (0, ("front 0", "back 0"))
    assert pair.add("back", 51, "back 51") == (50, ("front 50", "back 51"))
    assert pair.add("front", 150, "front 150") is None
    assert pair.add("back", 175, "back 175") is None and pair.gap_ns == 25
    assert pair.add("back", 150, "back 150") == (150, ("front 150", "back 150"))
    pair.add("front", 200, "front 200")
    pair.clear()
    assert pair.add("back", 200, "back 200") is None
