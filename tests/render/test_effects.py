"""Exposure, white balance, vignette, noise and averages of pictures, compared with NumPy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, RenderError
from gibson_sim.render.context import GlContext, open_context
from gibson_sim.render.draw.effects import EffectsPass, changes_colors, copy_image, noise_key, planckian_xy, white_balance_matrix
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.types import CameraSpec, ImageEffects

pytestmark = pytest.mark.egl
CAMERA = CameraSpec("eye", "", width=96, height=64, fov_y=math.pi / 2)
_SRGB8_ALPHA8 = 0x8C43
U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]


class Lab:
    """Applies effects to pictures."""

    def __init__(self, context: GlContext) -> None:
        self.context, self.gl, self.effects = context, context.gl, EffectsPass(context)
        self.out = RenderTarget(context, CAMERA.width, CAMERA.height)

    def texture(self, picture: U8) -> int:
        rgba = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
        height, width = picture.shape[:2]
        return int(self.gl.texture((width, height), 4, rgba.tobytes(), internal_format=_SRGB8_ALPHA8).glo)

    def apply(self, picture: U8 | None, camera: CameraSpec = CAMERA, stamp_ns: int = 7, **effects: float) -> U8:
        """Returns the picture, row 0 = top; None = the average."""
        seen = replace(camera, effects=ImageEffects(**effects))  # type: ignore[arg-type]
        self.effects.run(seen, stamp_ns, None if picture is None else self.texture(picture), self.out)
        data = self.gl.external_texture(self.out.textures["color"], (CAMERA.width, CAMERA.height), 4, 0, "f1").read()
        return np.frombuffer(data, np.uint8).reshape(CAMERA.height, CAMERA.width, 4)[:, :, :3]


@pytest.fixture(scope="module")
def lab(egl: None) -> Iterator[Lab]:
    context = open_context()
    made = Lab(context)
    yield made
    made.effects.close()
    made.effects.close()
    made.out.close()
    context.close()


def linear(picture: U8) -> F64:
    c = picture / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def srgb(light: F64) -> F64:
    """Returns values of 0 to 255."""
    c = np.clip(light, 0.0, 1.0)
    return 255.0 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)


def gradient() -> U8:
    """Returns a picture with all brightnesses, other in each channel and row."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return np.stack([u * 255 // 95, v * 255 // 63, (u + v) * 255 // 158], axis=-1).astype(np.uint8)


def grey(value: int) -> U8:
    return np.full((CAMERA.height, CAMERA.width, 3), value, np.uint8)


def assert_equal_within_one(got: U8, light: F64) -> None:
    """Checks that a picture equals the expected linear light within a grey level.

    Drivers may read and write sRGB by approximations, Mesa's are good to 0.0012 of linear light, which is more than a level in the
    dark; so there 1 / 255 of the light is enough.
    """
    off = np.abs(got - srgb(light)) > 1.0
    off &= np.abs(linear(got) - np.clip(light, 0.0, 1.0)) > 1.0 / 255.0
    assert not off.any()


def test_one_stop_doubles_the_light(lab: Lab) -> None:
    assert_equal_within_one(lab.apply(gradient(), exposure_ev=1.0), 2.0 * linear(gradient()))
    # sRGB 188 is half of the light.
    np.testing.assert_array_equal(lab.apply(grey(188), exposure_ev=1.0), grey(255))
    assert_equal_within_one(lab.apply(grey(255), exposure_ev=-1.0), np.full((64, 96, 3), 0.5))


def test_without_effects_the_pass_is_left_out_and_would_change_nothing(lab: Lab) -> None:
    assert not changes_colors(ImageEffects(shutter_s=0.1, readout_s=0.1, seed=5))
    np.testing.assert_array_equal(lab.apply(gradient()), gradient())


@pytest.mark.parametrize(
    "effects", [{"exposure_ev": 0.1}, {"white_balance_k": 6000.0}, {"vignette": 0.1}, {"shot_noise": 0.01}, {"read_noise": 0.01}]
)
def test_every_effect_on_colours_needs_the_pass(effects: dict[str, float]) -> None:
    assert changes_colors(ImageEffects(**effects))  # type: ignore[arg-type]


_BLACK_BODIES = [
    (2000.0, 0.5267, 0.4133), (2856.0, 0.4475, 0.4074), (5000.0, 0.3451, 0.3516), (6500.0, 0.3135, 0.3237), (10000.0, 0.2807, 0.2883)
]  # fmt: skip


@pytest.mark.parametrize(("kelvin", "x", "y"), _BLACK_BODIES)
def test_colours_of_black_bodies_are_those_of_the_tables(kelvin: float, x: float, y: float) -> None:
    assert planckian_xy(kelvin) == pytest.approx((x, y), abs=1.5e-3)


@pytest.mark.parametrize("kelvin", [2222.0, 4000.0])
def test_segments_of_the_black_body_curve_meet(kelvin: float) -> None:
    assert planckian_xy(kelvin - 1e-6) == pytest.approx(planckian_xy(kelvin), abs=2e-4)


def test_white_balance_makes_the_light_it_is_set_to_white(lab: Lab) -> None:
    # A wall lit by a bulb of 3000 K, as a camera set to daylight sees it.
    bulb = np.linalg.inv(white_balance_matrix(3000.0)) @ (0.3, 0.3, 0.3)
    assert bulb[0] > bulb[1] > bulb[2] > 0.0
    picture = np.broadcast_to(np.round(srgb(bulb)), (64, 96, 3)).astype(np.uint8)
    got = lab.apply(picture, white_balance_k=3000.0).astype(int)
    assert np.ptp(got[0, 0]) <= 2
    assert got[0, 0].mean() == pytest.approx(srgb(np.array(0.3)), abs=1.5)


def test_lower_colour_temperature_gives_a_bluer_picture_and_higher_a_redder_one(lab: Lab) -> None:
    cold, warm = (lab.apply(grey(128), white_balance_k=k)[0, 0].astype(int) for k in (4000.0, 10000.0))
    assert cold[2] > 128 + 20 and cold[0] < 128
    assert warm[2] < 128 and warm[0] > 128 + 5


def test_white_balance_is_the_matrix(lab: Lab) -> None:
    expected = linear(gradient()) @ white_balance_matrix(4500.0).T
    assert_equal_within_one(lab.apply(gradient(), white_balance_k=4500.0), expected)


def _cos4(camera: CameraSpec) -> F64:
    k = camera.intrinsics()
    v, u = np.mgrid[: camera.height, : camera.width]
    r = np.hypot((u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1])
    return np.cos(np.minimum(r, math.pi / 2) if camera.projection == "fisheye" else np.arctan(r)) ** 4


@pytest.mark.parametrize(
    "camera", [CAMERA, replace(CAMERA, matrix=(60.0, 0.0, 30.0, 0.0, 50.0, 40.0, 0.0, 0.0, 1.0)), replace(CAMERA, projection="fisheye", fov=3.0)],
    ids=["pinhole", "off-centre", "fisheye"],
)  # fmt: skip
def test_vignette_takes_its_share_in_the_farthest_corner_and_follows_the_fourth_power_of_the_cosine(
    lab: Lab, camera: CameraSpec
) -> None:
    got = lab.apply(grey(255), camera=camera, vignette=0.6)
    cos4 = _cos4(camera)
    light = 1.0 - 0.6 * (1.0 - cos4) / (1.0 - cos4.min())
    assert light.min() == pytest.approx(0.4)
    assert_equal_within_one(got, np.repeat(light[:, :, None], 3, axis=2))


def test_vignette_of_a_picture_of_the_whole_sphere_is_refused() -> None:
    with pytest.raises(ConfigError, match="no corners"):
        replace(CAMERA, projection="equirectangular", effects=ImageEffects(vignette=0.5))


def test_all_together_come_in_the_order_of_lens_exposure_and_white_balance(lab: Lab) -> None:
    cos4 = _cos4(CAMERA)
    light = linear(gradient()) * 2.0**0.7 * (1.0 - 0.5 * (1.0 - cos4) / (1.0 - cos4.min()))[:, :, None]
    expected = light @ white_balance_matrix(5200.0).T
    assert_equal_within_one(lab.apply(gradient(), exposure_ev=0.7, vignette=0.5, white_balance_k=5200.0), expected)


def _normal_numbers(key: tuple[int, int]) -> F64:
    """Returns what the shader calls normal_numbers, (H, W, 3)."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.uint32)
    h = [u, v, np.full_like(u, key[0]), np.full_like(u, key[1])]
    with np.errstate(over="ignore"):
        h = [x * np.uint32(1664525) + np.uint32(1013904223) for x in h]
        for k in range(2):
            h[0] = h[0] + h[1] * h[3]
            h[1] = h[1] + h[2] * h[0]
            h[2] = h[2] + h[0] * h[1]
            h[3] = h[3] + h[1] * h[2]
            if k == 0:
                h = [x ^ (x >> np.uint32(16)) for x in h]
    n = [((x >> np.uint32(9)) + 0.5) / 2**23 for x in h]
    r, a = [np.sqrt(-2.0 * np.log(n[k])) for k in (0, 1)], [2.0 * math.pi * n[k] for k in (2, 3)]
    return np.stack([r[0] * np.cos(a[0]), r[0] * np.sin(a[0]), r[1] * np.cos(a[1])], axis=-1)


def test_noise_is_the_formula_to_a_grey_level(lab: Lab) -> None:
    got = lab.apply(gradient(), stamp_ns=99, read_noise=0.02, shot_noise=0.05, seed=3)
    light = linear(gradient())
    key = noise_key(ImageEffects(seed=3), 99, "eye")
    assert_equal_within_one(got, light + np.sqrt(0.02**2 + 0.05**2 * light) * _normal_numbers(key))


@pytest.mark.parametrize(("value", "sigma"), [(0.2, 0.0412), (0.5, 0.06)])
def test_noise_has_the_requested_standard_deviation(lab: Lab, value: float, sigma: float) -> None:
    # Read noise 0.02 and shot noise 0.08: at a light of 0.2 the root of 0.0004 + 0.0064 * 0.2, at 0.5 of 0.0004 + 0.0064 * 0.5.
    start = grey(round(float(srgb(np.array(value)))))
    errors = linear(lab.apply(start, read_noise=0.02, shot_noise=0.08)) - linear(start)
    assert sigma == pytest.approx(math.sqrt(0.0004 + 0.0064 * value), rel=0.01)
    for channel in range(3):
        assert errors[:, :, channel].std() == pytest.approx(sigma, rel=0.04)
        assert abs(errors[:, :, channel].mean()) < 4 * sigma / math.sqrt(96 * 64)
    assert np.abs(np.corrcoef(errors.reshape(-1, 3).T) - np.eye(3)).max() < 0.05


def test_noise_of_neighbouring_pixels_is_independent(lab: Lab) -> None:
    errors = linear(lab.apply(grey(188), read_noise=0.05))[:, :, 0] - 0.5
    for one, other in ((errors[1:], errors[:-1]), (errors[:, 1:], errors[:, :-1])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.05


def test_same_seed_stamp_and_camera_give_the_same_pixels_and_others_do_not(lab: Lab) -> None:
    first = lab.apply(grey(188), read_noise=0.05)
    lab.apply(grey(188), stamp_ns=8, read_noise=0.05)
    np.testing.assert_array_equal(lab.apply(grey(188), read_noise=0.05), first)
    others = (
        lab.apply(grey(188), stamp_ns=8, read_noise=0.05),
        lab.apply(grey(188), read_noise=0.05, seed=1),
        lab.apply(grey(188), camera=replace(CAMERA, name="other"), read_noise=0.05),
    )
    for other in others:
        assert abs(np.corrcoef(first[:, :, 0].ravel().astype(float), other[:, :, 0].ravel().astype(float))[0, 1]) < 0.05


def test_average_of_black_and_white_is_half_of_the_light(lab: Lab) -> None:
    lab.effects.begin(CAMERA.width, CAMERA.height)
    lab.effects.add(lab.texture(grey(255)), slice(0, 64), 0.5)
    lab.effects.add(lab.texture(grey(0)), slice(0, 64), 0.5)
    assert_equal_within_one(lab.apply(None), np.full((64, 96, 3), 0.5))


def test_average_of_one_picture_is_that_picture(lab: Lab) -> None:
    lab.effects.begin(CAMERA.width, CAMERA.height)
    lab.effects.add(lab.texture(gradient()), slice(0, 64), 1.0)
    np.testing.assert_array_equal(lab.apply(None), gradient())


def test_rows_of_an_average_count_from_the_top(lab: Lab) -> None:
    lab.effects.begin(CAMERA.width, CAMERA.height)
    lab.effects.add(lab.texture(grey(255)), slice(0, 10), 1.0)
    lab.effects.add(lab.texture(gradient()), slice(10, 64), 1.0)
    got = lab.apply(None)
    np.testing.assert_array_equal(got[:10], 255)
    np.testing.assert_array_equal(got[10:], gradient()[10:])


def test_average_without_begin_is_refused(lab: Lab) -> None:
    context = open_context()
    fresh = EffectsPass(context)
    with pytest.raises(RenderError, match="call begin"):
        fresh.run(CAMERA, 0, None, lab.out)
    with pytest.raises(RenderError, match="call begin"):
        fresh.add(1, slice(0, 1), 1.0)
    context.close()
    lab.context.make_current()


def test_effects_in_place_change_their_own_image_and_nothing_beside_it(lab: Lab) -> None:
    context = lab.context
    sheet, part = RenderTarget(context, 200, 100), replace(CAMERA, effects=ImageEffects(exposure_ev=1.0))
    source = RenderTarget(context, 96, 64)
    lab.effects.run(CAMERA, 0, lab.texture(gradient()), source)
    for place in ((0, 0), (100, 30)):
        copy_image(context, source, sheet, ("color",), (0, 0, 96, 64), place)
    lab.effects.apply(part, 0, sheet, 100, 30)
    data = lab.gl.external_texture(sheet.textures["color"], (200, 100), 4, 0, "f1").read()
    got = np.frombuffer(data, np.uint8).reshape(100, 200, 4)[:, :, :3]
    assert_equal_within_one(got[30:94, 100:196], 2.0 * linear(gradient()))
    np.testing.assert_array_equal(got[:64, :96], gradient())
    assert not got[64:, :96].any() and not got[:30, 96:].any()
    sheet.close()
    source.close()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"exposure_ev": math.nan}, "exposure_ev is nan"),
        ({"white_balance_k": 1000.0}, "must be 1667 to 25000"),
        ({"vignette": 1.1}, "vignette is 1.1"),
        ({"shutter_s": 20.0}, "was it given in milliseconds"),
        ({"read_noise": -0.1}, "read_noise is -0.1"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ImageEffects(**settings)  # type: ignore[arg-type]
