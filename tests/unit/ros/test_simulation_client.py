"""Calls of services: waiting, refusals, late responses, and what a page is told of the end of its requests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "simulation_interfaces")

from rclpy.task import Future  # noqa: E402
from simulation_interfaces.srv import DeleteEntity, SetEntityState, SetSimulationState, SpawnEntity  # noqa: E402

from gibson_sim.errors import GibsonSimError  # noqa: E402
from gibson_sim.ros.client import simulation_client  # noqa: E402
from gibson_sim.ros.client.simulation_client import Awaited, SimulationClient, floor_pose, move_request, spawn_request  # noqa: E402
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
def test_a_result_code_is_interpreted_by_its_service(request_: Any, code: int, ok: bool) -> None:
    told: list[bool] = []
    services = SimulationClient(Answering(code))  # type: ignore[arg-type]
    SimulationRequests(services).ask(request_, lambda good, text: told.append(good))
    assert told == [ok]


def test_a_place_becomes_a_pose_just_above_the_floor() -> None:
    pose = spawn_request(floor_pose((1.0, 2.0, 3.141592653589793), 0.5), "mine", "ball").initial_pose
    assert (pose.header.frame_id, pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == ("map", 1.0, 2.0, 0.52)
    assert pose.pose.orientation.z == 1.0
    assert move_request("ball", floor_pose((1.0, 2.0, 0.0), 0.0)).state.pose.position.z == 0.02


class Service:
    """A node, and its client of one service, which a test offers and answers."""

    def __init__(self) -> None:
        self.is_offered = False
        self.futures: list[Any] = []
        self.dropped: list[Any] = []
        self.srv_name, self.srv_type = "/delete_entity", DeleteEntity

    def create_client(self, kind: Any, name: str) -> Service:
        assert (kind, name.lstrip("/")) == (self.srv_type, self.srv_name[1:])
        return self

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [(self.srv_name, ["simulation_interfaces/srv/DeleteEntity"])]

    def count_services(self, name: str) -> int:
        return int(self.is_offered)

    def service_is_ready(self) -> bool:
        return self.is_offered

    def call_async(self, request: Any) -> Any:
        self.futures.append(Future())
        return self.futures[-1]

    def remove_pending_request(self, future: Any) -> None:
        self.dropped.append(future)

    def answer(self, code: int = 1, text: str = "") -> None:
        response = DeleteEntity.Response()
        response.result.result, response.result.error_message = code, text
        self.futures[-1].set_result(response)


def _waiting(service: Service, code: int, waits: list[str]) -> Callable[[Callable[[], bool], Awaited], None]:
    """Returns how an owner waits whose node offers the service, and then answers it, only while it is spun."""

    def wait(condition: Callable[[], bool], awaited: Awaited) -> None:
        waits.append(f"{awaited} {condition()}")
        if awaited.is_sent:
            service.answer(code, "it is bolted down")
        else:
            service.is_offered = True
        assert condition()

    return wait


@pytest.mark.parametrize(("names_service", "text"), [(False, "it is bolted down"), (True, "/delete_entity: it is bolted down")])
def test_a_blocking_call_waits_for_the_service_then_for_its_response(names_service: bool, text: str) -> None:
    service, waits = Service(), list[str]()
    node: Any = service
    SimulationClient(node, _waiting(service, 1, waits)).ask("delete_entity", entity="chair")
    assert waits == ["service /delete_entity False", "response of /delete_entity False"]
    client = SimulationClient(node, _waiting(service, 4, waits), names_service=names_service)
    with pytest.raises(GibsonSimError) as error:
        client.ask("delete_entity", entity="chair")
    assert str(error.value) == text


def test_a_call_without_waiting_ends_with_its_response_or_with_none_if_no_node_offers_the_service() -> None:
    service, responses = Service(), list[Any]()
    node: Any = service
    client = SimulationClient(node)
    client.begin("delete_entity", DeleteEntity.Request(), responses.append)
    assert responses == [None]
    service.is_offered = True
    client.begin("delete_entity", DeleteEntity.Request(), responses.append)
    assert client.is_pending("delete_entity") and len(responses) == 1
    service.answer()
    assert not client.is_pending("delete_entity") and responses[1].result.result == 1


def test_a_late_call_is_reported_once_and_dropped_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now, service, responses, late = [100.0], Service(), list[Any](), list[str]()
    monkeypatch.setattr(simulation_client.time, "monotonic", lambda: now[0])
    service.is_offered = True
    node: Any = service
    client = SimulationClient(node)
    client.begin("delete_entity", DeleteEntity.Request(), responses.append, late.append)
    for now[0] in (104.9, 105.1, 106.0):
        client.check_pending()
    assert late == ["delete_entity has not answered for 5 s: its node may be busy, or hang"]
    now[0] = 160.1
    client.check_pending()
    assert service.dropped == service.futures and not client.is_pending("delete_entity")
    service.answer()
    assert responses == []


def test_a_polled_request_is_repeated_until_it_has_a_response(monkeypatch: pytest.MonkeyPatch) -> None:
    now, service = [100.0], Service()
    monkeypatch.setattr(simulation_client.time, "monotonic", lambda: now[0])
    node: Any = service
    client = SimulationClient(node)
    assert client.poll("delete_entity") is None and service.futures == []
    service.is_offered = True
    for now[0], count in ((100.1, 1), (101.0, 1), (101.2, 2)):
        assert client.poll("delete_entity") is None and len(service.futures) == count
    service.answer()
    assert client.poll("delete_entity").result.result == 1
    now[0] = 110.0
    assert client.poll("delete_entity").result.result == 1 and len(service.futures) == 2
