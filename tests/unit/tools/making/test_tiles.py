"""Base colours of generated scenes: periodic tiles and single pictures."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim_tools.making.blender.appearances import APPEARANCES, UNLIT
from gibson_sim_tools.making.tiles import PATTERNS, SINGLE_PICTURES, Tile, TileName, draw_tile, factors_of, is_tinted, tiles_of

TILED = ("plaster", "brick", "wood", "fabric", "parquet", "leather", "tile_30")
"""Patterns of each way of drawing; the others take long."""


def name_of(pattern: str) -> TileName:
    tint = next(color for p, color in APPEARANCES.values() if p == pattern)
    return TileName(pattern) if is_tinted(pattern) else TileName(pattern, tint)


def continues(pixels: NDArray[np.uint8]) -> bool:
    """Returns whether the step across the opposite edges of an image is no larger than the steps within it."""
    for axis in (0, 1):
        steps = np.abs(np.roll(pixels, -1, axis).astype(int) - pixels).mean(axis=(1 - axis, 2))
        if steps[-1] > 1.15 * steps[:-1].max():
            return False
    return True


@pytest.mark.parametrize("pattern", TILED)
def test_a_tile_continues_at_its_opposite_edges(pattern: str) -> None:
    assert continues(draw_tile(name_of(pattern)).pixels)


@pytest.mark.parametrize("pattern", ["brick", "wood"])
def test_a_part_of_a_tile_does_not_continue_at_its_opposite_edges(pattern: str) -> None:
    pixels = draw_tile(name_of(pattern)).pixels
    assert not continues(pixels[: len(pixels) * 5 // 8 + 1, : pixels.shape[1] * 3 // 5 + 2])


@pytest.mark.parametrize("pattern", TILED)
def test_a_tile_has_texels_of_at_most_two_millimetres(pattern: str) -> None:
    image = draw_tile(name_of(pattern))
    assert image.size[0] / image.pixels.shape[1] <= 0.00201
    assert image.size[1] / image.pixels.shape[0] <= 0.00201


@pytest.mark.parametrize("pattern", TILED)
def test_the_repetition_of_a_tile_does_not_strike_the_eye(pattern: str) -> None:
    linear = linear_from_srgb(draw_tile(name_of(pattern)).pixels / 255.0).mean(axis=2)
    rows, columns = (n // 4 for n in linear.shape)
    blocks = linear[: 4 * rows, : 4 * columns].reshape(4, rows, 4, columns).mean(axis=(1, 3))
    assert blocks.std() < 0.05 * blocks.mean()


@pytest.mark.parametrize("pattern", [p for p in TILED if is_tinted(p)])
def test_a_tinted_tile_has_the_colour_of_its_surface_on_average(pattern: str) -> None:
    image = draw_tile(name_of(pattern))
    tints = np.array([color for p, color in APPEARANCES.values() if p == pattern])
    factors = factors_of(image, pattern, tints)
    assert (factors <= 1.0).all()
    np.testing.assert_allclose(factors * image.mean, linear_from_srgb(tints), rtol=0.03)


def test_bricks_have_joints_of_the_same_grey_whatever_their_colour() -> None:
    red, white = (draw_tile(TileName("brick", APPEARANCES[name][1])).pixels.astype(int) for name in ("brick_red", "brick_white"))
    # The first row lies in a joint, the middle of the row of bricks above it in bricks.
    assert np.abs(red[0] - white[0]).mean() < 5
    assert np.abs(red[20] - white[20]).mean() > 40


def test_the_same_name_gives_the_same_tile() -> None:
    first, again = (draw_tile.__wrapped__(TileName("fabric")).pixels for _ in range(2))
    assert np.array_equal(first, again)


def test_every_appearance_has_a_tile_or_needs_none() -> None:
    assert {pattern for pattern, _ in APPEARANCES.values()} == {*PATTERNS, *UNLIT, "plain"}


def test_surfaces_share_a_tile_unless_their_pattern_has_colours_of_its_own() -> None:
    patterns = ["plaster", "brick", "art", "glass"]
    pattern = np.array([0, 0, 1, 1, 1, 2, 2, 3])
    tint = np.array([(0.9, 0.9, 0.9), (0.5, 0.5, 0.5), (0.6, 0.3, 0.2), (0.6, 0.3, 0.2), (0.8, 0.8, 0.8), *[(0.5, 0.5, 0.5)] * 3])
    coords = np.zeros((8, 3, 3))
    coords[6, :, 2] = 4.0
    names, index = tiles_of(patterns, pattern, tint, coords)
    assert index[7] == -1
    assert index[0] == index[1] and index[2] == index[3] != index[4] and index[5] != index[6]
    assert names[index[6]] == TileName("art", (0.5, 0.5, 0.5), 4)
    assert len({name.file for name in names}) == len(names) == 5


def test_a_single_picture_ends_at_the_middle_of_its_outermost_texels() -> None:
    assert SINGLE_PICTURES == ("rug", "art")
    picture = Tile(np.zeros((10, 20, 3), dtype=np.uint8), (2.0, 2.0), is_single=True)
    corners = picture.coords(np.array([[-1.0, -1.0, 7.0], [1.0, 1.0, 7.0], [0.0, 0.0, 7.0]]))
    np.testing.assert_allclose(corners, [(0.025, 0.05), (0.975, 0.95), (0.5, 0.5)])
    repeated = Tile(np.zeros((10, 10, 3), dtype=np.uint8), (0.5, 0.25), is_single=False)
    np.testing.assert_allclose(repeated.coords(np.array([1.0, 1.0, 0.0])), (2.0, 4.0))
