"""``gibson-sim bench scaling`` with few steps, in this process."""

from __future__ import annotations

import logging

import pytest

from gibson_sim_bench.scaling import _case
from gibson_sim_bench.soak import environment_steps


@pytest.mark.parametrize(("kind", "value"), [("bodies", 2), ("robots", 2)])
def test_steps_of_a_world_with_several_things_take_time_and_memory(kind: str, value: int) -> None:
    try:
        ms, mb = _case(kind, value, 3)
    finally:
        logging.disable(logging.NOTSET)
    assert ms > 0.0
    assert mb > 20.0


def test_every_environment_step_is_counted_and_sampled() -> None:
    samples, episodes = environment_steps(3, samples=3)
    assert episodes == 1
    assert {name: len(values) for name, values in samples.values.items()} == {
        "environment MB": 3, "open files": 3, "environment steps /s": 3,
    }  # fmt: skip
