"""The states of a simulation, and the transitions between them."""

from __future__ import annotations

from enum import IntEnum

from gibson_sim.standard.codes import SimulationError, StateCode


class SimulationState(IntEnum):
    """States of ``simulation_interfaces/SimulationState``."""

    STOPPED = 0
    """Time stands still, all entities are in their initial states."""
    PLAYING = 1
    PAUSED = 2
    """Time stands still, all entities keep their states."""
    QUITTING = 3
    """The process is about to end."""
    NO_WORLD = 4
    LOADING_WORLD = 5


HAS_WORLD = (SimulationState.STOPPED, SimulationState.PLAYING, SimulationState.PAUSED)
"""States in which a world is loaded."""


def check_transition(now: SimulationState, target: int) -> SimulationState:
    """Returns the target as a state if a client may request it now.

    STOPPED to PAUSED is allowed: the simulation starts paused, without a step, as SimulationState.msg describes. SetSimulationState.srv
    contradicts it, and gives this as an example of an incorrect transition.

    Raises:
        SimulationError: StateCode.ALREADY_IN_TARGET_STATE or INCORRECT_TRANSITION.
    """
    if target not in list(SimulationState):
        known = ", ".join(f"{state.value} {state.name}" for state in (*HAS_WORLD, SimulationState.QUITTING))
        raise SimulationError(StateCode.INCORRECT_TRANSITION, f"state {target} does not exist; a client may set {known}")
    state = SimulationState(target)
    if state is now:
        raise SimulationError(StateCode.ALREADY_IN_TARGET_STATE, f"the simulation is {now.name} already")
    if now is SimulationState.QUITTING:
        raise SimulationError(StateCode.INCORRECT_TRANSITION, "the simulation is QUITTING and cannot return to another state")
    if state is SimulationState.QUITTING:
        return state
    if state not in HAS_WORLD:
        raise SimulationError(StateCode.INCORRECT_TRANSITION, f"{state.name} cannot be requested; use LoadWorld and UnloadWorld")
    if now not in HAS_WORLD:
        raise SimulationError(
            StateCode.INCORRECT_TRANSITION,
            f"the simulation is {now.name}, so it cannot become {state.name}; load a world first (LoadWorld)",
        )
    return state
