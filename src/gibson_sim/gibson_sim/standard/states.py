"""The states of a simulation, and the transitions between them."""

from __future__ import annotations

from enum import IntEnum

from gibson_sim.standard.codes import SimulationError, StateCode


class SimulationState(IntEnum):
    """States of ``simulation_interfaces/SimulationState``."""

    STOPPED = 0
    """Time stands still, everything is at its start."""
    PLAYING = 1
    PAUSED = 2
    """Time stands still, everything stays where it is."""
    QUITTING = 3
    """The process is about to end."""
    NO_WORLD = 4
    LOADING_WORLD = 5


HAS_WORLD = (SimulationState.STOPPED, SimulationState.PLAYING, SimulationState.PAUSED)
"""States in which a world is loaded."""


def check_transition(now: SimulationState, target: int) -> SimulationState:
    """Returns the target as a state if a client may request it now.

    Stopped to paused is allowed: it starts paused, without a step, as SimulationState.msg describes. (SetSimulationState.srv names
    it as an example of an incorrect transition; the two contradict each other.)

    Raises:
        SimulationError: StateCode.ALREADY_IN_TARGET_STATE or INCORRECT_TRANSITION.
    """
    if target not in list(SimulationState):
        known = ", ".join(f"{state.value} {state.name}" for state in (*HAS_WORLD, SimulationState.QUITTING))
        raise SimulationError(StateCode.INCORRECT_TRANSITION, f"there is no state {target}; a client may set {known}")
    state = SimulationState(target)
    if state is now:
        raise SimulationError(StateCode.ALREADY_IN_TARGET_STATE, f"the simulation is {now.name} already")
    if now is SimulationState.QUITTING:
        raise SimulationError(StateCode.INCORRECT_TRANSITION, "the simulation is QUITTING and will not come back")
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
