"""The table of features, and the page that shows it."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.standard.features import FEATURES, feature_table, supported_features


def test_page_shows_the_table_that_the_service_answers_with(root: Path) -> None:
    assert feature_table() in (root / "docs" / "simulation_interfaces.md").read_text(encoding="utf-8")


def test_numbers_differ_and_are_sorted() -> None:
    numbers = [feature.number for feature in FEATURES]
    assert numbers == sorted(set(numbers))
    assert set(supported_features()) <= set(numbers)
