"""What a strict run of the tests refuses."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from support import strict


@pytest.mark.parametrize(
    "reason", ["SKIPPED: no rclpy in this Python", "SKIPPED: EGL cannot be loaded", "could not import 'pybullet'"]
)
def test_a_skip_for_a_missing_package_of_make_setup_is_refused(reason: str) -> None:
    assert strict.refused_skip(reason)


@pytest.mark.parametrize(
    "reason", ["SKIPPED: no GPU here", "SKIPPED: Open3D is not here (no module)", "SKIPPED: no real worlds at /x"]
)
def test_a_skip_for_a_missing_optional_resource_is_allowed(reason: str) -> None:
    assert not strict.refused_skip(reason)


def test_a_few_second_attempts_are_allowed_and_more_are_refused() -> None:
    reports = [SimpleNamespace(nodeid=f"tests/x.py::test_{k}") for k in range(strict.ALLOWED_SECOND_ATTEMPTS)]
    assert strict.faults({"rerun": reports}) == []
    faults = strict.faults({"rerun": [*reports, SimpleNamespace(nodeid="tests/x.py::test_new")]})
    assert len(faults) == 4 and "tests/x.py::test_new needed a second attempt, as 4 tests did, at most 3 may: mend it" in faults


def test_each_failure_is_one_line_with_its_reason() -> None:
    failed = SimpleNamespace(
        nodeid="tests/unit/test_a.py::test_b",
        longreprtext="def test_b():\n>   assert 1 == 2\nE   assert 1 == 2\n\na.py:3: AssertionError",
    )
    broken = SimpleNamespace(nodeid="tests/unit/test_c.py", longreprtext="ImportError while importing\nNo module named 'd'")
    assert strict.failures({"failed": [failed], "error": [broken], "passed": [object()]}) == [
        "failed: tests/unit/test_a.py::test_b: assert 1 == 2",
        "error: tests/unit/test_c.py: No module named 'd'",
    ]
