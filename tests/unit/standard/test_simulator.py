"""The simulation as a whole: states, steps, resets, worlds."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import pytest

from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import PhysicsError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes import spawnables, worlds
from gibson_sim.scenes.worlds import WorldEntry, WorldError, WorldFailure
from gibson_sim.standard import catalogue
from gibson_sim.standard.codes import LoadWorldCode, Result, SimulationError, StateCode, WorldCode, WorldsCode
from gibson_sim.standard.entities import Category, EntityInfo
from gibson_sim.standard.filters import TagsFilter
from gibson_sim.standard.population import SpawnRequest, StateChange
from gibson_sim.standard.requests import LastReset, LoadRequest
from gibson_sim.standard.simulator import STEPS_AT_ONCE, Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.standard.stepping import StepRequest
from support.scenes import write_room
from support.yard import BALL, SCENE

Make = Callable[..., Simulator]
STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD, LOADING_WORLD = SimulationState
TIME, STATE, SPAWNED = 1, 2, 4


def world_of(simulator: Simulator) -> PhysicsWorld:
    assert simulator.world is not None
    return simulator.world


def turn(simulator: Simulator, paced: int = 0) -> int:
    """One turn of a node's loop; returns how many steps it made."""
    steps = simulator.steps_due(paced)
    for _ in range(steps):
        simulator.step()
    return steps


def crate_x(simulator: Simulator) -> float:
    return simulator.population.state("crate").pose.position[0]


def disturb(simulator: Simulator) -> None:
    """Lets a quarter of a second pass, moves the crate and spawns a ball."""
    simulator.set_state(PLAYING)
    turn(simulator, 60)
    simulator.population.set_state("crate", StateChange(position=(-7.0, 0.0, 0.1)))
    simulator.population.spawn(SpawnRequest(text=BALL, position=(0.0, 5.0, 1.0)))


def test_simulator_plays_at_once_or_is_stopped_if_it_starts_paused(make: Make) -> None:
    assert make().state is PLAYING
    assert make(start_paused=True).state is STOPPED
    assert make(None).state is NO_WORLD


def test_time_passes_while_playing_alone(make: Make) -> None:
    simulator = make(start_paused=True)
    assert turn(simulator, 4) == 0
    simulator.set_state(PLAYING)
    assert turn(simulator, 4) == 4
    simulator.set_state(PAUSED)
    assert turn(simulator, 4) == 0
    assert world_of(simulator).step_count == 4


def test_stopped_to_paused_makes_no_step(make: Make) -> None:
    simulator = make(start_paused=True)
    simulator.set_state(PAUSED)
    assert simulator.state is PAUSED
    assert (world_of(simulator).step_count, simulator.epoch) == (0, 0)


def test_stopping_pauses_and_resets_everything(make: Make) -> None:
    simulator = make(start_paused=True)
    disturb(simulator)
    simulator.set_state(STOPPED)
    assert simulator.state is STOPPED
    assert world_of(simulator).step_count == 0
    assert simulator.population.names == ("crate", "wall", "anna")
    assert crate_x(simulator) == pytest.approx(1.0)
    assert simulator.epoch == 1


def test_stop_that_fails_is_an_error_of_the_transition(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = make()

    def refuse(*_: object, **__: object) -> None:
        raise PhysicsError("no")

    monkeypatch.setattr(world_of(simulator), "reset", refuse)
    with pytest.raises(SimulationError) as error:
        simulator.set_state(STOPPED)
    assert error.value.code is StateCode.STATE_TRANSITION_ERROR
    assert simulator.state is PAUSED


def test_quitting_stops_time_for_good(make: Make) -> None:
    simulator = make()
    simulator.set_state(QUITTING)
    assert simulator.quitting
    assert turn(simulator, 10) == 0
    with pytest.raises(SimulationError):
        simulator.set_state(PLAYING)


@pytest.mark.parametrize(
    ("scope", "steps", "x", "ball"),
    [
        (0, 0, 1.0, False),
        (255, 0, 1.0, False),
        (TIME | STATE | SPAWNED, 0, 1.0, False),
        (TIME, 0, -7.0, True),
        (STATE, 60, 1.0, True),
        (SPAWNED, 60, -7.0, False),
        (TIME | STATE, 0, 1.0, True),
        (STATE | SPAWNED, 60, 1.0, False),
    ],
)
def test_reset_affects_its_scope_alone(make: Make, scope: int, steps: int, x: float, ball: bool) -> None:
    simulator = make(start_paused=True)
    disturb(simulator)
    simulator.reset(scope)
    assert world_of(simulator).step_count == steps
    assert crate_x(simulator) == pytest.approx(x)
    assert ("ball" in simulator.population.names) is ball
    assert simulator.state is PLAYING, "what plays goes on playing"
    assert simulator.epoch == 1
    assert simulator.last_reset == LastReset(scope or 7 if scope < 255 else 7, rewound=steps == 0)


def test_reset_of_the_state_returns_spawned_entities_to_their_spawn_poses(make: Make) -> None:
    simulator = make(start_paused=True)
    disturb(simulator)
    turn(simulator, 240)
    simulator.reset(STATE)
    assert simulator.population.state("ball").pose.position == pytest.approx((0.0, 5.0, 1.0))


def test_reset_of_everything_restores_deleted_entities_in_order_and_clears_info(make: Make) -> None:
    simulator = make()
    simulator.population.delete("crate")
    simulator.population.set_info("anna", EntityInfo(Category.OBJECT, "a doll"))
    simulator.reset(STATE)
    assert simulator.population.names == ("wall", "anna")
    simulator.reset()
    assert simulator.population.names == ("crate", "wall", "anna")
    assert simulator.population.entity("anna").info.category is Category.HUMAN


def test_run_after_a_reset_is_bit_equal_to_the_first_one(make: Make) -> None:
    simulator = make()

    def run() -> list[bytes]:
        simulator.population.set_state("crate", StateChange(position=(4.85, 0.05, 0.5), linear=(0.5, 0.0, 0.0)))
        turn(simulator, 200)
        state = world_of(simulator).state()
        return [state.positions.tobytes(), state.quats_xyzw.tobytes(), state.twists.tobytes()]

    first = run()
    simulator.population.spawn(SpawnRequest(text=BALL, position=(4.9, 0.0, 0.5)))
    simulator.population.delete("crate")
    turn(simulator, 100)
    simulator.reset()
    assert run() == first


@pytest.mark.parametrize("scope", [8, 9, 254])
def test_unknown_scope_is_refused_and_resets_nothing(make: Make, scope: int) -> None:
    simulator = make()
    turn(simulator, 5)
    with pytest.raises(SimulationError) as error:
        simulator.reset(scope)
    assert error.value.code is Result.OPERATION_FAILED
    assert (world_of(simulator).step_count, simulator.epoch) == (5, 0)


def test_monotonic_time_goes_on_over_resets_and_worlds(make: Make, tmp_path: Path) -> None:
    simulator = make(reset_time="monotonic")
    turn(simulator, 7)
    simulator.reset()
    assert world_of(simulator).step_count == 7
    assert not simulator.last_reset.rewound
    simulator.load_world(LoadRequest(str(write_room(tmp_path))))
    assert world_of(simulator).step_count == 7


def test_steps_for_clients_are_made_in_small_portions_while_paused(make: Make) -> None:
    simulator = make(start_paused=True)
    simulator.set_state(PAUSED)
    ended: list[StepRequest] = []
    simulator.request_steps(STEPS_AT_ONCE + 10, on_end=ended.append)
    assert turn(simulator, 3) == STEPS_AT_ONCE
    assert not ended
    assert turn(simulator, 3) == 10
    assert [request.failure for request in ended] == [""]
    assert turn(simulator, 3) == 0
    assert world_of(simulator).step_count == STEPS_AT_ONCE + 10
    assert simulator.state is PAUSED


@pytest.mark.parametrize(("state", "code"), [(PLAYING, Result.OPERATION_FAILED), (STOPPED, Result.OPERATION_FAILED)])
def test_steps_are_refused_unless_paused(make: Make, state: SimulationState, code: Result) -> None:
    simulator = make(start_paused=state is STOPPED)
    with pytest.raises(SimulationError) as error:
        simulator.request_steps(1)
    assert error.value.code is code


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s.set_state(PLAYING),
        lambda s: s.set_state(PAUSED),
        lambda s: s.set_state(STOPPED),
        lambda s: s.set_state(QUITTING),
        lambda s: s.reset(TIME),
        lambda s: s.unload_world(),
    ],
)
def test_steps_end_when_the_state_changes_and_say_how_far_they_came(make: Make, change: Callable[[Simulator], None]) -> None:
    simulator = make()
    simulator.set_state(PAUSED)
    request = simulator.request_steps(10**12)
    turn(simulator)
    change(simulator)
    assert request.ended
    assert request.failure.endswith(f"after {STEPS_AT_ONCE} of {10**12} steps")


def test_without_a_world_every_request_fails_with_no_world(make: Make) -> None:
    simulator = make(None)
    for ask in (
        lambda: simulator.population,
        lambda: simulator.reset(),
        lambda: simulator.request_steps(1),
        lambda: simulator.named_poses(TagsFilter()),
    ):
        with pytest.raises(SimulationError, match="NO_WORLD") as error:
            ask()
        assert error.value.code is Result.INCORRECT_STATE
    for ask_world in (simulator.current_world, simulator.unload_world):
        with pytest.raises(SimulationError) as error:
            ask_world()
        assert error.value.code is WorldCode.NO_WORLD_LOADED
    assert turn(simulator, 5) == 0
    assert simulator.scene.bodies == ()


def test_loaded_world_is_stopped_at_time_zero_and_has_another_revision(make: Make, tmp_path: Path) -> None:
    simulator = make()
    turn(simulator, 9)
    revision = simulator.scene.revision
    folder = write_room(tmp_path / "room")
    info = simulator.load_world(LoadRequest(str(folder)))
    assert (info.name, info.uri, info.tags) == ("tiny_room", str(folder), ("scene.yaml",))
    assert simulator.current_world() == info
    assert simulator.state is STOPPED
    assert world_of(simulator).step_count == 0
    assert simulator.population.names == ()
    assert simulator.scene.revision > revision
    assert simulator.epoch == 1


def test_revision_of_the_scene_grows_with_every_change_over_all_worlds(make: Make, tmp_path: Path) -> None:
    simulator = make()
    seen = [simulator.scene.revision]
    for change in (
        lambda: simulator.population.spawn(SpawnRequest(text=BALL)),
        lambda: simulator.population.delete("ball"),
        lambda: simulator.unload_world(),
        lambda: simulator.load_world(LoadRequest(str(write_room(tmp_path)))),
        lambda: simulator.population.spawn(SpawnRequest(text=BALL)),
        lambda: simulator.reset(SPAWNED),
    ):
        change()
        seen.append(simulator.scene.revision)
    assert seen == sorted(set(seen))


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (LoadRequest("no/such/world"), LoadWorldCode.NO_RESOURCE),
        (LoadRequest("../../../../../../../../etc/passwd"), LoadWorldCode.UNSUPPORTED_FORMAT),
        (LoadRequest(text="hello"), LoadWorldCode.UNSUPPORTED_FORMAT),
        (LoadRequest(text="<sdf><world"), LoadWorldCode.RESOURCE_PARSE_ERROR),
    ],
)
def test_world_that_cannot_be_loaded_leaves_none(make: Make, request_: LoadRequest, code: LoadWorldCode) -> None:
    simulator = make()
    with pytest.raises(SimulationError) as error:
        simulator.load_world(request_)
    assert error.value.code is code
    assert simulator.state is NO_WORLD
    assert simulator.world is None


def test_request_that_names_no_world_leaves_the_present_one(make: Make) -> None:
    simulator = make()
    with pytest.raises(SimulationError) as error:
        simulator.load_world(LoadRequest(" ", "\n"))
    assert error.value.code is LoadWorldCode.NO_RESOURCE
    assert simulator.state is PLAYING


def test_world_that_physics_refuses_leaves_none(tmp_path: Path) -> None:
    def refuse(*_: object, **__: object) -> PhysicsWorld:
        raise PhysicsError("too small")

    simulator = Simulator(None, PhysicsConfig(), make_world=refuse)
    with pytest.raises(SimulationError, match="cannot be used") as error:
        simulator.load_world(LoadRequest(str(write_room(tmp_path))))
    assert error.value.code is LoadWorldCode.RESOURCE_PARSE_ERROR
    assert simulator.state is NO_WORLD


def test_nothing_else_happens_while_a_world_is_read(make: Make, tmp_path: Path) -> None:
    simulator = make()
    request = LoadRequest(str(write_room(tmp_path)))
    simulator.begin_load(request)
    assert simulator.state is LOADING_WORLD
    assert turn(simulator, 5) == 0
    for ask in (lambda: simulator.begin_load(request), simulator.unload_world, lambda: simulator.population):
        with pytest.raises(SimulationError, match="LOADING_WORLD") as error:
            ask()
        assert error.value.code is Result.INCORRECT_STATE
    simulator.finish_load(request, simulator.read_world(request))
    assert simulator.state is STOPPED


def test_world_that_was_read_after_a_request_to_quit_is_not_entered(make: Make, tmp_path: Path) -> None:
    simulator = make()
    request = LoadRequest(str(write_room(tmp_path)))
    simulator.begin_load(request)
    scene = simulator.read_world(request)
    simulator.set_state(QUITTING)
    with pytest.raises(SimulationError):
        simulator.finish_load(request, scene)
    assert simulator.world is None


def test_named_poses_are_those_of_the_world_as_it_was_loaded(make: Make, tmp_path: Path) -> None:
    simulator = make()
    simulator.load_world(LoadRequest(str(write_room(tmp_path))))
    names = [pose.name for pose in simulator.named_poses(TagsFilter(("start", "room")))]
    assert names == ["middle", "floor_0/room_0"]
    # Half a side of 4 m, less half a wall, in a circle: (2 - 0.05) / sqrt(2).
    high, low = simulator.named_pose_bounds("middle").points
    assert high[:2] == pytest.approx((1.379, 1.379), abs=0.04)
    assert low[:2] == pytest.approx((-1.379, -1.379), abs=0.04)
    with pytest.raises(SimulationError) as error:
        simulator.named_pose_bounds("attic")
    assert error.value.code is Result.NOT_FOUND


def test_thousands_of_sources_are_refused_at_once() -> None:
    for search in (
        lambda sources: catalogue.available_worlds(sources, TagsFilter(), continue_on_error=True),
        catalogue.spawnables,
    ):
        with pytest.raises(SimulationError, match="1001 sources are given, at most 1000 are searched; give folders above them"):
            search(("a",) * 1001)


def test_available_worlds_are_the_built_in_ones_and_those_of_the_sources(tmp_path: Path) -> None:
    folder = write_room(tmp_path / "tiny")
    found = catalogue.available_worlds((str(tmp_path),), TagsFilter(), continue_on_error=False)
    assert {"flat", (folder / "scene.yaml").as_uri()} <= {world.uri for world in found}
    assert catalogue.available_worlds((), TagsFilter(("no such tag",)), continue_on_error=False) == ()


def test_missing_source_is_an_error_unless_continuing_is_requested() -> None:
    with pytest.raises(SimulationError) as error:
        catalogue.available_worlds(("/no/such/folder",), TagsFilter(), continue_on_error=False)
    assert error.value.code is Result.NOT_FOUND
    assert catalogue.available_worlds(("/no/such/folder",), TagsFilter(), continue_on_error=True)


def test_default_sources_that_fail_have_a_code_of_their_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def gone() -> tuple[WorldEntry, ...]:
        raise WorldError(WorldFailure.NO_RESOURCE, "the disk is gone")

    def find(sources: tuple[str, ...], **_: object) -> tuple[WorldEntry, ...]:
        return (WorldEntry("there", sources[0]),)

    monkeypatch.setattr(catalogue, "built_in_worlds", gone)
    monkeypatch.setattr(catalogue, "worlds_below", find)
    with pytest.raises(SimulationError) as error:
        catalogue.available_worlds((), TagsFilter(), continue_on_error=False)
    assert error.value.code is WorldsCode.DEFAULT_SOURCES_FAILED
    assert len(catalogue.available_worlds(("x",), TagsFilter(), continue_on_error=True)) == 1


def test_world_is_described_without_reading_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Reading all installed scenes would stop time for most of a second."""
    described = []
    world = worlds._world
    monkeypatch.setattr(worlds, "_world", lambda *args: described.append(args) or world(*args))
    for uri in ("arena", str(write_room(tmp_path))):
        described.clear()
        known = catalogue.description_of(uri)
        assert known is not None and known.tags == ("scene.yaml",)
        assert len(described) == 1


def test_installed_things_are_listed_once_however_many_sources_there_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    listed = []
    for module, name in ((worlds, "known_scenes"), (spawnables, "built_in_spawnables")):
        original = getattr(module, name)
        monkeypatch.setattr(module, name, lambda f=original, n=name: listed.append(n) or f())
    sources = tuple(str(write_room(tmp_path / str(k))) for k in range(4))
    catalogue.available_worlds(sources, TagsFilter(), continue_on_error=False)
    catalogue.spawnables(sources)
    assert sorted(listed) == ["built_in_spawnables", "known_scenes"]


def test_spawnables_name_missing_sources_and_list_the_others(tmp_path: Path) -> None:
    (tmp_path / "ball.urdf").write_text(BALL)
    found, remark = catalogue.spawnables(("/no/such/folder", str(tmp_path)))
    assert {"gibson_bot", (tmp_path / "ball.urdf").as_uri()} <= {spawnable.uri for spawnable in found}
    assert "/no/such/folder" in remark


def test_closed_simulator_can_be_closed_again(make: Make, caplog: pytest.LogCaptureFixture) -> None:
    simulator = make()
    simulator.close()
    simulator.close()
    assert simulator.world is None
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
    assert SCENE.revision == 1


def test_steps_of_an_epoch_count_on_until_the_next_world(make: Make) -> None:
    simulator = make()
    turn(simulator, 7)
    simulator.unload_world()
    assert (simulator.epoch, simulator.epoch_step) == (0, 7), "what comes now comes after step 7, as the journal has it"
