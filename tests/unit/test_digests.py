from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gibson_sim.digests import digest_of


@dataclass(frozen=True)
class Reading:
    name: str
    stamp_ns: int
    ranges: object


def test_equal_values_have_equal_digests_and_stamps_do_not_count() -> None:
    first = Reading("scan", 1, np.arange(5.0))
    assert digest_of(first) == digest_of(replace(first, stamp_ns=2, ranges=np.arange(5.0)))


def test_a_known_value_keeps_its_digest_over_versions() -> None:
    assert digest_of((1, 2.5, "a", None, np.array([1, 2], np.uint8))) == 8936897090572274201


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (0.0, -0.0),
        (1, 1.0),
        (np.zeros(4), np.zeros((2, 2))),
        (np.zeros(4, np.float32), np.zeros(2, np.float64)),
        (np.array([1.0, 2.0]), np.array([1.0, np.nextafter(2.0, 3.0)])),
        (("ab", "c"), ("a", "bc")),
        (("a", ()), ("a",)),
        (None, ""),
        (b"a", "a"),
    ],
)
def test_arrays_that_differ_in_one_bit_or_in_shape_have_different_digests(a: object, b: object) -> None:
    assert digest_of(a) != digest_of(b)


def test_the_layout_of_an_array_does_not_matter() -> None:
    array = np.arange(12.0).reshape(3, 4)
    assert digest_of(array) == digest_of(np.asfortranarray(array))
    assert digest_of(array[:, ::2]) == digest_of(array[:, ::2].copy())


def test_values_without_a_digest_are_refused() -> None:
    with pytest.raises(TypeError, match="no digest of a object"):
        digest_of(object())
