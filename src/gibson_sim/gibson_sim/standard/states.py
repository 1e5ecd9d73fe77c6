"""What a simulation can be doing, and how it gets from one state to another."""

from __future__ import annotations

from enum import IntEnum

from gibson_sim.standard.codes import SimulationError, StateCode


class SimulationState(IntEnum):
    """States of ``simulation_interfaces/SimulationState``."""

    STOPPED = 0
    """As after a launch: nothing moves, everything is at its start."""
    PLAYING = 1
    PAUSED = 2
    """Nothing moves, everything stays where it is."""
    QUITTING = 3
    """The process is about to end."""
    NO_WORLD = 4
    LOADING_WORLD = 5


HAS_WORLD = (SimulationState.STOPPED, SimulationState.PLAYING, SimulationState.PAUSED)
"""States in which there is something to play, pause, stop, look at and change."""


def check_transition(now: SimulationState, target: int) -> SimulationState:
    """Returns the target as a state, where a client may ask for it now.

    Stopped to paused is allowed: it starts paused, without a step, as SimulationState.msg describes. (SetSimulationState.srv names
    it as an example of an incorrect transition; one of the two has to give way.)

    Raises:
        SimulationError: StateCode.ALREADY_IN_TARGET_STATE or INCORRECT_TRANSITION.
    """
    if target not in list(SimulationState):
        known = ", ".join(f"{state.value} {state.name}" for state in (*HAS_WORLD, SimulationState.QUITTING))
        raise SimulationError(StateCode.INCORRECT_TRANSITION, f"there is no state {target}; a client may set {known}")
    wanted = SimulationState(target)
    if wanted is now:
        raise SimulationError(StateCode.ALREADY_IN_TARGET_STATE, f"the simulation is {now.name} already")
    if now is SimulationState.QUITTING:
        raise SimulationError(StateCode.INCORRECT_TRANSITION, "the simulation is QUITTING and will not come back")
    if wanted is SimulationState.QUITTING:
        return wanted
    if wanted not in HAS_WORLD:
        raise SimulationError(
            StateCode.INCORRECT_TRANSITION, f"{wanted.name} is no state to ask for; use LoadWorld and UnloadWorld"
        )
    if now not in HAS_WORLD:
        raise SimulationError(
            StateCode.INCORRECT_TRANSITION,
            f"the simulation is {now.name}, so it cannot become {wanted.name}; load a world first (LoadWorld)",
        )
    return wanted
