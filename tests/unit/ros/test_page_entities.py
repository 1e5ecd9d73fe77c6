"""Entities and rooms on the page, from the services of any simulator."""

from __future__ import annotations

import math
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from geometry_msgs.msg import Vector3  # noqa: E402
from simulation_interfaces.msg import EntityState, NamedPose  # noqa: E402
from simulation_interfaces.srv import GetEntitiesStates, GetEntityInfo, GetNamedPoseBounds, GetNamedPoses  # noqa: E402

from gibson_sim.ros.web.entities import Entities  # noqa: E402

pytestmark = pytest.mark.ros


class Services:
    """Stands in for the client of a simulation: it answers at once, unless it is told to wait."""

    def __init__(self) -> None:
        self.prepared: list[str] = []
        self.offered = True
        self.calls: list[Any] = []
        self.waiting: list[Any] = []
        self.waits = False

    def prepare(self, service: str) -> None:
        self.prepared.append(service)

    def is_offered(self, service: str) -> bool:
        return self.offered and service in self.prepared

    def begin(self, service: str, request: Any, on_response: Any) -> None:
        self.calls.append(request)
        response = {"get_entity_info": GetEntityInfo, "get_named_pose_bounds": GetNamedPoseBounds}[service].Response()
        response.result.result = 1
        if service == "get_entity_info":
            response.info.description = f"class of {request.entity}"
        else:
            response.bounds.points = [Vector3(x=2.0, y=1.5, z=1.0), Vector3(x=-1.0, y=-0.5)]  # the upper corner comes first
        if self.waits:
            self.waiting.append(lambda: on_response(response))
        else:
            on_response(response)


@pytest.fixture
def services() -> Services:
    return Services()


@pytest.fixture
def entities(services: Services) -> Entities:
    return Entities(services, lambda z: int(z > 2.0))  # type: ignore[arg-type]


def _states(**places: tuple[float, float, float, float]) -> Any:
    """Returns a response with entities at x, y, z (m) and yaw (rad)."""
    response = GetEntitiesStates.Response()
    for name, (x, y, z, yaw) in places.items():
        state = EntityState()
        state.pose.position.x, state.pose.position.y, state.pose.position.z = x, y, z
        state.pose.orientation.z, state.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        response.entities.append(name)
        response.states.append(state)
    return response


def test_an_entity_has_its_pose_its_floor_and_once_it_is_known_its_class(entities: Entities, services: Services) -> None:
    states = _states(cup=(1.0, 2.0, 3.0, 0.5), robot=(0.0, 0.0, 0.0, 0.0), lost=(math.nan, 0.0, 0.0, 0.0))
    entities.values(states, {"robot"})
    cup, robot = entities.values(states, {"robot"})
    assert cup == {"name": "cup", "x": 1.0, "y": 2.0, "z": 3.0, "yaw": 0.5, "floor": 1, "robot": False, "class": "class of cup"}
    assert (robot["robot"], robot["floor"]) == (True, 0)
    assert entities.places == {"cup": (1.0, 2.0, 1), "robot": (0.0, 0.0, 0)}
    assert sorted(request.entity for request in services.calls) == ["cup", "robot"], "each class is asked for once"


def test_classes_are_requested_a_few_at_a_time(entities: Entities, services: Services) -> None:
    services.waits = True
    states = _states(**{f"cup_{k}": (0.0, 0.0, 0.0, 0.0) for k in range(20)})
    for _ in range(3):
        entities.values(states, ())
    assert len(services.calls) == 8
    for answer in services.waiting:
        answer()
    entities.values(states, ())
    assert len(services.calls) == 16


def test_an_entity_respawned_under_the_same_name_is_requested_again(entities: Entities, services: Services) -> None:
    for states in (_states(cup=(0.0, 0.0, 0.0, 0.0)), _states(), _states(cup=(0.0, 0.0, 0.0, 0.0))):
        entities.values(states, ())
    assert len(services.calls) == 2


def _poses(*names: tuple[str, tuple[str, ...]]) -> Any:
    response = GetNamedPoses.Response()
    for name, tags in names:
        pose = NamedPose(name=name, tags=list(tags))
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = 10.0, 20.0, 2.9
        response.poses.append(pose)
    return response


def test_a_room_is_a_box_around_its_pose_without_the_prefix_of_its_floor(entities: Entities) -> None:
    poses = _poses(("floor_1/study", ("room", "floor_1")), ("start", ("start",)))
    entities.rooms(poses)
    assert entities.rooms(poses) == [{"name": "study", "floor": 1, "low": [9.0, 19.5], "high": [12.0, 21.5]}]


def test_rooms_of_another_world_are_requested_again(entities: Entities, services: Services) -> None:
    for name in ("floor_0/hall", "floor_0/kitchen"):
        entities.rooms(_poses((name, ("room",))))
    assert [request.name for request in services.calls] == ["floor_0/hall", "floor_0/kitchen"]
    assert [room["name"] for room in entities.rooms(_poses(("floor_0/kitchen", ("room",))))] == ["kitchen"]


def test_a_simulator_without_these_services_has_no_classes_and_no_rooms(entities: Entities, services: Services) -> None:
    services.offered = False
    [cup] = entities.values(_states(cup=(0.0, 0.0, 0.0, 0.0)), ())
    assert cup["class"] == "" and entities.rooms(_poses(("hall", ("room",)))) == [] and not services.calls
    assert "get_named_pose_bounds" in services.prepared
