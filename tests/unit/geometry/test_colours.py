"""sRGB and linear light."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.geometry.colours import linear16_from_srgb8, linear_from_srgb, srgb8_from_linear, srgb_from_linear


def test_middle_grey_has_a_fifth_of_the_light_of_white() -> None:
    # By hand: 0.04 / 12.92 on the straight part, ((0.5 + 0.055) / 1.055)^2.4 on the curve.
    np.testing.assert_allclose(linear_from_srgb([0.0, 0.04, 0.5, 1.0]), [0.0, 0.00309598, 0.21404114, 1.0], atol=1e-8)
    np.testing.assert_allclose(srgb_from_linear([0.0, 0.00309598, 0.21404114, 1.0]), [0.0, 0.04, 0.5, 1.0], atol=1e-7)


def test_values_beyond_black_and_white_are_clipped() -> None:
    assert linear_from_srgb([-1.0, 2.0]).tolist() == [0.0, 1.0]
    np.testing.assert_allclose(srgb_from_linear([-1.0, 2.0]), [0.0, 1.0], atol=1e-12)
    assert srgb8_from_linear([-np.inf, -1.0, 2.0, np.inf]).tolist() == [0, 0, 255, 255]


def test_nan_is_black_in_eight_bits_alone() -> None:
    assert srgb8_from_linear([np.nan, 1.0]).tolist() == [0, 255]
    assert np.isnan(srgb_from_linear([np.nan])).all()
    assert np.isnan(linear_from_srgb([np.nan])).all()


@pytest.mark.parametrize(("given", "computed"), [("f4", "f4"), ("f8", "f8"), ("f2", "f8"), ("u1", "f8")])
def test_float32_stays_and_all_else_becomes_float64(given: str, computed: str) -> None:
    values = np.array([[0, 1]], dtype=given)
    for found in (linear_from_srgb(values), srgb_from_linear(values)):
        assert found.dtype == computed
        assert found.shape == (1, 2)


def test_a_single_number_is_an_array_of_no_axes() -> None:
    assert float(linear_from_srgb(0.5)) == pytest.approx(0.21404114)
    assert int(srgb8_from_linear(0.2158605)) == 128


def test_eight_bits_survive_the_way_through_sixteen() -> None:
    every = np.arange(256, dtype=np.uint8).reshape(-1, 2)
    linear = linear16_from_srgb8(every)
    assert (linear.dtype, linear.shape) == (np.uint16, (128, 2))
    assert linear.ravel()[[0, 128, 255]].tolist() == [0, 14146, 65535]
    np.testing.assert_array_equal(srgb8_from_linear(linear / 65535.0), every)


def test_the_given_array_stays_as_it_is() -> None:
    values = np.array([-1.0, 0.5, np.nan], dtype=np.float32)
    before = values.copy()
    for convert in (linear_from_srgb, srgb_from_linear, srgb8_from_linear):
        convert(values)
    np.testing.assert_array_equal(values, before)
