"""How requests end: what answers and goals say of success and of errors."""

from __future__ import annotations

import logging
from enum import IntEnum
from typing import Any

from simulation_interfaces.action import SimulateSteps

from gibson_sim.errors import GibsonSimError
from gibson_sim.standard.codes import Result, SimulationError, shortened

logger = logging.getLogger(__name__)


def end_goal(goal: Any, error: SimulationError | None) -> None:
    """Ends a goal: as cancelled where the client asked for that, else as aborted where there is an error."""

    def finish(handle: Any) -> Any:
        if handle.is_cancel_requested:
            handle.canceled()
        elif error is not None:
            handle.abort()
        else:
            handle.succeed()
        result = SimulateSteps.Result()
        return succeeded(result) if error is None else failed(result, error)

    goal.execute(finish)


def succeeded(response: Any, remark: str = "") -> Any:
    """Returns the response with RESULT_OK; GetSimulatorFeatures alone has no result."""
    if hasattr(response, "result"):
        response.result.result, response.result.error_message = int(Result.OK), remark
    return response


def failed(response: Any, error: Exception) -> Any:
    """Returns the response with the code and the text of an error; one that nobody foresaw is logged in full."""
    code: IntEnum = error.code if isinstance(error, SimulationError) else Result.OPERATION_FAILED
    text = str(error)
    if not isinstance(error, GibsonSimError):
        logger.error("a request failed for a reason that is a mistake of ours", exc_info=error)
        text = f"internal error: {type(error).__name__}; the log of the simulation says more"
    if hasattr(response, "result"):
        response.result.result, response.result.error_message = int(code), shortened(text)
    return response
