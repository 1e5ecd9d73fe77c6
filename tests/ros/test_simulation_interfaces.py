"""The standard simulation_interfaces, service by service in its order, against a simulation in a process of its own.

The room is 4 m x 4 m with the robot in its middle. A code that is not reached here: GetSimulatorFeatures has none, and the usual
places to look for worlds are always there, so DEFAULT_SOURCES_FAILED is in the unit tests alone.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.scenes import write_room
from support.simulation import Launched, Listener, require
from support.yard import BALL

require("rclpy", "gibson_msgs", "simulation_interfaces")

from action_msgs.msg import GoalStatus  # noqa: E402
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Twist, Vector3  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from simulation_interfaces import msg, srv  # noqa: E402
from simulation_interfaces.action import SimulateSteps  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from gibson_sim.standard import codes  # noqa: E402
from gibson_sim.standard.features import FEATURES  # noqa: E402
from gibson_sim.standard.states import SimulationState  # noqa: E402
from support.clients import client_of  # noqa: E402

pytestmark = pytest.mark.ros

STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD, LOADING_WORLD = range(6)
UNSUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, FAILED = range(5)
ALL, TIME, STATE, SPAWNED = 0, 1, 2, 4
HUGE = 10**12
WORLD = """<sdf version="1.9"><world name="{name}">{inside}
<model name="slab"><static>true</static><link name="l"><collision name="c"><geometry>
<box><size>9 9 0.2</size></box></geometry></collision></link></model>
</world></sdf>"""
MESH = (
    '<model name="m"><static>true</static><link name="l"><visual name="v"><geometry><mesh><uri>{uri}</uri></mesh></geometry>'
    "</visual></link></model>"
)


class Client:
    """Calls services and waits for their answers."""

    def __init__(self, listener: Listener) -> None:
        self.listener = listener
        self._services = client_of(listener)

    def send(self, kind: Any, **fields: Any) -> Any:
        """Returns the future of a request."""
        name = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
        return self._services.send(name, kind.Request(**fields))

    def call(self, kind: Any, **fields: Any) -> Any:
        """Returns the response."""
        future = self.send(kind, **fields)
        self.listener.spin_until(future.done, f"answer of {kind.__name__}")
        return future.result()

    def code(self, kind: Any, **fields: Any) -> int:
        """Returns the result code; a failure must come with one line of text that is not long."""
        result = self.call(kind, **fields).result
        if result.result != OK:
            assert result.error_message
            assert "\n" not in result.error_message
            assert len(result.error_message) < 1000
        return int(result.result)

    @property
    def state(self) -> int:
        return int(self.call(srv.GetSimulationState).state.state)

    @state.setter
    def state(self, wanted: int) -> None:
        if self.state != wanted:
            assert self.set_state(wanted) == OK

    def set_state(self, wanted: int) -> int:
        return self.code(srv.SetSimulationState, state=msg.SimulationState(state=wanted))

    def names(self, **filters: Any) -> list[str]:
        return list(self.call(srv.GetEntities, filters=msg.EntityFilters(**filters)).entities)

    def position(self, entity: str) -> tuple[float, float, float]:
        at = self.call(srv.GetEntityState, entity=entity).state.pose.position
        return at.x, at.y, at.z

    def spawn(self, text: str = BALL, **fields: Any) -> int:
        return self.code(srv.SpawnEntity, resource_string=text, **fields)

    def now_ns(self) -> int:
        """Simulation time of the state of the robot."""
        stamp = self.call(srv.GetEntityState, entity="robot").state.header.stamp
        return int(stamp.sec * 10**9 + stamp.nanosec)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, orientation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    qx, qy, qz, qw = orientation
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def placed(frame: str = "", **at: Any) -> PoseStamped:
    return PoseStamped(header=Header(frame_id=frame), pose=pose(**at))


def state_of(frame: str = "", linear: Vector3 | None = None, **at: Any) -> msg.EntityState:
    return msg.EntityState(header=Header(frame_id=frame), pose=pose(**at), twist=Twist(linear=linear or Vector3()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, root: Path) -> Path:
    """A room, a robot of our own, a ball, and worlds with something missing."""
    folder = tmp_path_factory.mktemp("standard")
    write_room(folder / "room")
    shutil.copytree(root / "config" / "robots" / "gibson_bot", folder / "bot")
    (folder / "ball.urdf").write_text(BALL)
    (folder / "thing.fbx").write_bytes(b"nothing that can be read")
    worlds = {
        "good": "",
        "missing": MESH.format(uri="not_there.glb"),
        "unsupported_asset": MESH.format(uri="thing.fbx"),
        "unsupported_element": '<actor name="walker"/>',
    }
    for name, inside in worlds.items():
        (folder / f"{name}.sdf").write_text(WORLD.format(name=name, inside=inside))
    (folder / "broken.sdf").write_text("<sdf><world name='broken'>")
    return folder


@pytest.fixture(scope="module")
def sim(ros_domain: int, folder: Path) -> Iterator[Launched]:
    launched = Launched("run", "--no-render", "--scene", str(folder / "room"), "--robot", str(folder / "bot"))
    launched.wait_for_line("collision shapes")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)
    assert not any("Traceback" in line for line in launched.lines), "\n".join(launched.lines)


@pytest.fixture(scope="module")
def client(sim: Launched, ros_context: Any) -> Iterator[Client]:
    """One for all tests: discovery of clients and services takes longer than most of the tests."""
    listener = Listener(ros_context)
    yield Client(listener)
    listener.close()


@pytest.fixture
def start(client: Client, folder: Path) -> Client:
    """The room and its robot, paused at time 0. Once another world was loaded, the robot is a spawned one."""
    if client.state == NO_WORLD or client.call(srv.GetCurrentWorld).world.name != "tiny_room":
        assert client.code(srv.LoadWorld, uri=str(folder / "room")) == OK
    client.state = PAUSED
    assert client.code(srv.ResetSimulation, scope=ALL) == OK
    if "robot" not in client.names():
        assert client.code(srv.SpawnEntity, name="robot", uri=str(folder / "bot")) == OK
    return client


# Codes, features


@pytest.mark.parametrize(
    ("ours", "theirs", "prefix"),
    [
        (codes.Result, msg.Result, "RESULT_"),
        (SimulationState, msg.SimulationState, "STATE_"),
        (codes.StateCode, srv.SetSimulationState.Response, ""),
        (codes.SpawnCode, srv.SpawnEntity.Response, ""),
        (codes.SpawnCode, msg.SpawnResult, ""),
        (codes.SpawnEntitiesCode, srv.SpawnEntities.Response, ""),
        (codes.EntityStateCode, srv.SetEntityState.Response, ""),
        (codes.WorldsCode, srv.GetAvailableWorlds.Response, ""),
        (codes.WorldCode, srv.GetCurrentWorld.Response, ""),
        (codes.WorldCode, srv.UnloadWorld.Response, ""),
        (codes.LoadWorldCode, srv.LoadWorld.Response, ""),
    ],
)
def test_our_numbers_are_those_of_the_messages(ours: Any, theirs: Any, prefix: str) -> None:
    assert {code.name: code.value for code in ours} == {code.name: getattr(theirs, prefix + code.name) for code in ours}


def test_features_are_those_of_the_message_and_of_our_table(client: Client) -> None:
    answer = client.call(srv.GetSimulatorFeatures).features
    assert {f.name: f.number for f in FEATURES} == {f.name: getattr(msg.SimulatorFeatures, f.name) for f in FEATURES}
    assert list(answer.features) == [f.number for f in FEATURES if f.supported]
    assert {"urdf", "sdf"} <= set(answer.spawn_formats)
    assert answer.custom_info


# Get/SetSimulationState


def test_states_change_as_requested(start: Client) -> None:
    for wanted in (PLAYING, PAUSED, PLAYING, STOPPED, PLAYING, STOPPED, PAUSED):
        assert start.set_state(wanted) == OK
        assert start.state == wanted


def test_time_stands_still_while_paused_and_runs_while_playing(start: Client) -> None:
    assert start.now_ns() == 0
    start.state = PLAYING
    start.listener.spin_until(lambda: start.now_ns() > 0, "time")
    start.state = PAUSED
    then = start.now_ns()
    clocks = start.listener.collect(Clock, "/clock")
    for _ in range(20):
        assert start.now_ns() == then
    assert clocks == []


def test_stopping_brings_back_the_start(start: Client) -> None:
    start.state = PLAYING
    assert start.spawn(initial_pose=placed(x=1.0, z=1.0)) == OK
    assert start.set_state(STOPPED) == OK
    assert start.now_ns() == 0
    assert start.names() == ["robot"]


@pytest.mark.parametrize(("wanted", "code"), [(PAUSED, 101), (NO_WORLD, 103), (LOADING_WORLD, 103), (77, 103)])
def test_state_that_cannot_be_set_is_refused(start: Client, wanted: int, code: int) -> None:
    assert start.set_state(wanted) == code
    assert start.state == PAUSED


def test_stop_is_a_transition_error_where_the_start_cannot_be_brought_back(start: Client, folder: Path) -> None:
    assert start.code(srv.DeleteEntity, entity="robot") == OK
    urdf = next((folder / "bot").glob("*.urdf"))
    urdf.rename(urdf.with_suffix(".away"))
    try:
        assert start.set_state(STOPPED) == 102
        assert start.state == PAUSED
    finally:
        urdf.with_suffix(".away").rename(urdf)
    assert start.set_state(STOPPED) == OK
    assert start.names() == ["robot"]


# ResetSimulation


@pytest.mark.parametrize(
    ("scope", "rewound", "moved_back", "despawned"),
    [(ALL, 1, 1, 1), (255, 1, 1, 1), (TIME, 1, 0, 0), (STATE, 0, 1, 0), (SPAWNED, 0, 0, 1), (TIME | SPAWNED, 1, 0, 1)],
)
def test_reset_affects_its_scope_alone(start: Client, scope: int, rewound: int, moved_back: int, despawned: int) -> None:
    assert start.code(srv.StepSimulation, steps=24) == OK
    assert start.code(srv.SetEntityState, entity="robot", state=state_of(x=1.0, y=-1.0)) == OK
    assert start.spawn(initial_pose=placed(x=-1.0, z=1.0)) == OK
    assert start.code(srv.ResetSimulation, scope=scope) == OK
    assert start.now_ns() == (0 if rewound else 100_000_000)
    assert start.position("robot")[:2] == pytest.approx((0.0, 0.0) if moved_back else (1.0, -1.0), abs=1e-6)
    assert ("ball" not in start.names()) is bool(despawned)


def test_reset_while_playing_goes_on_playing(start: Client) -> None:
    start.state = PLAYING
    assert start.code(srv.ResetSimulation) == OK
    assert start.state == PLAYING
    start.listener.spin_until(lambda: start.now_ns() > 0, "time")


def test_reset_of_an_unknown_scope_fails(start: Client) -> None:
    assert start.code(srv.ResetSimulation, scope=8) == FAILED


# StepSimulation, SimulateSteps


@pytest.mark.parametrize("steps", [0, 1, 240, 1000])
def test_steps_pass_exactly_and_it_is_paused_again(start: Client, steps: int) -> None:
    assert start.code(srv.StepSimulation, steps=steps) == OK
    assert start.now_ns() == steps * 10**9 // 240
    assert start.state == PAUSED


@pytest.mark.parametrize("state", [PLAYING, STOPPED])
def test_steps_fail_unless_paused(start: Client, state: int) -> None:
    start.state = state
    assert start.code(srv.StepSimulation) == FAILED


def test_endless_steps_leave_the_server_alive_and_end_when_it_is_paused(start: Client) -> None:
    steps = start.send(srv.StepSimulation, steps=HUGE)
    start.listener.spin_until(lambda: start.now_ns() > 0, "steps")
    assert not steps.done()
    assert start.names() == ["robot"]
    assert start.set_state(PAUSED) == OK
    start.listener.spin_until(steps.done, "end of the steps")
    assert steps.result().result.result == FAILED
    assert f"of {HUGE} steps" in steps.result().result.error_message


def test_client_that_goes_away_during_its_steps_does_no_harm(start: Client, other_listener: Listener) -> None:
    gone = Client(other_listener)
    gone.send(srv.StepSimulation, steps=HUGE)
    other_listener.spin_until(lambda: gone.now_ns() > 0, "steps")
    other_listener.node.destroy_node()
    assert start.set_state(PAUSED) == OK
    assert start.code(srv.StepSimulation) == OK


def goal(client: Client, steps: int, feedback: Callable[[Any], None] | None = None, actions: Any = None) -> Any:
    """Returns the handle of a goal that was accepted, and its client, which must live as long."""
    actions = actions or ActionClient(client.listener.node, SimulateSteps, "simulate_steps")
    client.listener.spin_until(actions.server_is_ready, "action server")
    sent = actions.send_goal_async(SimulateSteps.Goal(steps=steps), feedback_callback=feedback)
    client.listener.spin_until(sent.done, "goal")
    assert sent.result().accepted
    return sent.result(), actions


def result_of(client: Client, handle: Any) -> Any:
    future = handle.get_result_async()
    client.listener.spin_until(future.done, "result")
    return future.result()


def test_action_reports_every_step_and_succeeds(start: Client) -> None:
    first: list[Any] = []
    seen: list[tuple[int, int]] = []
    # The server's first feedback is lost while it has not found the client yet.
    handle, actions = goal(start, HUGE, first.append)
    start.listener.spin_until(lambda: bool(first), "feedback")
    assert start.code(srv.ResetSimulation) == OK
    assert result_of(start, handle).status == GoalStatus.STATUS_ABORTED
    handle, _ = goal(start, 8, lambda m: seen.append((m.feedback.completed_steps, m.feedback.remaining_steps)), actions=actions)
    # The client receives feedback until it has the result.
    start.listener.spin_until(lambda: len(seen) == 8, "feedback")
    ended = result_of(start, handle)
    assert seen == [(i, 8 - i) for i in range(1, 9)]
    assert (ended.status, ended.result.result.result) == (GoalStatus.STATUS_SUCCEEDED, OK)
    assert start.now_ns() == 8 * 10**9 // 240
    actions.destroy()


def test_action_can_be_cancelled_in_the_middle(start: Client) -> None:
    seen: list[int] = []
    handle, actions = goal(start, HUGE, lambda m: seen.append(m.feedback.completed_steps))
    start.listener.spin_until(lambda: bool(seen), "feedback")
    cancelled = handle.cancel_goal_async()
    start.listener.spin_until(cancelled.done, "cancellation")
    assert len(cancelled.result().goals_canceling) == 1
    ended = result_of(start, handle)
    assert (ended.status, ended.result.result.result) == (GoalStatus.STATUS_CANCELED, FAILED)
    then = start.now_ns()
    assert then > 0
    assert start.now_ns() == then
    actions.destroy()


def test_action_is_aborted_unless_paused(start: Client) -> None:
    start.state = PLAYING
    handle, actions = goal(start, 5)
    ended = result_of(start, handle)
    assert (ended.status, ended.result.result.result) == (GoalStatus.STATUS_ABORTED, FAILED)
    actions.destroy()


# GetEntities, GetEntitiesStates


def test_entities_pass_all_filters(start: Client) -> None:
    assert start.spawn(name="ball_1", initial_pose=placed(x=1.0, z=1.0)) == OK
    assert start.spawn(name="ball_22", initial_pose=placed(x=-1.0, z=1.0)) == OK
    near = msg.Bounds(type=msg.Bounds.TYPE_SPHERE, points=[Vector3(x=1.5, z=1.0), Vector3(x=0.41)])
    robots = [msg.EntityCategory(category=msg.EntityCategory.CATEGORY_ROBOT)]
    assert start.names() == ["robot", "ball_1", "ball_22"]
    assert start.names(filter="^ball_[[:digit:]]{2}$") == ["ball_22"]
    assert start.names(categories=robots) == ["robot"]
    assert start.names(bounds=near) == ["ball_1"]
    assert start.names(bounds=near, categories=robots) == []
    assert start.names(tags=msg.TagsFilter(tags=["no such tag"])) == []
    states = start.call(srv.GetEntitiesStates, filters=msg.EntityFilters(filter="^ball"))
    assert list(states.entities) == ["ball_1", "ball_22"]
    assert [state.pose.position.x for state in states.states] == [1.0, -1.0]


@pytest.mark.parametrize(
    ("filters", "code"),
    [
        ({"bounds": msg.Bounds(type=9)}, UNSUPPORTED),
        ({"bounds": msg.Bounds(type=msg.Bounds.TYPE_BOX)}, FAILED),
        ({"bounds": msg.Bounds(type=msg.Bounds.TYPE_CONVEX_HULL, points=[Vector3()] * 100_000)}, FAILED),
        ({"filter": "("}, FAILED),
        ({"filter": "((a{200}){200}){200}"}, FAILED),
        ({"filter": "a" * 3_000_000}, FAILED),
        ({"tags": msg.TagsFilter(filter_mode=9)}, FAILED),
    ],
)
def test_impossible_filters_are_refused(start: Client, filters: dict[str, Any], code: int) -> None:
    for kind in (srv.GetEntities, srv.GetEntitiesStates):
        assert start.code(kind, filters=msg.EntityFilters(**filters)) == code


def test_catastrophic_backtracking_pattern_is_answered(start: Client) -> None:
    assert start.spawn(name="a" * 250) == OK
    assert start.names(filter="^(a+)+b$") == []


# GetEntityState, SetEntityState


def test_entity_is_at_its_set_pose_and_the_state_is_in_the_world_frame(start: Client) -> None:
    quarter = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    assert start.spawn() == OK
    wanted = state_of("world", Vector3(x=0.5), x=1.0, y=0.5, z=1.5, orientation=quarter)
    assert start.code(srv.SetEntityState, entity="ball", state=wanted) == OK
    state = start.call(srv.GetEntityState, entity="ball").state
    assert state.header.frame_id == "map"
    assert (state.pose.position.x, state.pose.position.y, state.pose.position.z) == pytest.approx((1.0, 0.5, 1.5))
    assert (state.pose.orientation.z, state.pose.orientation.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert state.twist.linear.x == pytest.approx(0.5)


@pytest.mark.parametrize(
    "bad",
    [
        state_of(x=math.nan),
        state_of(x=math.inf),
        state_of(x=1e9),
        state_of(orientation=(3.0, 0.0, 0.0, 0.0)),
        state_of(orientation=(math.nan, 0.0, 0.0, 1.0)),
        state_of("no_such_frame"),
        state_of("../../etc/passwd"),
        state_of("f" * 3_000_000),
    ],
)
def test_invalid_pose_is_refused(start: Client, bad: msg.EntityState) -> None:
    assert start.code(srv.SetEntityState, entity="robot", state=bad) == 101


def test_invalid_velocity_fails(start: Client) -> None:
    assert start.code(srv.SetEntityState, entity="robot", state=state_of(linear=Vector3(x=math.nan))) == FAILED


def test_static_entity_takes_no_velocity(start: Client) -> None:
    static = '<sdf version="1.9"><model name="post"><static>true</static><link name="l"><collision name="c"><geometry>'
    static += "<box><size>0.1 0.1 1</size></box></geometry></collision></link></model></sdf>"
    assert start.spawn(static, initial_pose=placed(x=1.0, z=0.5)) == OK
    assert start.code(srv.SetEntityState, entity="post", state=state_of(linear=Vector3(x=0.1))) == FAILED
    assert start.code(srv.SetEntityState, entity="post", state=state_of(x=-1.0, z=0.5)) == OK
    category = start.call(srv.GetEntityInfo, entity="post").info.category.category
    assert category == msg.EntityCategory.CATEGORY_STATIC_OBJECT


# Get/SetEntityInfo, GetEntityBounds


def test_info_can_be_set_and_filtered_by(start: Client) -> None:
    info = msg.EntityInfo(category=msg.EntityCategory(category=2), description="a tester", tags=["tall", "blue"])
    assert start.code(srv.SetEntityInfo, entity="robot", info=info) == OK
    assert start.call(srv.GetEntityInfo, entity="robot").info == info
    assert start.names(tags=msg.TagsFilter(tags=["tall", "blue"], filter_mode=1)) == ["robot"]


@pytest.mark.parametrize(
    "info",
    [
        msg.EntityInfo(category=msg.EntityCategory(category=3)),
        msg.EntityInfo(description="d" * 3_000_000),
        msg.EntityInfo(tags=["t"] * 100_000),
    ],
)
def test_impossible_info_is_refused(start: Client, info: msg.EntityInfo) -> None:
    assert start.code(srv.SetEntityInfo, entity="robot", info=info) == FAILED


def test_bounds_are_a_box_in_the_entitys_frame_upper_corner_first(start: Client) -> None:
    assert start.spawn(initial_pose=placed(x=1.0, y=1.0, z=1.0)) == OK
    bounds = start.call(srv.GetEntityBounds, entity="ball").bounds
    assert bounds.type == msg.Bounds.TYPE_BOX
    assert [(p.x, p.y, p.z) for p in bounds.points] == [pytest.approx((0.1, 0.1, 0.1)), pytest.approx((-0.1, -0.1, -0.1))]


@pytest.mark.parametrize(
    "kind",
    [srv.GetEntityState, srv.SetEntityState, srv.GetEntityInfo, srv.SetEntityInfo, srv.GetEntityBounds, srv.DeleteEntity],
)
@pytest.mark.parametrize("name", ["", "nobody", "/robot", "../robot", "n" * 3_000_000])
def test_unknown_entity_is_not_found(start: Client, kind: Any, name: str) -> None:
    assert start.code(kind, entity=name) == NOT_FOUND


# SpawnEntity, SpawnEntities, DeleteEntity, GetSpawnables


def test_spawned_entity_falls_and_goes_when_deleted(start: Client, folder: Path) -> None:
    answer = start.call(srv.SpawnEntity, uri=str(folder / "ball.urdf"), initial_pose=placed(x=1.0, z=0.6))
    assert (answer.result.result, answer.entity_name) == (OK, "ball")
    assert start.code(srv.StepSimulation, steps=480) == OK
    assert start.position("ball")[2] == pytest.approx(0.1, abs=0.01)
    assert start.code(srv.DeleteEntity, entity="ball") == OK
    assert start.code(srv.DeleteEntity, entity="ball") == NOT_FOUND


def test_duplicate_name_is_changed_only_where_renaming_is_allowed(start: Client) -> None:
    assert start.spawn(initial_pose=placed(x=1.0, z=0.5)) == OK
    assert start.spawn(initial_pose=placed(x=-1.0, z=0.5)) == 101
    answer = start.call(srv.SpawnEntity, resource_string=BALL, allow_renaming=True, initial_pose=placed(x=-1.0, z=0.5))
    assert (answer.result.result, answer.entity_name) == (OK, "ball_2")


def test_pose_may_be_relative_to_an_entity(start: Client) -> None:
    assert start.code(srv.SetEntityState, entity="robot", state=state_of(x=0.5)) == OK
    assert start.spawn(initial_pose=placed("robot", x=0.25, z=1.0)) == OK
    assert start.position("ball") == pytest.approx((0.75, 0.0, 1.0), abs=1e-6)


def test_spawned_robot_has_its_topics_in_its_namespace_until_it_is_deleted(start: Client, folder: Path) -> None:
    where = {"uri": str(folder / "bot"), "initial_pose": placed(x=1.0)}
    assert start.code(srv.SpawnEntity, name="second", entity_namespace="fleet/two", **where) == OK
    count = start.listener.node.count_publishers
    start.listener.spin_until(lambda: count("/fleet/two/odom") == 1, "odometry of the second robot")
    assert start.code(srv.DeleteEntity, entity="second") == OK
    start.listener.spin_until(lambda: count("/fleet/two/odom") == 0, "end of the odometry")
    assert count("/odom") == 1


ABSENT = BALL.replace('<sphere radius="0.1"/>', '<mesh filename="package://nothing/absent.stl"/>')


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"name": "robot", "resource_string": BALL}, 101),
        ({"name": "a/b", "resource_string": BALL}, 102),
        ({"name": "../../etc", "resource_string": BALL, "allow_renaming": True}, 102),
        ({"name": "n" * 3_000_000, "resource_string": BALL}, 102),
        ({"resource_string": BALL.replace('name="ball"', 'name=""')}, 102),
        ({"name": "x", "resource_string": "nothing"}, 103),
        ({"name": "x", "uri": "../../../../../../etc/passwd"}, 103),
        ({"name": "x", "resource_string": "<a>" * 1_000_000}, 106),
        ({"name": "x"}, 104),
        ({"name": "x", "uri": "/no/such/file.urdf"}, 104),
        ({"name": "x", "uri": "no_such_robot"}, 104),
        ({"name": "x", "uri": "u" * 3_000_000}, 104),
        ({"name": "x", "resource_string": BALL, "entity_namespace": "a b"}, 105),
        ({"name": "x", "resource_string": BALL, "entity_namespace": "/" * 1_000_000}, 105),
        ({"name": "x", "resource_string": BALL[:200]}, 106),
        ({"name": "x", "resource_string": BALL.replace('"1.0"', '"1e30"')}, 106),
        ({"name": "x", "resource_string": BALL.replace("0.004", "1e30")}, 106),
        ({"name": "x", "resource_string": BALL.replace("0.004", "nan")}, 106),
        ({"name": "x", "resource_string": ABSENT}, 107),
        ({"name": "x", "resource_string": BALL, "initial_pose": placed(x=math.nan)}, 109),
        ({"name": "x", "resource_string": BALL, "initial_pose": placed(orientation=(9.0, 0.0, 0.0, 0.0))}, 109),
        ({"name": "x", "resource_string": BALL, "initial_pose": placed("moon")}, 109),
        # Inside the wall in front.
        ({"name": "x", "uri": "gibson_bot", "entity_namespace": "x", "initial_pose": placed(x=2.0)}, 109),
    ],
)
def test_invalid_spawn_is_refused_and_leaves_nothing(start: Client, fields: dict[str, Any], code: int) -> None:
    assert start.code(srv.SpawnEntity, **fields) == code
    assert start.names() == ["robot"]


def test_mesh_of_a_format_that_cannot_be_read_is_an_unsupported_asset(start: Client, folder: Path) -> None:
    (folder / "fbx.urdf").write_text(BALL.replace('<sphere radius="0.1"/>', '<mesh filename="thing.fbx"/>'))
    assert start.code(srv.SpawnEntity, uri=str(folder / "fbx.urdf")) == 108


def item(name: str, text: str = BALL, **fields: Any) -> msg.SpawnEntity:
    return msg.SpawnEntity(name=name, entity_resource=msg.Resource(resource_string=text), **fields)


def test_several_are_spawned_in_one_call(start: Client) -> None:
    requests = [item("one", initial_pose=placed(x=1.0, z=1.0)), item("two", initial_pose=placed(x=-1.0, z=1.0))]
    answer = start.call(srv.SpawnEntities, spawn_requests=requests)
    assert answer.result.result == OK
    assert [(r.result.result, r.entity_name) for r in answer.results] == [(OK, "one"), (OK, "two")]
    assert start.code(srv.SpawnEntities) == OK, "nothing to do"


def test_failure_of_some_is_reported_for_each(start: Client) -> None:
    answer = start.call(srv.SpawnEntities, spawn_requests=[item("one"), item("robot"), item("x/y"), item("four", "?")])
    assert answer.result.result == 150
    assert [r.result.result for r in answer.results] == [OK, 101, 102, 103]
    assert start.names() == ["robot", "one"]


def test_thousands_of_spawns_end_with_a_code_and_a_living_server(start: Client) -> None:
    requests = [item("", allow_renaming=True, initial_pose=placed(z=3.0 + i)) for i in range(2100)]
    future = start.send(srv.SpawnEntities, spawn_requests=requests)
    counts = [1]
    # Others are answered meanwhile.
    start.listener.spin_until(lambda: counts.append(len(start.names())) or counts[-1] > 1, "the first balls")  # type: ignore[func-returns-value]
    assert counts[-1] < 2000
    start.listener.spin_until(future.done, "all balls")
    assert future.result().result.result == 150
    # 2,000 entities in all, and the robot is one.
    assert [r.result.result for r in future.result().results] == [OK] * 1999 + [FAILED] * 101
    assert start.code(srv.ResetSimulation, scope=SPAWNED) == OK
    assert start.names() == ["robot"]


def test_spawnables_can_be_spawned_and_wrong_sources_are_named(start: Client, folder: Path) -> None:
    answer = start.call(srv.GetSpawnables, sources=[str(folder), "/no/such/folder"])
    assert answer.result.result == OK
    assert "/no/such/folder" in answer.result.error_message
    uris = {spawnable.uri for spawnable in answer.spawnables}
    assert "gibson_bot" in uris
    uri = next(uri for uri in uris if uri.endswith("ball.urdf"))
    assert start.code(srv.SpawnEntity, uri=uri, initial_pose=placed(x=1.0, z=1.0)) == OK


# GetNamedPoses, GetNamedPoseBounds


def test_named_poses_have_bounds_that_hold_them(start: Client) -> None:
    poses = start.call(srv.GetNamedPoses).poses
    assert {"middle", "floor_0/free_0", "floor_0/room_0"} <= {pose.name for pose in poses}
    tagged = start.call(srv.GetNamedPoses, tags=msg.TagsFilter(tags=["start"])).poses
    assert [pose.name for pose in tagged] == ["middle"]
    for pose in poses:
        high, low = start.call(srv.GetNamedPoseBounds, name=pose.name).bounds.points
        assert low.x < 0.0 < high.x
        assert low.y < 0.0 < high.y
        assert low.z <= 0.0 < high.z


def test_unknown_pose_is_not_found_and_unknown_filter_mode_fails(start: Client) -> None:
    assert start.code(srv.GetNamedPoseBounds, name="attic") == NOT_FOUND
    assert start.code(srv.GetNamedPoses, tags=msg.TagsFilter(filter_mode=7)) == FAILED


# LoadWorld, UnloadWorld, GetAvailableWorlds, GetCurrentWorld


def test_loaded_world_is_stopped_and_current_and_its_robots_are_spawned(start: Client, folder: Path) -> None:
    answer = start.call(srv.LoadWorld, uri=str(folder / "good.sdf"))
    assert answer.result.result == OK, answer.result.error_message
    assert (answer.world.name, answer.world.world_resource.uri) == ("good", str(folder / "good.sdf"))
    assert start.call(srv.GetCurrentWorld).world == answer.world
    assert start.state == STOPPED
    assert start.names() == []
    assert start.code(srv.SpawnEntity, name="robot", uri=str(folder / "bot"), initial_pose=placed(z=0.1)) == OK
    start.state = PLAYING
    start.listener.spin_until(lambda: start.now_ns() > 10**8, "time in the new world")


def test_world_may_come_as_text(start: Client) -> None:
    text = WORLD.format(name="typed", inside="")
    answer = start.call(srv.LoadWorld, resource_string=text)
    assert answer.result.result == OK, answer.result.error_message
    assert (answer.world.name, answer.world.world_resource.resource_string) == ("typed", text)


def test_missing_and_unsupported_assets_are_left_out_on_request(start: Client, folder: Path) -> None:
    for name in ("missing", "unsupported_asset"):
        wanted = {"uri": str(folder / f"{name}.sdf"), "ignore_missing_or_unsupported_assets": True}
        assert start.code(srv.LoadWorld, **wanted) == OK
    assert start.code(srv.LoadWorld, uri=str(folder / "unsupported_element.sdf")) == OK


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"uri": "../../../../../../../etc/passwd"}, 101),
        ({"uri": "thing.fbx"}, 101),
        ({"resource_string": "nothing"}, 101),
        ({"uri": "/no/such/world.sdf"}, 102),
        ({"uri": "w" * 3_000_000}, 102),
        ({"uri": "broken.sdf"}, 103),
        ({"resource_string": "<sdf>" * 500_000}, 103),
        ({"uri": "missing.sdf"}, 104),
        ({"uri": "unsupported_asset.sdf"}, 105),
        ({"uri": "unsupported_element.sdf", "fail_on_unsupported_element": True}, 106),
    ],
)
def test_world_that_cannot_be_loaded_leaves_none(start: Client, folder: Path, fields: dict[str, Any], code: int) -> None:
    if (folder / fields.get("uri", "?")[:100]).is_file():
        fields = {**fields, "uri": str(folder / fields["uri"])}
    assert start.code(srv.LoadWorld, **fields) == code
    assert start.state == NO_WORLD


def test_request_that_names_no_world_keeps_the_present_one(start: Client) -> None:
    assert start.code(srv.LoadWorld) == 102
    assert start.names() == ["robot"]


def test_without_a_world_all_requests_fail(start: Client) -> None:
    assert start.code(srv.UnloadWorld) == OK
    assert start.state == NO_WORLD
    assert start.code(srv.UnloadWorld) == 101
    assert start.code(srv.GetCurrentWorld) == 101
    for wanted in (STOPPED, PLAYING, PAUSED):
        assert start.set_state(wanted) == 103
    for kind in (
        srv.ResetSimulation,
        srv.StepSimulation,
        srv.GetEntities,
        srv.GetEntitiesStates,
        srv.GetEntityState,
        srv.SetEntityState,
        srv.GetEntityInfo,
        srv.SetEntityInfo,
        srv.GetEntityBounds,
        srv.SpawnEntities,
        srv.DeleteEntity,
        srv.GetNamedPoses,
        srv.GetNamedPoseBounds,
    ):
        assert start.code(kind) == INCORRECT_STATE, kind.__name__
    assert start.spawn() == INCORRECT_STATE


def test_worlds_are_the_built_in_ones_and_those_of_the_sources(start: Client, folder: Path) -> None:
    worlds = start.call(srv.GetAvailableWorlds, additional_sources=[str(folder)], offline_only=True).worlds
    assert {"flat", "good"} <= {world.name for world in worlds}
    sdf = start.call(srv.GetAvailableWorlds, additional_sources=[str(folder)], filter=msg.TagsFilter(tags=["sdf"])).worlds
    assert "good" in {world.name for world in sdf}
    assert "flat" not in {world.name for world in sdf}


def test_missing_source_is_not_found_unless_continuing_is_requested(start: Client) -> None:
    bad = {"additional_sources": ["/no/such/folder"]}
    assert start.code(srv.GetAvailableWorlds, **bad) == NOT_FOUND
    assert start.code(srv.GetAvailableWorlds, **bad, continue_on_error=True) == OK


# The end


def test_quitting_is_answered_and_ends_the_process_with_zero(sim: Launched, client: Client) -> None:
    assert client.set_state(QUITTING) == OK
    assert sim.wait() == 0, "\n".join(sim.lines)
