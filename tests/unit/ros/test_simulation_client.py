"""What a page is told of the end of its requests."""

from __future__ import annotations

from typing import Any

import pytest

from support.simulation import require

require("rclpy", "simulation_interfaces")

from rclpy.task import Future  # noqa: E402
from simulation_interfaces.srv import SetEntityState, SetSimulationState, SpawnEntity  # noqa: E402

from gibson_sim.ros.client.simulation_client import SimulationClient, floor_pose, move_request, spawn_request  # noqa: E402
from gibson_sim.ros.web.simulation_requests import SimulationRequests  # noqa: E402
from gibson_sim.web.requests import Move, Spawn, Time  # noqa: E402

pytestmark = pytest.mark.ros


class Answering:
    """A node and its clients: each request ends with the same result code."""

    def __init__(self, code: int) -> None:
        self._code = code

    def create_client(self, kind: Any, name: str) -> Answering:
        self.kind = kind
        clone = Answering(self._code)
        clone.kind = kind
        return clone

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, request: Any) -> Any:
        response = self.kind.Response()
        response.result.result, response.result.error_message = self._code, ""
        future: Any = Future()
        future.set_result(response)
        return future


@pytest.mark.parametrize(
    ("request_", "code", "ok"),
    [
        (Time("pause"), SetSimulationState.Response.ALREADY_IN_TARGET_STATE, True),
        (Spawn("ball", 1.0, 2.0, 0.0), SpawnEntity.Response.NAME_NOT_UNIQUE, False),
        (Move("ball", 1.0, 2.0, 0.0), SetEntityState.Response.INVALID_POSE, False),
        (Move("ball", 1.0, 2.0, 0.0), 1, True),
    ],
)
def test_a_code_means_what_it_means_for_its_own_service(request_: Any, code: int, ok: bool) -> None:
    told: list[bool] = []
    services = SimulationClient(Answering(code))  # type: ignore[arg-type]
    SimulationRequests(services).ask(request_, lambda good, text: told.append(good))
    assert told == [ok]


def test_a_place_becomes_a_pose_just_above_the_floor() -> None:
    pose = spawn_request(floor_pose((1.0, 2.0, 3.141592653589793), 0.5), "mine", "ball").initial_pose
    assert (pose.header.frame_id, pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == ("map", 1.0, 2.0, 0.52)
    assert pose.pose.orientation.z == 1.0
    assert move_request("ball", floor_pose((1.0, 2.0, 0.0), 0.0)).state.pose.position.z == 0.02
