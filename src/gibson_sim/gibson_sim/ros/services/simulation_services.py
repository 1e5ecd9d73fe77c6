"""The services and the action of ``simulation_interfaces`` for a ``Simulator``.

The node's loop is in the docstring of ``gibson_sim.standard.simulator``. Every request gets a result: an error of this package becomes its
result code, any other exception becomes RESULT_OPERATION_FAILED and a traceback in the log. Long requests do not block the loop: the loop
executes steps, a thread reads worlds, and many entities are spawned a few at a time.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from threading import Thread
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import SpawnResult

from gibson_sim import __version__
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.services import simulation_conversions as convert
from gibson_sim.ros.services.deferred import DeferredResponse, DeferredService, RequestQueue
from gibson_sim.scenes.spawning import SPAWN_FORMATS
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.standard import catalogue
from gibson_sim.standard.codes import Result, SimulationError, SpawnEntitiesCode, shortened
from gibson_sim.standard.features import supported_features
from gibson_sim.standard.population import PreloadedResource
from gibson_sim.standard.requests import CHANGING_REQUESTS, LoadRequest, WorldInfo
from gibson_sim.standard.simulator import Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.standard.stepping import StepRequest

logger = logging.getLogger(__name__)

_CHANGING_STATES = (SimulationState.STOPPED, SimulationState.PLAYING)
"""States whose request changes the simulation: stopping resets it, and playing starts a loaded world; pausing changes nothing."""
_TIMING = ("set_simulation_state", "step_simulation", "simulate_steps")
"""Services and actions whose requests change how time passes, if they change nothing else."""
_SPAWNING = frozenset({"spawn_entity", "spawn_entities"})
"""Services whose requests name files; their handlers get the preloaded resources."""
_Handler = Callable[..., DeferredResponse | str | None]
_Preloaded = list[PreloadedResource | None] | None
SPAWNS_AT_ONCE = 50
"""Maximum number of entities of one request that are spawned before the loop continues."""
QUIT_GRACE_S = 0.3
"""Time between the response to STATE_QUITTING and the end of the process, s of wall time: an ended process cannot resend a lost response."""


class SimulationServices:
    """Provides the services and the action of the standard.

    Services (simulation_interfaces/srv, named in snake_case after ``prefix``): GetSimulatorFeatures, Get/SetSimulationState,
    ResetSimulation, StepSimulation, GetEntities, GetEntitiesStates, Get/SetEntityState, Get/SetEntityInfo, GetEntityBounds,
    SpawnEntity, SpawnEntities, DeleteEntity, GetSpawnables, GetNamedPoses, GetNamedPoseBounds, LoadWorld, UnloadWorld,
    GetAvailableWorlds, GetCurrentWorld.

    Actions (simulation_interfaces/action): SimulateSteps.
    """

    def __init__(
        self,
        node: Node,
        simulator: Simulator,
        prefix: str = "",
        journal: Journal | None = None,
        lockstep: bool = False,
    ) -> None:
        """Creates the services. The node must be added to an executor.

        Args:
            node: node of the services.
            simulator: simulator that they control.
            prefix: prefix of the service names; it may contain a namespace, such as ``sim/``.
            journal: publishes the requests that changed the simulation or how time passes; None = they are not published.
            lockstep: whether time waits while the files of spawned entities are read, so that the step at which they appear does not depend
                on the reading time. Otherwise time passes meanwhile, and later requests are queued.
        """
        self._node, self._simulator, self._prefix = node, simulator, prefix
        self._journal = journal
        self._closed, self._quit_s, self._preloads = False, -math.inf, not lockstep
        self._requests = RequestQueue(self._run_soon)
        self._goals: dict[bytes, StepRequest] = {}
        self._searches: deque[Callable[[], None]] = deque()
        """File searches that wait for the running one."""
        self._searching = False
        group = ReentrantCallbackGroup()
        self._action = ActionServer(
            node,
            SimulateSteps,
            f"{prefix}simulate_steps",
            execute_callback=_unused,
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel,
            callback_group=group,
        )
        self._services = [
            DeferredService(node, kind, f"{prefix}{name}", partial(self._on_request, name, handler), callback_group=group)
            # GetSimulationState is the last one: once it is discovered, the others are, too.
            for kind, name, handler in sorted(self._table(), key=lambda entry: entry[0] is srv.GetSimulationState)
        ]

    @property
    def quit_is_answered(self) -> bool:
        """Whether a client has requested STATE_QUITTING, and the response has had ``QUIT_GRACE_S`` to arrive."""
        return self._simulator.quitting and time.monotonic() - self._quit_s >= QUIT_GRACE_S

    def close(self) -> None:
        """Destroys the action server; the services end with the node."""
        if not self._closed:
            self._closed = True
            self._action.destroy()

    def _table(self) -> list[tuple[Any, str, _Handler]]:
        """Returns type, name and handler of every service, in the order of the standard's features."""
        return [
            (srv.GetSimulatorFeatures, "get_simulator_features", self._get_features),
            (srv.GetSimulationState, "get_simulation_state", self._get_state),
            (srv.SetSimulationState, "set_simulation_state", self._set_state),
            (srv.ResetSimulation, "reset_simulation", self._reset),
            (srv.StepSimulation, "step_simulation", self._step),
            (srv.GetEntities, "get_entities", self._get_entities),
            (srv.GetEntitiesStates, "get_entities_states", self._get_entities_states),
            (srv.GetEntityState, "get_entity_state", self._get_entity_state),
            (srv.SetEntityState, "set_entity_state", self._set_entity_state),
            (srv.GetEntityInfo, "get_entity_info", self._get_entity_info),
            (srv.SetEntityInfo, "set_entity_info", self._set_entity_info),
            (srv.GetEntityBounds, "get_entity_bounds", self._get_entity_bounds),
            (srv.SpawnEntity, "spawn_entity", self._spawn_entity),
            (srv.SpawnEntities, "spawn_entities", self._spawn_entities),
            (srv.DeleteEntity, "delete_entity", self._delete_entity),
            (srv.GetSpawnables, "get_spawnables", self._get_spawnables),
            (srv.GetNamedPoses, "get_named_poses", self._get_named_poses),
            (srv.GetNamedPoseBounds, "get_named_pose_bounds", self._get_named_pose_bounds),
            (srv.LoadWorld, "load_world", self._load_world),
            (srv.UnloadWorld, "unload_world", self._unload_world),
            (srv.GetAvailableWorlds, "get_available_worlds", self._get_available_worlds),
            (srv.GetCurrentWorld, "get_current_world", self._get_current_world),
        ]

    def replay(self, name: str, request: Any) -> None:
        """Executes a request of a recorded run, without sending a response.

        Args:
            name: full name of the service.
            request: request of the service.

        Raises:
            ConfigError: the service does not exist.
        """
        for kind, service, handler in self._table():
            if self._full_name(service) == name:
                response = self._handle(service, handler, request, kind.Response())
                if not isinstance(response, DeferredResponse) and response.result.result != Result.OK:
                    logger.warning("%s, replayed from a recording: %s", name, response.result.error_message)
                return
        raise ConfigError(f"service {quoted(name)} does not exist; was the run recorded with another 'service_prefix'?")

    def _on_request(self, name: str, handler: _Handler, request: Any, response: Any) -> Any:
        """Handles a request in order of arrival, after its files were read."""
        if not _changes(name, request):
            return self._handle(name, handler, request, response)
        read = self._file_reader(name, request) if self._preloads and name in _SPAWNING else None
        return self._requests.submit(lambda preloaded: self._handle(name, handler, request, response, preloaded), read)

    def _file_reader(self, name: str, request: Any) -> Callable[[], Any] | None:
        """Returns a function that reads the files of a request; None if the request fails anyway."""
        items = list(request.spawn_requests) if name == "spawn_entities" else [request]
        try:
            return self._simulator.population.file_reader([convert.spawn_request_from_msg(item) for item in items])
        except SimulationError:
            return None

    def _handle(self, name: str, handler: _Handler, request: Any, response: Any, preloaded: Any = None) -> Any:
        """Returns the response to a request, or a DeferredResponse. A handler returns None or a remark if it succeeds immediately."""
        publish = self._entry(name, request)
        try:
            outcome = handler(request, response, preloaded) if name in _SPAWNING else handler(request, response)
        except SimulationError as error:  # refused: nothing has changed
            return failed(response, error)
        except Exception as error:
            publish()
            return failed(response, error)
        publish()
        return outcome if isinstance(outcome, DeferredResponse) else succeeded(response, outcome or "")

    def _entry(self, name: str, request: Any) -> Callable[[], None]:
        """Returns a function that publishes a request in the journal, with the present step, if it belongs there."""
        changes = _changes(name, request)
        if self._journal is None or not (changes or name in _TIMING):
            return lambda: None
        return self._journal.entry(self._full_name(name), request, timing_only=not changes)

    def _full_name(self, name: str) -> str:
        return self._node.resolve_service_name(f"{self._prefix}{name}")

    def _run_soon(self, function: Callable[..., Any], *arguments: Any) -> None:
        if not self._closed:
            self._node.executor.create_task(function, *arguments)

    def _get_features(self, _: Any, response: Any) -> None:
        response.features.features = list(supported_features())
        response.features.spawn_formats = list(SPAWN_FORMATS)
        response.features.custom_info = f"Gibson Sim {__version__}, docs/simulation_interfaces.md"

    def _get_state(self, _: Any, response: Any) -> None:
        response.state.state = int(self._simulator.state)

    def _set_state(self, request: Any, _: Any) -> None:
        self._simulator.set_state(request.state.state)
        if self._simulator.quitting:
            self._quit_s = time.monotonic()

    def _reset(self, request: Any, _: Any) -> None:
        self._simulator.reset(request.scope)

    def _step(self, request: Any, response: Any) -> DeferredResponse:
        deferred = DeferredResponse()

        def on_end(work: StepRequest) -> None:
            error = SimulationError(Result.OPERATION_FAILED, work.failure) if work.failure else None
            deferred.send(succeeded(response) if error is None else failed(response, error))

        self._simulator.request_steps(request.steps, on_end=on_end)
        return deferred

    def _get_entities(self, request: Any, response: Any) -> None:
        entities = self._simulator.population.select(convert.filters_from_msg(request.filters))
        response.entities = [entity.name for entity in entities]

    def _get_entities_states(self, request: Any, response: Any) -> None:
        self._get_entities(request, response)
        response.states = [self._state_msg(name) for name in response.entities]

    def _get_entity_state(self, request: Any, response: Any) -> None:
        response.state = self._state_msg(request.entity)

    def _state_msg(self, name: str) -> Any:
        state, world = self._simulator.population.state(name), self._simulator.world
        return convert.entity_state_to_msg(state, 0 if world is None else world.stamp_ns)

    def _set_entity_state(self, request: Any, _: Any) -> None:
        self._simulator.population.set_state(request.entity, convert.state_change_from_msg(request))

    def _get_entity_info(self, request: Any, response: Any) -> None:
        response.info = convert.entity_info_to_msg(self._simulator.population.entity(request.entity).info)

    def _set_entity_info(self, request: Any, _: Any) -> None:
        self._simulator.population.set_info(request.entity, convert.entity_info_from_msg(request.info))

    def _get_entity_bounds(self, request: Any, response: Any) -> None:
        response.bounds = convert.bounds_to_msg(self._simulator.population.bounds(request.entity))

    def _spawn_entity(self, request: Any, response: Any, preloaded: _Preloaded) -> None:
        response.entity_name = self._simulator.population.spawn(
            convert.spawn_request_from_msg(request), preloaded[0] if preloaded else None
        )

    def _spawn_entities(self, request: Any, response: Any, preloaded: _Preloaded) -> DeferredResponse:
        deferred = DeferredResponse()
        waiting = list(zip(request.spawn_requests, preloaded or [None] * len(request.spawn_requests), strict=True))
        _ = self._simulator.population  # without a world the request fails as a whole

        def spawn_some() -> None:
            batch, waiting[:] = waiting[:SPAWNS_AT_ONCE], waiting[SPAWNS_AT_ONCE:]
            for item in batch:
                response.results.append(self._spawn_result(*item))
            if waiting:
                self._node.executor.create_task(spawn_some)
            else:
                failures = sum(result.result.result != Result.OK for result in response.results)
                text = f"{failures} of {len(response.results)} entities could not be spawned; see the results"
                error = SimulationError(SpawnEntitiesCode.ENTITIES_SPAWN_FAILED, text)
                deferred.send(failed(response, error) if failures else succeeded(response))

        response.results = []
        spawn_some()
        return deferred

    def _spawn_result(self, item: Any, preloaded: PreloadedResource | None) -> SpawnResult:
        """Spawns one of several entities and returns its result."""
        result = SpawnResult()
        try:
            result.entity_name = self._simulator.population.spawn(convert.spawn_request_from_msg(item), preloaded)
        except Exception as error:
            return failed(result, error)
        return succeeded(result)

    def _delete_entity(self, request: Any, _: Any) -> None:
        self._simulator.population.delete(request.entity)

    def _run_in_thread(self, work: Callable[[], str], response: Any) -> DeferredResponse:
        """Runs a file search in a thread while time passes; ``work`` accesses only files and the response, and returns a remark."""
        deferred = DeferredResponse()

        def on_end(outcome: str | Exception) -> None:
            self._searching = False
            deferred.send(failed(response, outcome) if isinstance(outcome, Exception) else succeeded(response, outcome))
            self._start_next_search()

        def run() -> None:
            outcome: str | Exception
            try:
                outcome = work()
            except Exception as error:
                outcome = error
            self._run_soon(on_end, outcome)

        self._searches.append(run)
        self._start_next_search()
        return deferred

    def _start_next_search(self) -> None:
        """Starts the next search unless one is running: many at once would starve the simulation of CPU time."""
        if self._searches and not self._searching:
            self._searching = True
            Thread(target=self._searches.popleft(), name="file-search", daemon=True).start()

    def _get_spawnables(self, request: Any, response: Any) -> DeferredResponse:
        sources = tuple(request.sources)

        def work() -> str:
            spawnables, remark = catalogue.spawnables(sources)
            response.spawnables = [convert.spawnable_to_msg(spawnable) for spawnable in spawnables]
            return remark

        return self._run_in_thread(work, response)

    def _get_named_poses(self, request: Any, response: Any) -> None:
        poses = self._simulator.named_poses(convert.tags_filter_from_msg(request.tags))
        response.poses = [convert.named_pose_to_msg(pose) for pose in poses]

    def _get_named_pose_bounds(self, request: Any, response: Any) -> None:
        response.bounds = convert.bounds_to_msg(self._simulator.named_pose_bounds(request.name))

    def _load_world(self, request: Any, response: Any) -> DeferredResponse:
        deferred, load = DeferredResponse(), convert.load_request_from_msg(request)
        self._simulator.begin_load(load)

        def read() -> None:
            outcome: SceneSpec | Exception
            try:
                outcome = self._simulator.read_world(load)
            except Exception as error:
                outcome = error
            self._run_soon(self._finish_load, load, outcome, response, deferred)

        Thread(target=read, name="read-world", daemon=True).start()
        return deferred

    def _finish_load(self, load: LoadRequest, outcome: SceneSpec | Exception, response: Any, deferred: DeferredResponse) -> None:
        """Creates the world of the scene that was read, in the thread that owns physics."""
        try:
            if isinstance(outcome, Exception):
                raise outcome
            response.world = convert.world_to_msg(self._simulator.finish_load(load, outcome))
        except Exception as error:
            self._simulator.abandon_load()
            deferred.send(failed(response, error))
        else:
            deferred.send(succeeded(response))

    def _unload_world(self, _: Any, __: Any) -> None:
        self._simulator.unload_world()

    def _get_available_worlds(self, request: Any, response: Any) -> DeferredResponse:
        sources, tags = tuple(request.additional_sources), convert.tags_filter_from_msg(request.filter)

        def work() -> str:
            worlds = catalogue.available_worlds(sources, tags, continue_on_error=request.continue_on_error)
            infos = [WorldInfo(w.name, w.uri, description=w.description, tags=w.tags) for w in worlds]
            response.worlds = [convert.world_to_msg(info) for info in infos]
            return ""

        return self._run_in_thread(work, response)

    def _get_current_world(self, _: Any, response: Any) -> None:
        response.world = convert.world_to_msg(self._simulator.current_world())

    def _on_goal(self, goal: Any) -> None:
        """Requests the steps of an accepted goal; for rclpy, the goal executes once they are done."""
        key = bytes(goal.goal_id.uuid)
        publish = self._entry("simulate_steps", goal.request)

        def on_progress(work: StepRequest) -> None:
            goal.publish_feedback(SimulateSteps.Feedback(completed_steps=work.completed, remaining_steps=work.remaining))

        def on_end(work: StepRequest) -> None:
            self._goals.pop(key, None)
            end_goal(goal, SimulationError(Result.OPERATION_FAILED, work.failure) if work.failure else None)

        try:
            work = self._simulator.request_steps(goal.request.steps, on_progress, on_end)
        except SimulationError as error:
            end_goal(goal, error)
            return
        publish()
        if not work.ended:
            self._goals[key] = work

    def _on_cancel(self, goal: Any) -> CancelResponse:
        work = self._goals.get(bytes(goal.goal_id.uuid))
        if work is None:
            return CancelResponse.REJECT
        self._simulator.cancel_steps(work)
        return CancelResponse.ACCEPT


def succeeded(response: Any, remark: str = "") -> Any:
    """Returns the response with RESULT_OK; only GetSimulatorFeatures has no result."""
    if hasattr(response, "result"):
        response.result.result, response.result.error_message = int(Result.OK), remark
    return response


def failed(response: Any, error: Exception) -> Any:
    """Returns the response with the code and the message of an error; an internal error is logged with its traceback."""
    code: IntEnum = error.code if isinstance(error, SimulationError) else Result.OPERATION_FAILED
    text = str(error)
    if not isinstance(error, GibsonSimError):
        logger.error("a request failed with an internal error", exc_info=error)
        text = f"internal error: {type(error).__name__}; see the log of the simulation"
    if hasattr(response, "result"):
        response.result.result, response.result.error_message = int(code), shortened(text)
    return response


def end_goal(goal: Any, error: SimulationError | None) -> None:
    """Ends a goal as cancelled if the client requested that, as aborted if there is an error, otherwise as succeeded."""

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


def _changes(name: str, request: Any) -> bool:
    """Returns whether a request changes the state of the simulation, not only its timing."""
    return name in CHANGING_REQUESTS and not (name == "set_simulation_state" and request.state.state not in _CHANGING_STATES)


def _unused(_: Any) -> Any:
    raise AssertionError("goals have their own callbacks")
