"""Images side by side in targets: each has its place, none covers another."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from gibson_sim.render.draw.grouping import arrange

SIZES = st.lists(st.tuples(st.integers(1, 90), st.integers(1, 90)), max_size=40)


@given(SIZES, st.integers(90, 300))
def test_every_image_has_a_place_of_its_own_inside_its_target(sizes: list[tuple[int, int]], limit: int) -> None:
    seen: list[int] = []
    for numbers, tiles in arrange(sizes, limit):
        assert tiles.width <= limit and tiles.height <= limit
        taken = np.zeros((tiles.height, tiles.width), dtype=int)
        assert len(numbers) == len(tiles.places) > 0
        for number, (x, y) in zip(numbers, tiles.places, strict=True):
            width, height = sizes[number]
            assert 0 <= x <= tiles.width - width and 0 <= y <= tiles.height - height
            taken[y : y + height, x : x + width] += 1
        assert taken.max() == 1
        seen += numbers
    assert sorted(seen) == list(range(len(sizes)))


@given(SIZES, st.integers(90, 300))
def test_a_target_is_no_larger_than_its_images_need(sizes: list[tuple[int, int]], limit: int) -> None:
    for numbers, tiles in arrange(sizes, limit):
        ends = [(x + sizes[k][0], y + sizes[k][1]) for k, (x, y) in zip(numbers, tiles.places, strict=True)]
        assert (tiles.width, tiles.height) == (max(x for x, _ in ends), max(y for _, y in ends))


@given(st.tuples(st.integers(1, 60), st.integers(1, 60)), st.integers(1, 40), st.integers(60, 300))
def test_equal_images_stand_in_the_order_they_were_given(size: tuple[int, int], count: int, limit: int) -> None:
    targets = arrange([size] * count, limit)
    assert [number for numbers, _ in targets for number in numbers] == list(range(count))
    for _, tiles in targets:
        assert list(tiles.places) == sorted(tiles.places, key=lambda place: (place[1], place[0]))
        assert len(set(tiles.places)) == len(tiles.places)


def test_sixty_four_small_images_make_one_square() -> None:
    ((numbers, tiles),) = arrange([(32, 32)] * 64, 16384)
    assert (tiles.width, tiles.height) == (256, 256)
    assert set(tiles.places) == {(32 * column, 32 * row) for row in range(8) for column in range(8)}
    assert numbers == list(range(64))


def test_tall_and_flat_images_do_not_share_rows_in_turns() -> None:
    sizes = [(20, 90), (20, 10)] * 16
    ((_, tiles),) = arrange(sizes, 16384)
    assert tiles.width * tiles.height < 1.5 * sum(w * h for w, h in sizes)


def test_an_image_above_the_limit_is_alone() -> None:
    targets = arrange([(10, 10), (500, 20), (20, 500), (10, 10)], 100)
    alone = [(numbers, (tiles.width, tiles.height)) for numbers, tiles in targets if max(tiles.width, tiles.height) > 100]
    assert ([2], (20, 500)) in alone
    assert all(tiles.height <= 100 or numbers == [2] for numbers, tiles in targets)


def test_no_images_need_no_target() -> None:
    assert arrange([], 100) == []
