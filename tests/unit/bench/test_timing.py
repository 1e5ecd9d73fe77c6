"""Statistics of times, worked out by hand."""

from __future__ import annotations

import math
import os
import subprocess
import time
from pathlib import Path

import pytest

from gibson_sim_bench import timing
from gibson_sim_bench.timing import Rates, rates_of, ratio


def test_the_median_rate_is_one_over_the_median_time() -> None:
    assert rates_of([0.1, 0.5, 0.2]).median == pytest.approx(5.0)


def test_p5_is_the_slow_end_and_p95_the_fast_one() -> None:
    # 21 rates 10, 11, ... 30: five percent of the way from the first to the last is the second.
    found = rates_of([1.0 / rate for rate in range(30, 9, -1)])
    assert (found.p5, found.p95) == (pytest.approx(11.0), pytest.approx(29.0))


def test_no_times_are_no_rates() -> None:
    assert rates_of([]) == Rates(0.0, 0.0, 0.0)


def test_a_ratio_to_nothing_is_not_a_number() -> None:
    assert ratio(6.0, 4.0) == 1.5
    assert math.isnan(ratio(6.0, 0.0))


def test_the_machine_is_described_without_its_folders_and_names() -> None:
    import socket

    text = f"{timing.machine()} {timing.version()}"
    assert "/home" not in text
    assert socket.gethostname() not in text
    assert timing.cores() >= 1


def test_the_version_in_a_checkout_names_its_commit(root: Path) -> None:
    commit = subprocess.run(
        ["git", "-C", str(root), "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True, check=False
    )
    if commit.returncode:
        assert "(" not in timing.version()
    else:
        assert f"({commit.stdout.strip()}" in timing.version()


def test_process_cpu_s_is_the_cpu_time_of_this_process() -> None:
    before = time.process_time()
    found = timing.process_cpu_s(os.getpid())
    # The kernel counts in ticks of 10 ms, and threads of other tests may end meanwhile.
    assert before - 0.05 <= found <= time.process_time() + 0.05
