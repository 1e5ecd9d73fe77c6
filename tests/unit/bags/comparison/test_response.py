"""Step responses of known systems."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.bags.comparison.response import axis_response, find_steps, linear_models

T = np.arange(0.0, 20.0, 1 / 60)
COMMAND_T = np.arange(0.0, 20.0, 0.05)
COMMAND = np.where((COMMAND_T >= 2.0) & (COMMAND_T < 6.0), 0.4, np.where((COMMAND_T >= 9.0) & (COMMAND_T < 13.0), -0.2, 0.0))
EDGES = ((2.0, 0.4), (6.0, -0.4), (9.0, -0.2), (13.0, 0.2))
"""(time, height) of the steps; commands are sent every 50 ms, and steps are at their times."""


def respond(shape: object, delay: float = 0.1) -> np.ndarray:
    """Returns the sum of the answers to all edges; ``shape`` maps seconds since the edge to a fraction of its height."""
    return np.asarray(sum(height * shape(T - edge - delay) for edge, height in EDGES))  # type: ignore[operator]


def first_order(constant: float) -> object:
    return lambda s: np.where(s > 0, 1.0 - np.exp(-np.maximum(s, 0.0) / constant), 0.0)


def second_order(w: float, damping: float) -> object:
    ringing = w * math.sqrt(1.0 - damping**2)

    def shape(s: np.ndarray) -> np.ndarray:
        s = np.maximum(s, 0.0)
        return 1.0 - np.exp(-damping * w * s) * (np.cos(ringing * s) + damping * w / ringing * np.sin(ringing * s))

    return shape


def ramp(rate: float) -> np.ndarray:
    return np.asarray(sum(np.sign(h) * np.clip((T - edge - 0.1) * rate, 0.0, abs(h)) for edge, h in EDGES))


def test_ramp_gives_delay_and_acceleration_limit() -> None:
    found = axis_response(COMMAND_T, COMMAND, T, ramp(0.8), least=0.05)
    assert len(found.steps) == 4
    assert found.delay == pytest.approx(0.1, abs=2e-3)
    assert found.median("acceleration") == pytest.approx(0.8, rel=0.01)
    assert found.median("overshoot") == pytest.approx(0.0, abs=1e-6)
    assert found.gain == pytest.approx(1.0, abs=1e-6)


def test_rise_time_of_a_ramp_is_that_of_its_middle_part() -> None:
    first = find_steps(COMMAND_T, COMMAND, T, ramp(0.8), least=0.05)[0]
    assert first.rise_time == pytest.approx(0.8 * 0.4 / 0.8, rel=0.01)


def test_first_order_system_is_identified() -> None:
    model = linear_models(COMMAND_T, COMMAND, T, 0.9 * respond(first_order(0.25), 0.12), least=0.05)[0]
    assert model.order == 1
    assert model.gain == pytest.approx(0.9, rel=0.01)
    assert model.time_constant == pytest.approx(0.25, rel=0.03)
    assert model.delay == pytest.approx(0.12, abs=0.01)


def test_second_order_system_is_identified() -> None:
    velocity = respond(second_order(8.0, 0.5), 0.08)
    model = linear_models(COMMAND_T, COMMAND, T, velocity, least=0.05)[0]
    assert model.order == 2
    assert 1.0 / model.time_constant == pytest.approx(8.0, rel=0.03)
    assert model.damping == pytest.approx(0.5, rel=0.05)
    assert model.delay == pytest.approx(0.08, abs=0.015)


def test_overshoot_is_that_of_the_damping() -> None:
    found = axis_response(COMMAND_T, COMMAND, T, respond(second_order(8.0, 0.5)), least=0.05)
    assert found.median("overshoot") == pytest.approx(math.exp(-math.pi * 0.5 / math.sqrt(0.75)), abs=0.01)


def test_noise_on_a_ramp_does_not_move_its_delay() -> None:
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(T))
    assert axis_response(COMMAND_T, COMMAND, T, ramp(0.8) + noise, least=0.05).delay == pytest.approx(0.1, abs=0.015)


def test_command_that_never_changes_has_no_response() -> None:
    found = axis_response(COMMAND_T, np.zeros_like(COMMAND_T), T, np.zeros_like(T), least=0.05)
    assert found.steps == found.models == ()
    assert math.isnan(found.delay)


def test_steps_too_close_to_each_other_are_ignored() -> None:
    busy = np.where(COMMAND_T % 1.0 < 0.5, 0.3, 0.0)
    assert find_steps(COMMAND_T, busy, T, np.zeros_like(T), least=0.05) == []


def test_time_out_of_a_command_is_a_step_to_zero() -> None:
    sent = COMMAND_T[(COMMAND_T >= 2.0) & (COMMAND_T < 6.0)]
    edges = ((2.0, 0.4), (float(sent[-1]) + 0.5, -0.4))
    velocity = np.asarray(sum(np.sign(h) * np.clip((T - at) * 2.0, 0.0, abs(h)) for at, h in edges))
    found = find_steps(sent, np.full(len(sent), 0.4), T, velocity, least=0.05)
    assert [step.after for step in found] == [0.4, 0.0]
    assert found[1].delay == pytest.approx(0.0, abs=0.02)
