"""Random numbers by seed, name, stamp and purpose."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.robots.noise import NoiseSource


def draw(name: str = "r/imu", seeds: tuple[int, ...] = (1, 2), stamp_ns: int = 5, purpose: int = 0) -> list[float]:
    return NoiseSource(name, *seeds).at(stamp_ns, purpose).standard_normal(4).tolist()


def test_equal_keys_give_equal_numbers() -> None:
    assert draw() == draw()


@pytest.mark.parametrize(
    "change", [{"name": "s/imu"}, {"seeds": (2, 1)}, {"seeds": (1, 2, 0)}, {"stamp_ns": 6}, {"stamp_ns": 2**62}, {"purpose": 1}]
)
def test_each_part_of_the_key_counts(change: dict[str, object]) -> None:
    assert not np.isclose(draw(), draw(**change)).any()  # type: ignore[arg-type]


def test_numbers_do_not_depend_on_what_was_drawn_before() -> None:
    source = NoiseSource("r/imu", 1, 2)
    source.at(4).integers(0, 3, 7, dtype=np.uint32)  # leaves half a number over
    assert source.at(5).standard_normal(4).tolist() == draw()


def test_numbers_of_neighbouring_stamps_do_not_overlap() -> None:
    source = NoiseSource("r/imu", 1)
    one, two = (set(source.at(stamp).random(10_000).tolist()) for stamp in (1, 2))
    assert not one & two
