"""The page of formats lists the rules that the conformance tests check."""

from __future__ import annotations

from conformance.rules import PAGE, page


def test_formats_page_matches_the_conformance_tests() -> None:
    assert PAGE.read_text() == page(), "write it again: PYTHONPATH=tests python -m conformance.rules"
