"""Entities of a world: reading, moving, spawning, deleting. The yard: crate at x = 1 m, wall (static) at 3 m, anna at 5 m."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.spec import CollisionSpec, StartPose
from gibson_sim.standard.bounds import Bounds, BoundsType
from gibson_sim.standard.codes import EntityStateCode, Result, SimulationError, SpawnCode
from gibson_sim.standard.entities import Category, EntityInfo
from gibson_sim.standard.filters import EntityFilters, TagsFilter
from gibson_sim.standard.population import Population, SpawnRequest, StateChange
from gibson_sim.standard.simulator import Simulator
from gibson_sim.types import Pose, Quat, Vec3
from support.yard import BALL, SCENE

QUARTER: Quat = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
"""90 degrees to the left."""


@pytest.fixture
def people(make: Callable[..., Simulator]) -> Population:
    return make().population


def code_of(error: pytest.ExceptionInfo[SimulationError]) -> object:
    assert "\n" not in str(error.value)
    return error.value.code


@pytest.mark.parametrize(
    ("filters", "names"),
    [
        (EntityFilters(), ["crate", "wall", "anna"]),
        (EntityFilters("^(crate|anna)$"), ["crate", "anna"]),
        (EntityFilters("a"), ["crate", "wall", "anna"]),
        (EntityFilters(categories=(Category.STATIC_OBJECT, Category.HUMAN)), ["wall", "anna"]),
        (EntityFilters(tags=TagsFilter(("person", "wall"))), ["wall", "anna"]),
        (EntityFilters(tags=TagsFilter(("person", "wall"), 1)), []),
        # The crate reaches to x = 1.1 m, the wall begins at 2.9 m.
        (EntityFilters(bounds=Bounds(BoundsType.SPHERE, ((2.0, 0.0, 0.1), (0.91, 0.0, 0.0)))), ["crate", "wall"]),
        (EntityFilters(bounds=Bounds(BoundsType.BOX, ((2.91, 1.0, 1.0), (1.2, -1.0, 0.0)))), ["wall"]),
        (EntityFilters("l$", (Category.STATIC_OBJECT,), TagsFilter(("wall",)), Bounds(BoundsType.EMPTY)), ["wall"]),
        (EntityFilters("l$", (Category.ROBOT,)), []),
    ],
)
def test_entity_must_pass_every_filter(people: Population, filters: EntityFilters, names: list[str]) -> None:
    assert [entity.name for entity in people.select(filters)] == names


@pytest.mark.parametrize("filters", [EntityFilters("("), EntityFilters(tags=TagsFilter((), 2))])
def test_impossible_filter_is_refused(people: Population, filters: EntityFilters) -> None:
    with pytest.raises(SimulationError) as error:
        people.select(filters)
    assert code_of(error) is Result.OPERATION_FAILED


def test_unknown_entity_is_not_found_and_the_known_ones_are_named(people: Population) -> None:
    for ask in (
        people.entity,
        people.state,
        people.bounds,
        people.delete,
        lambda name: people.set_info(name, EntityInfo()),
        lambda name: people.set_state(name, StateChange()),
    ):
        with pytest.raises(SimulationError, match="crate, wall, anna") as error:
            ask("nobody")
        assert code_of(error) is Result.NOT_FOUND


def test_entity_info_can_be_set_and_filtered_by(people: Population) -> None:
    info = EntityInfo(Category.OBJECT, "for the move", ("wood", "empty"))
    people.set_info("crate", info)
    assert people.entity("crate").info == info
    assert [e.name for e in people.select(EntityFilters(tags=TagsFilter(("wood", "empty"), 1)))] == ["crate"]


def test_moved_entity_has_the_pose_and_velocity_that_were_set(people: Population) -> None:
    people.set_state("crate", StateChange("", (4.0, 5.0, 6.0), QUARTER, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6)))
    state = people.state("crate")
    assert state.pose.position == pytest.approx((4.0, 5.0, 6.0))
    assert state.pose.quat_xyzw == pytest.approx(QUARTER)
    assert (*state.linear, *state.angular) == pytest.approx((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))


def test_only_flagged_parts_of_the_state_change(people: Population) -> None:
    people.set_state("crate", StateChange(linear=(1.0, 0.0, 0.0), set_pose=False))
    people.set_state("crate", StateChange("", (0.0, 7.0, 1.0), set_twist=False))
    assert people.state("crate").pose.position == pytest.approx((0.0, 7.0, 1.0))
    assert people.state("crate").linear == pytest.approx((1.0, 0.0, 0.0))


def test_state_in_the_frame_of_another_entity(people: Population) -> None:
    # anna at (5, 0, 0.1) looks along +y: what is 2 m ahead of her and moves ahead is at (5, 2) and moves along +y.
    people.set_state("anna", StateChange("world", (5.0, 0.0, 0.1), QUARTER))
    people.set_state("crate", StateChange("anna", (2.0, 0.0, 0.0), linear=(1.0, 0.0, 0.0), angular=(0.0, 1.0, 0.0)))
    state = people.state("crate")
    assert state.pose.position == pytest.approx((5.0, 2.0, 0.1))
    assert state.pose.quat_xyzw == pytest.approx(QUARTER)
    assert state.linear == pytest.approx((0.0, 1.0, 0.0), abs=1e-12)
    assert state.angular == pytest.approx((-1.0, 0.0, 0.0), abs=1e-12)


def test_entity_at_rest_in_a_turning_frame_moves_with_it(people: Population) -> None:
    people.set_state("anna", StateChange("", (0.0, 0.0, 5.0), linear=(0.5, 0.0, 0.0), angular=(0.0, 0.0, 2.0)))
    people.set_state("crate", StateChange("anna", (3.0, 0.0, 0.0)))
    state = people.state("crate")
    # 0.5 m/s along x, and 2 rad/s on an arm of 3 m along x: 6 m/s along y.
    assert state.linear == pytest.approx((0.5, 6.0, 0.0))
    assert state.angular == pytest.approx((0.0, 0.0, 2.0))


@pytest.mark.parametrize(
    "change",
    [
        StateChange(position=(math.nan, 0.0, 0.0)),
        StateChange(position=(0.0, math.inf, 0.0)),
        StateChange(position=(0.0, 0.0, 10_001.0)),
        StateChange(quat_xyzw=(0.0, 0.0, 0.0, 0.5)),
        StateChange(quat_xyzw=(0.0, 0.0, 0.0, math.nan)),
        StateChange("moon"),
        StateChange("../anna"),
    ],
)
def test_invalid_pose_is_refused_and_nothing_moves(people: Population, change: StateChange) -> None:
    before = people.state("crate")
    with pytest.raises(SimulationError) as error:
        people.set_state("crate", change)
    assert code_of(error) is EntityStateCode.INVALID_POSE
    assert people.state("crate") == before


def test_frame_cannot_be_used_to_leave_the_world(people: Population) -> None:
    people.set_state("anna", StateChange(position=(9_000.0, 0.0, 0.1)))
    with pytest.raises(SimulationError, match="too far away") as error:
        people.set_state("crate", StateChange("anna", (2_000.0, 0.0, 0.0)))
    assert code_of(error) is EntityStateCode.INVALID_POSE


def test_rounded_quaternion_is_normalised_and_one_of_zeros_is_no_rotation(people: Population) -> None:
    people.set_state("wall", StateChange(position=(3.0, 0.0, 0.1), quat_xyzw=(0.0, 0.0, 0.71, 0.71)))
    assert people.state("wall").pose.quat_xyzw == pytest.approx(QUARTER)
    people.set_state("wall", StateChange(position=(3.0, 0.0, 0.1), quat_xyzw=(0.0, 0.0, 0.0, 0.0)))
    assert people.state("wall").pose.quat_xyzw == pytest.approx((0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    "change",
    [StateChange(linear=(0.1, 0.0, 0.0)), StateChange(angular=(0.0, 0.0, 0.1)), StateChange(acceleration=(0.0,) * 5 + (1.0,))],
)
def test_static_entity_takes_no_twist_and_no_acceleration(people: Population, change: StateChange) -> None:
    with pytest.raises(SimulationError, match="static") as error:
        people.set_state("wall", change)
    assert code_of(error) is Result.OPERATION_FAILED


@pytest.mark.parametrize("linear", [(math.nan, 0.0, 0.0), (0.0, -math.inf, 0.0), (0.0, 0.0, 1001.0)])
def test_impossible_velocity_is_refused(people: Population, linear: Vec3) -> None:
    with pytest.raises(SimulationError) as error:
        people.set_state("crate", StateChange(linear=linear))
    assert code_of(error) is Result.OPERATION_FAILED


def test_bounds_are_a_box_in_the_entitys_own_frame_however_it_is_turned(people: Population) -> None:
    eighth = (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8))
    people.set_state("wall", StateChange(position=(3.0, 4.0, 0.1), quat_xyzw=eighth))
    bounds = people.bounds("wall")
    assert bounds.kind is BoundsType.BOX
    assert np.array(bounds.points) == pytest.approx(np.array([[0.1, 0.1, 0.1], [-0.1, -0.1, -0.1]]))


def test_spawned_text_is_an_entity_under_the_name_in_it(people: Population) -> None:
    assert people.spawn(SpawnRequest(text=BALL, position=(0.0, 9.0, 1.0))) == "ball"
    assert people.names == ("crate", "wall", "anna", "ball")
    assert people.state("ball").pose.position == pytest.approx((0.0, 9.0, 1.0))
    entity = people.entity("ball")
    assert entity.spawned
    assert entity.info.category is Category.DYNAMIC_OBJECT


def test_spawned_file_is_an_entity(people: Population, tmp_path: Path) -> None:
    (tmp_path / "ball.urdf").write_text(BALL)
    assert people.spawn(SpawnRequest("red", uri=str(tmp_path / "ball.urdf"), text="not read")) == "red"
    assert people.spawn(SpawnRequest("blue", uri=(tmp_path / "ball.urdf").as_uri())) == "blue"


def test_spawn_pose_may_be_relative_to_an_entity(people: Population) -> None:
    people.set_state("anna", StateChange("", (5.0, 0.0, 0.1), QUARTER))
    people.spawn(SpawnRequest(text=BALL, frame_id="anna", position=(1.0, 0.0, 0.5)))
    assert people.state("ball").pose.position == pytest.approx((5.0, 1.0, 0.6))


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (SpawnRequest("crate", text=BALL), SpawnCode.NAME_NOT_UNIQUE),
        (SpawnRequest("a/b", text=BALL), SpawnCode.NAME_INVALID),
        (SpawnRequest(text='<robot name=""><link name="a"/></robot>'), SpawnCode.NAME_INVALID),
        (SpawnRequest("x", text="hello"), SpawnCode.UNSUPPORTED_FORMAT),
        (SpawnRequest("x"), SpawnCode.NO_RESOURCE),
        (SpawnRequest("x", uri="  ", text="\n"), SpawnCode.NO_RESOURCE),
        (SpawnRequest("x", text=BALL, namespace="a b"), SpawnCode.NAMESPACE_INVALID),
        (SpawnRequest("x", text=BALL[:200]), SpawnCode.RESOURCE_PARSE_ERROR),
        (SpawnRequest("x", text=BALL.replace('<sphere radius="0.1"/>', "<mesh filename='no.stl'/>")), SpawnCode.MISSING_ASSETS),
        (SpawnRequest("x", text=BALL, position=(math.nan, 0.0, 0.0)), SpawnCode.INVALID_POSE),
        (SpawnRequest("x", text=BALL, position=(1e5, 0.0, 0.0)), SpawnCode.INVALID_POSE),
        (SpawnRequest("x", text=BALL, quat_xyzw=(1.0, 1.0, 0.0, 0.0)), SpawnCode.INVALID_POSE),
        (SpawnRequest("x", text=BALL, frame_id="odom"), SpawnCode.INVALID_POSE),
    ],
)
def test_invalid_spawn_is_refused_and_leaves_nothing(people: Population, request_: SpawnRequest, code: SpawnCode) -> None:
    with pytest.raises(SimulationError) as error:
        people.spawn(request_)
    assert code_of(error) is code
    assert people.names == ("crate", "wall", "anna")


def test_unsupported_asset_is_distinguished_from_a_missing_one(people: Population, tmp_path: Path) -> None:
    (tmp_path / "ball.fbx").write_bytes(b"not for us")
    (tmp_path / "ball.urdf").write_text(BALL.replace('<sphere radius="0.1"/>', '<mesh filename="ball.fbx"/>'))
    with pytest.raises(SimulationError) as error:
        people.spawn(SpawnRequest(uri=str(tmp_path / "ball.urdf")))
    assert code_of(error) is SpawnCode.UNSUPPORTED_ASSETS


def test_taken_name_gets_a_number_where_renaming_is_allowed(people: Population) -> None:
    names = [people.spawn(SpawnRequest(text=BALL, allow_renaming=True, position=(0.0, i, 1.0))) for i in range(3)]
    assert names == ["ball", "ball_2", "ball_3"]


def test_full_world_refuses_more(make: Callable[..., Simulator]) -> None:
    world = make().world
    assert world is not None
    people = Population(world, max_entities=4)
    people.spawn(SpawnRequest(text=BALL))
    outcomes = people.spawn_all([SpawnRequest(text=BALL, allow_renaming=True)] * 3)
    assert {outcome.error.code for outcome in outcomes if outcome.error} == {Result.OPERATION_FAILED}
    assert len(people.names) == 4
    people.delete("crate")
    assert people.spawn(SpawnRequest("again", text=BALL)) == "again"


def test_successful_spawns_stay_where_others_fail(people: Population) -> None:
    outcomes = people.spawn_all([SpawnRequest(text=BALL), SpawnRequest(text="?", name="bad"), SpawnRequest("ball2", text=BALL)])
    assert [(o.name, o.error is None) for o in outcomes] == [("ball", True), ("", False), ("ball2", True)]
    assert people.names == ("crate", "wall", "anna", "ball", "ball2")


def test_robots_do_not_share_a_namespace(people: Population) -> None:
    def namespace(name: str) -> str:
        return people.entity(name).namespace

    people.spawn(SpawnRequest("one", uri="gibson_bot"))
    people.spawn(SpawnRequest("two", uri="gibson_bot", position=(0.0, 2.0, 0.0)))
    people.spawn(SpawnRequest("three", uri="gibson_bot", namespace="/fleet/three", position=(0.0, 4.0, 0.0)))
    assert [namespace(name) for name in ("one", "two", "three")] == ["", "two", "fleet/three"]
    with pytest.raises(SimulationError, match="'three'") as error:
        people.spawn(SpawnRequest("four", uri="gibson_bot", namespace="fleet/three"))
    assert code_of(error) is SpawnCode.NAMESPACE_INVALID


def test_deleted_entity_is_gone(people: Population) -> None:
    people.delete("crate")
    assert people.names == ("wall", "anna")
    with pytest.raises(SimulationError):
        people.state("crate")


def _spawn_ahead(people: Population, *requests: SpawnRequest) -> list[str]:
    """Spawns what was read in advance, as the services do; fails if anything is read once more."""
    ahead = people.file_reader(requests)()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gibson_sim.scenes.spawning.load_spawnable", lambda *_, **__: pytest.fail("it was read again"))
        patch.setattr("gibson_sim.scenes.spawning.spawn_name", lambda *_: pytest.fail("it was read again"))
        return [people.spawn(request, found) for request, found in zip(requests, ahead, strict=True)]


def test_file_read_ahead_is_not_read_again(people: Population) -> None:
    request = SpawnRequest(text=BALL, allow_renaming=True, position=(7.0, 1.0, 2.0))
    names = _spawn_ahead(people, request, request)
    assert len(set(names)) == 2
    for name in names:
        assert people.state(name).pose.position == (7.0, 1.0, 2.0)


def test_spawn_read_ahead_uses_the_current_names_and_poses(people: Population) -> None:
    request = SpawnRequest(text=BALL, frame_id="crate", position=(0.0, 0.0, 3.0), name="ball", allow_renaming=True)
    (ahead,) = people.file_reader([request])()
    people.set_state("crate", StateChange(position=(9.0, 0.0, 0.0)))
    people.spawn(SpawnRequest(name="ball", text=BALL, position=(0.0, 5.0, 2.0)))
    name = people.spawn(request, ahead)
    assert name != "ball"
    assert people.state(name).pose.position[0] == pytest.approx(9.0)


def test_error_of_a_file_read_ahead_is_raised_in_its_turn(people: Population) -> None:
    request = SpawnRequest(name="x", text="<robot name='x'><link/></robot>")
    (ahead,) = people.file_reader([request])()
    with pytest.raises(SimulationError) as late:
        people.spawn(request, ahead)
    with pytest.raises(SimulationError) as at_once:
        people.spawn(request)
    assert (late.value.code, str(late.value)) == (at_once.value.code, str(at_once.value))


def test_a_robot_that_starts_above_no_floor_is_reported(make: Callable[..., Simulator], caplog: pytest.LogCaptureFixture) -> None:
    floor = CollisionSpec("floor", Shape("box", (4.0, 4.0, 0.1)), Pose((0.0, 0.0, -0.05)))
    scene = replace(SCENE, ground_z=None, collisions=(floor,), bodies=())
    for x in (1.0, 100.0):
        make(replace(scene, robots=(load_robot("gibson_bot", start=Pose((x, 0.0, 0.0))),)))
    told = [record.getMessage() for record in caplog.records if "nothing below" in record.getMessage()]
    assert len(told) == 1
    assert "robot starts at 100.00,0.00, where there is nothing below it: it falls; `gibson-sim scene inspect`" in told[0]


def test_a_robot_that_starts_outside_a_building_on_infinite_ground_is_reported(
    make: Callable[..., Simulator], caplog: pytest.LogCaptureFixture
) -> None:
    walls = (
        CollisionSpec("west", Shape("box", (0.2, 6.0, 2.0)), Pose((-2.0, 0.0, 1.0))),
        CollisionSpec("east", Shape("box", (0.2, 6.0, 2.0)), Pose((8.0, 0.0, 1.0))),
    )
    scene = replace(SCENE, ground_z=0.0, collisions=walls, bodies=(), starts=(StartPose("hall", Pose()),))
    for x, starts in ((1.0, scene.starts), (50.0, scene.starts), (50.0, ())):
        make(replace(scene, starts=starts, robots=(load_robot("gibson_bot", start=Pose((x, 0.0, 0.0))),)))
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 1
    assert (
        "robot starts at 50.00,0.00, outside the scene, which is from x -2.1 to 8.1 and y -3.0 to 3.0 m; `gibson-sim scene"
        in told[0]
    )


def test_an_object_that_is_spawned_above_no_floor_is_reported(
    make: Callable[..., Simulator], caplog: pytest.LogCaptureFixture
) -> None:
    people = make(replace(SCENE, ground_z=None)).population
    people.spawn(SpawnRequest("over_the_wall", text=BALL, position=(3.0, 0.0, 5.0)))
    assert not caplog.records
    people.spawn(SpawnRequest("lost", text=BALL, position=(100.0, 100.0, 0.2)))
    assert [record.getMessage() for record in caplog.records] == [
        "spawned 'lost' at 100.00,100.00, where there is nothing below it: it falls"
    ]
