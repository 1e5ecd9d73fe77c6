"""A device is selected by its number or by its UUID; anything else is an error that lists the devices."""

from __future__ import annotations

import pytest

from gibson_sim.errors import GraphicsUnavailableError
from gibson_sim.render.context import device_number, format_uuid

UUIDS = ("01234567-89ab-cdef-0123-456789abcdef", "", "0123ffff-0000-0000-0000-000000000000")


def test_sixteen_bytes_are_written_as_nvidia_smi_does() -> None:
    assert format_uuid(bytes.fromhex("0123456789abcdef0123456789abcdef")) == UUIDS[0]


@pytest.mark.parametrize(
    ("wanted", "number"),
    [
        ("2", 2),
        ("17", 17),  # opening it reports whether it exists
        (UUIDS[0], 0),
        ("GPU-" + UUIDS[0], 0),
        (UUIDS[0].upper(), 0),
        (UUIDS[0].replace("-", ""), 0),
        (" 0123ffff ", 2),
        ("01234567-89", 0),
    ],
)
def test_a_number_a_uuid_and_its_beginning_choose_a_device(wanted: str, number: int) -> None:
    assert device_number(wanted, UUIDS) == number


@pytest.mark.parametrize(
    ("wanted", "problem"),
    [
        ("0123", "more than one"),
        ("ffff0000", "none"),
        ("first", "neither a number nor a UUID"),
        ("", "neither"),
        ("-1", "neither"),
    ],
)
def test_no_match_and_several_matches_are_errors_that_list_the_devices(wanted: str, problem: str) -> None:
    with pytest.raises(GraphicsUnavailableError) as caught:
        device_number(wanted, UUIDS)
    assert problem in str(caught.value)
    assert f"0: {UUIDS[0]}, 1: unknown, 2: {UUIDS[2]}" in str(caught.value)
