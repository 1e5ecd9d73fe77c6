"""The parameters of the node."""

from __future__ import annotations

import pytest

from gibson_examples.errors import SettingError
from gibson_examples.settings import NavigationSettings


def test_defaults_are_allowed() -> None:
    assert NavigationSettings().goal == ""


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("goal", 3.0, r"parameter goal is 3.0, must be of type str"),
        ("max_linear", "fast", r"parameter max_linear is 'fast', must be of type float"),
        ("particles", 10.5, r"parameter particles is 10.5, must be of type int"),
        ("robot_radius", True, r"parameter robot_radius is True, must be of type float"),
        ("control_hz", 0.0, r"parameter control_hz is 0, must be 1 to 100"),
        ("initial_sigma_xy", -1.0, r"parameter initial_sigma_xy is -1, must be a finite number, 0 or more"),
        ("seed", -1, r"parameter seed is -1, must be 0 or more"),
    ],
)
def test_wrong_value_is_named_with_what_is_allowed(name: str, value: object, words: str) -> None:
    with pytest.raises(SettingError, match=f"^{words}"):
        NavigationSettings(**{name: value})  # type: ignore[arg-type]


def test_whole_number_serves_as_a_number() -> None:
    assert NavigationSettings(max_linear=1).max_linear == 1
