"""What a strict run of the tests (``make check``) refuses: skips of tests that this machine can run, and too many second attempts.

``make setup`` brings ROS, EGL's software renderer, Numba, Gymnasium and the rest, so a test that finds one of them missing has found a fault.
"""

from __future__ import annotations

import re
from typing import Any

VARIABLE = "GIBSON_SIM_STRICT"
"""Set: the run is strict."""
FAILURES_VARIABLE = "GIBSON_SIM_TEST_FAILURES"
"""Names a file to which each run appends its failures, one line each: ``make test`` makes two runs and shows them all at its end."""
ALLOWED_SECOND_ATTEMPTS = 3
"""Of the 620 tests with nodes, so many may need a second attempt in one run, since a machine may stall for longer than DDS waits
(docs/ros_interfaces.md, known limits). The first failures are printed all the same; a test that fails again and again fails its second
attempt, too."""
MAY_BE_MISSING = {
    "graphics card": r"\bGPU\b|CUDA|graphics card|nvidia|UUIDs of their own",
    "PyTorch, CuPy and JAX": r"no (PyTorch|CuPy|JAX)\b|could not import '(torch|cupy|jax)'",
    "optional tools, which the package index has": r"Blender|Open3D|usd-core|coacd|mujoco|pyrender|no Ray\b",
    "worlds of others": r"no real worlds|GIBSON_SIM_TEST_DATA|not among the worlds",
    "rights of root": r"by root alone|needs? root\b|network namespace|unshare",
}
"""What a machine may lack -> how a skip names it. All else is installed by ``make setup``."""


def refused_skip(reason: str) -> bool:
    """Returns whether a test may not be skipped for this reason in a strict run."""
    return not any(re.search(pattern, reason) for pattern in MAY_BE_MISSING.values())


def faults(stats: dict[str, list[Any]]) -> list[str]:
    """Returns what a strict run refuses of all that happened, one line each.

    Args:
        stats: as pytest's terminal reporter counts them: "skipped" and "rerun" -> reports.
    """
    found = []
    for report in stats.get("skipped", ()):
        reason = str(report.longrepr[-1]) if isinstance(report.longrepr, tuple) else str(report.longrepr)
        if refused_skip(reason):
            found.append(f"{report.nodeid} was skipped although this machine can run it: {reason}")
    again = [report.nodeid for report in stats.get("rerun", ())]
    if len(again) > ALLOWED_SECOND_ATTEMPTS:
        found += [
            f"{test} needed a second attempt, as {len(again)} tests did, at most {ALLOWED_SECOND_ATTEMPTS} may: mend it"
            for test in again
        ]
    return found


def failures(stats: dict[str, list[Any]]) -> list[str]:
    """Returns the failed tests, and the modules that cannot be imported, each with the end of its traceback, in one line.

    Args:
        stats: as pytest's terminal reporter counts them: "failed", "error" and "rerun" -> reports.
    """
    return [
        f"{outcome}: {report.nodeid}: {_reason(report)}"
        for outcome in ("failed", "error", "rerun")
        for report in stats.get(outcome, ())
    ]


def _reason(report: Any) -> str:
    lines = [
        line[1:].strip() for line in report.longreprtext.splitlines() if line.startswith("E ")
    ] or report.longreprtext.splitlines()[-1:]
    return " ".join(lines)[:400]
