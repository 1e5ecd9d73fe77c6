"""Which state may follow which."""

from __future__ import annotations

import pytest

from gibson_sim.standard.codes import SimulationError, StateCode
from gibson_sim.standard.states import SimulationState, check_transition

STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD, LOADING_WORLD = SimulationState
OK = None
ALREADY, WRONG = StateCode.ALREADY_IN_TARGET_STATE, StateCode.INCORRECT_TRANSITION
TABLE = {
    # from: to stopped, playing, paused, quitting, no world, loading world
    STOPPED: (ALREADY, OK, OK, OK, WRONG, WRONG),
    PLAYING: (OK, ALREADY, OK, OK, WRONG, WRONG),
    PAUSED: (OK, OK, ALREADY, OK, WRONG, WRONG),
    QUITTING: (WRONG, WRONG, WRONG, ALREADY, WRONG, WRONG),
    NO_WORLD: (WRONG, WRONG, WRONG, OK, ALREADY, WRONG),
    LOADING_WORLD: (WRONG, WRONG, WRONG, OK, WRONG, ALREADY),
}


@pytest.mark.parametrize(
    ("now", "target", "code"), [(now, target, row[target]) for now, row in TABLE.items() for target in SimulationState]
)
def test_transition_is_allowed_or_refused_as_in_the_table(
    now: SimulationState, target: SimulationState, code: StateCode | None
) -> None:
    if code is OK:
        assert check_transition(now, int(target)) is target
        return
    with pytest.raises(SimulationError) as error:
        check_transition(now, int(target))
    assert error.value.code is code


@pytest.mark.parametrize("target", [6, 255])
def test_unknown_state_is_refused_with_the_known_ones(target: int) -> None:
    with pytest.raises(SimulationError, match="0 STOPPED, 1 PLAYING, 2 PAUSED, 3 QUITTING") as error:
        check_transition(PLAYING, target)
    assert error.value.code is WRONG
