"""Requests of both versions of simulation_interfaces: 2.x has a ``Resource`` where 1.x has two strings, and flags in SetEntityState."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "simulation_interfaces")

from simulation_interfaces import msg, srv  # noqa: E402

from gibson_sim.ros.services import simulation_conversions as convert  # noqa: E402
from gibson_sim.scenes.spawning import Spawnable  # noqa: E402
from gibson_sim.standard.bounds import Bounds, BoundsType, OverlapTest  # noqa: E402
from gibson_sim.standard.codes import SimulationError  # noqa: E402
from gibson_sim.standard.requests import LoadRequest  # noqa: E402

pytestmark = pytest.mark.ros
RESOURCE = SimpleNamespace(uri="a.urdf", resource_string="<robot/>")


def spawn_message(**resource: Any) -> SimpleNamespace:
    pose = msg.NamedPose().pose
    pose.position.x, pose.orientation.w = 1.5, 0.25
    stamped = SimpleNamespace(header=SimpleNamespace(frame_id="table"), pose=pose)
    return SimpleNamespace(name="a", allow_renaming=True, entity_namespace="ns", initial_pose=stamped, **resource)


@pytest.mark.parametrize("fields", [{"entity_resource": RESOURCE}, vars(RESOURCE)], ids=["2.x", "1.x"])
def test_spawn_request_of_either_version(fields: dict[str, Any]) -> None:
    request = convert.spawn_request_from_msg(spawn_message(**fields))
    assert (request.uri, request.text) == ("a.urdf", "<robot/>")
    assert (request.name, request.allow_renaming, request.namespace, request.frame_id) == ("a", True, "ns", "table")
    assert (request.position, request.quat_xyzw) == ((1.5, 0.0, 0.0), (0.0, 0.0, 0.0, 0.25))


@pytest.mark.parametrize("fields", [{"world_resource": RESOURCE}, vars(RESOURCE)], ids=["2.x", "1.x"])
def test_load_request_of_either_version(fields: dict[str, Any]) -> None:
    message = SimpleNamespace(fail_on_unsupported_element=True, ignore_missing_or_unsupported_assets=False, **fields)
    assert convert.load_request_from_msg(message) == LoadRequest("a.urdf", "<robot/>", True, False)


def test_state_of_the_first_version_sets_everything() -> None:
    message = SimpleNamespace(entity="a", state=msg.EntityState())
    message.state.twist.linear.x, message.state.acceleration.angular.z = 1.0, 2.0
    change = convert.state_change_from_msg(message)
    assert (change.set_pose, change.set_twist, change.set_acceleration) == (True, True, True)
    assert (change.linear, change.acceleration) == ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 2.0))


def test_state_of_the_second_version_sets_what_its_flags_say() -> None:
    message = SimpleNamespace(entity="a", state=msg.EntityState(), set_pose=False, set_twist=True, set_acceleration=False)
    change = convert.state_change_from_msg(message)
    assert (change.set_pose, change.set_twist, change.set_acceleration) == (False, True, False)


def test_installed_messages_are_read_whichever_version_they_are() -> None:
    assert convert.spawn_request_from_msg(srv.SpawnEntity.Request()).uri == ""
    assert convert.spawn_request_from_msg(msg.SpawnEntity()).uri == ""
    assert convert.load_request_from_msg(srv.LoadWorld.Request()) == LoadRequest()
    made = convert.spawnable_to_msg(Spawnable("bot", "a robot", ((-1.0, -2.0, 0.0), (1.0, 2.0, 3.0))))
    assert (made.uri if hasattr(made, "uri") else made.entity_resource.uri) == "bot"
    assert [(p.x, p.y, p.z) for p in made.spawn_bounds.points] == [(1.0, 2.0, 3.0), (-1.0, -2.0, 0.0)]


def test_spawnable_of_the_second_version_has_a_resource(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convert, "RosSpawnable", lambda description: SimpleNamespace(description=description))
    assert convert.spawnable_to_msg(Spawnable("bot")).entity_resource.uri == "bot"


def test_too_many_points_are_refused_without_reading_them_all() -> None:
    message = msg.Bounds(type=msg.Bounds.TYPE_CONVEX_HULL, points=[convert.vector_to_msg((0.0, 0.0, 0.0))] * 10_000)
    bounds = convert.bounds_from_msg(message)
    assert len(bounds.points) < 300
    with pytest.raises(SimulationError):
        OverlapTest(bounds)


def test_bounds_survive_the_way_to_a_message_and_back() -> None:
    bounds = Bounds(BoundsType.SPHERE, ((1.0, 2.0, 3.0), (4.0, 0.0, 0.0)))
    assert convert.bounds_from_msg(convert.bounds_to_msg(bounds)) == bounds
