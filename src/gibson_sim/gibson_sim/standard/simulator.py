"""The simulation of ``simulation_interfaces``: a state, at most one world, and the steps that clients request.

Time passes only in the node's loop::

    steps = simulator.steps_due(pacer.due(now_ns))   # also while paused: the pacer's ticks are dropped then
    for _ in range(steps):
        simulator.step()                             # one physics step; publish the data that is due at it
    if simulator.scene.revision != published: ...    # entities were added or removed, or the world replaced: publish the scene again
    if simulator.epoch != published_epoch: ...       # reset, or the world replaced: see ``simulator.last_reset``
    if simulator.quitting: ...                       # let the services respond, then exit

``simulator.world`` is None while no world is loaded. It is another object after ``load_world``: do not store it.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

from gibson_sim.config import CommandSettings, PhysicsConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.maps.named_poses import NamedPose, named_poses
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.grasping import GraspMode, GraspSettings
from gibson_sim.robots.joints.servo import ServoSettings
from gibson_sim.scenes import worlds
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.standard.bounds import Bounds, box_bounds
from gibson_sim.standard.catalogue import description_of
from gibson_sim.standard.codes import LoadWorldCode, Result, SimulationError, StateCode, WorldCode, client_message
from gibson_sim.standard.filters import TagsFilter
from gibson_sim.standard.population import Population
from gibson_sim.standard.requests import LastReset, LoadRequest, ResetScope, WorldInfo, resource_name
from gibson_sim.standard.states import HAS_WORLD, SimulationState, check_transition
from gibson_sim.standard.stepping import StepQueue, StepRequest

logger = logging.getLogger(__name__)
STEPS_AT_ONCE = 60
"""Maximum number of requested steps that the loop executes before it handles messages again."""
EVERYTHING = 255
"""Scope of a reset of everything."""
_ALL = ResetScope.TIME | ResetScope.STATE | ResetScope.SPAWNED


class Simulator:
    """Owns the world, and must be closed. Not thread-safe, except ``read_world``."""

    def __init__(
        self,
        scene: SceneSpec | None,
        config: PhysicsConfig,
        *,
        make_world: Callable[..., PhysicsWorld] = PhysicsWorld,
    ) -> None:
        """Loads the scene; the state is then PLAYING, or STOPPED with ``config.time.start_paused``.

        Args:
            scene: scene of the first world; None = no world.
            config: settings of the physics node.
            make_world: creates the world of a scene.

        Raises:
            GibsonSimError: the scene cannot be used.
        """
        self._config, self._make_world = config, make_world
        self._steps = StepQueue()
        self._state = SimulationState.NO_WORLD
        self._world: PhysicsWorld | None = None
        self._population: Population | None = None
        self._info: WorldInfo | None = None
        self._empty = SceneSpec("", Path("/nonexistent"), "", (), (), revision=0)
        self._first_scene: SceneSpec | None = None
        self._named_poses: tuple[NamedPose, ...] | None = None
        self._steps_before = 0
        self.epoch = 0
        """Number of resets and new worlds so far."""
        self._epoch_start = 0
        self.last_reset = LastReset()
        """The reset or load that began the newest epoch."""
        if scene is not None:
            self._enter(scene, uri=worlds.absolute_uri(config.world.scene))
            self.epoch = 0
            self._state = SimulationState.STOPPED if config.time.start_paused else SimulationState.PLAYING

    @property
    def state(self) -> SimulationState:
        """State of the simulation."""
        return self._state

    @property
    def quitting(self) -> bool:
        """Whether a client has requested to quit."""
        return self._state is SimulationState.QUITTING

    @property
    def world(self) -> PhysicsWorld | None:
        """The world; None = no world is loaded."""
        return self._world

    @property
    def scene(self) -> SceneSpec:
        """The present scene, empty without a world; ``revision`` increases with every change, across worlds."""
        return self._empty if self._world is None else self._world.scene

    @property
    def population(self) -> Population:
        """The entities of the world.

        Raises:
            SimulationError: INCORRECT_STATE if no world is loaded.
        """
        if self._population is None or self._state not in HAS_WORLD:
            raise SimulationError(
                Result.INCORRECT_STATE, f"the simulation is {self._state.name}, so there are no entities; load a world first"
            )
        return self._population

    def set_state(self, target: int) -> None:
        """Plays, pauses, stops or quits. Step requests end.

        Raises:
            SimulationError: with a StateCode.
        """
        if target == SimulationState.PAUSED and self._state is SimulationState.PAUSED and self._steps.clear("paused"):
            return
        state = check_transition(self._state, target)
        self._steps.clear(f"set to {state.name}")
        if state is SimulationState.STOPPED:
            self._state = SimulationState.PAUSED
            try:
                self.reset()
            except SimulationError as error:
                raise SimulationError(
                    StateCode.STATE_TRANSITION_ERROR, f"the simulation is paused, but cannot be reset: {error}"
                ) from error
        self._state = state

    def reset(self, scope: int = EVERYTHING) -> None:
        """Restores the initial state of the world, or parts of it. A playing simulation continues to play.

        A reset of everything (0, 255, or all three bits) also restores deleted entities and the initial info of all entities.

        Raises:
            SimulationError: INCORRECT_STATE without a world, OPERATION_FAILED for an unknown scope or an error of the world.
        """
        world, population = self._world, self.population
        assert world is not None, "a population has a world"
        if scope not in (0, EVERYTHING) and scope & ~int(_ALL):
            raise SimulationError(
                Result.OPERATION_FAILED,
                f"scope {scope} is not known; 1 = time, 2 = state, 4 = spawned, their sums, 0 or 255 = all",
            )
        parts = _ALL if scope in (0, EVERYTHING) else ResetScope(scope)
        rewinds = bool(parts & ResetScope.TIME) and self._config.time.reset_time == "rewind"
        self._steps.clear("reset")
        try:
            if parts == _ALL:
                population.restore()
            elif parts & ResetScope.SPAWNED:
                population.delete_spawned()
            if parts & ResetScope.STATE:
                world.reset(keep_time=True)
            if rewinds:
                world.set_step_count(0)
        except GibsonSimError as error:
            raise SimulationError(Result.OPERATION_FAILED, f"reset: {error}") from error
        finally:
            self._begin_epoch(LastReset(int(parts), rewinds))

    def steps_due(self, paced: int) -> int:
        """Returns the number of steps that the loop must execute now.

        Args:
            paced: steps due by wall time, used only if the simulation is playing.
        """
        if self._world is None:
            return 0
        if self._state is SimulationState.PLAYING:
            return paced
        return min(self._steps.remaining, STEPS_AT_ONCE) if self._state is SimulationState.PAUSED else 0

    def step(self) -> None:
        """Executes one step of ``1 / step_hz`` s, and counts it for the first step request, if there is one."""
        if self._world is not None:
            self._world.step(1)
            self._steps.count_step()

    def request_steps(
        self,
        steps: int,
        on_progress: Callable[[StepRequest], None] | None = None,
        on_end: Callable[[StepRequest], None] | None = None,
    ) -> StepRequest:
        """Requests steps while paused, which the loop executes later; ``on_end`` is called once, maybe before this returns.

        Raises:
            SimulationError: INCORRECT_STATE without a world, OPERATION_FAILED if it is not paused.
        """
        if self._state not in HAS_WORLD:
            raise SimulationError(Result.INCORRECT_STATE, f"the simulation is {self._state.name}; load a world first")
        if self._state is not SimulationState.PAUSED:
            raise SimulationError(
                Result.OPERATION_FAILED,
                f"the simulation is {self._state.name}, must be PAUSED to step: pause it first, as with `gibson-sim pause`",
            )
        request = StepRequest(steps, on_progress, on_end)
        self._steps.add(request)
        return request

    def cancel_steps(self, request: StepRequest) -> None:
        """Cancels a step request; has no effect on one that has ended."""
        self._steps.cancel(request, "cancelled")

    def load_world(self, request: LoadRequest) -> WorldInfo:
        """Replaces the world, at once; see ``begin_load``."""
        self.begin_load(request)
        try:
            scene = self.read_world(request)
        except SimulationError:
            self.abandon_load()
            raise
        return self.finish_load(request, scene)

    def begin_load(self, request: LoadRequest) -> None:
        """Unloads the world, as the standard requires; the state is LOADING_WORLD until ``finish_load`` or ``abandon_load``.

        Raises:
            SimulationError: the request has no resource, or another world is being loaded; the present world stays loaded.
        """
        if self._state in (SimulationState.LOADING_WORLD, SimulationState.QUITTING):
            raise SimulationError(Result.INCORRECT_STATE, f"the simulation is {self._state.name}; wait until it has finished")
        if not (request.uri.strip() or request.text.strip()):
            raise SimulationError(
                LoadWorldCode.NO_RESOURCE, "neither a uri nor a resource_string is given; see get_available_worlds"
            )
        self._leave()
        self._state = SimulationState.LOADING_WORLD

    @staticmethod
    def read_world(request: LoadRequest) -> SceneSpec:
        """Reads and returns the requested scene; uses no state of the simulator and may take long, so any thread may call it.

        Raises:
            SimulationError: with a LoadWorldCode.
        """
        try:
            return worlds.load_world(
                request.uri,
                request.text,
                fail_on_unsupported=request.fail_on_unsupported,
                ignore_missing=request.ignore_missing,
            )
        except worlds.WorldError as error:
            raise SimulationError(LoadWorldCode[error.code.name], client_message(resource_name(request.uri), error)) from error
        except GibsonSimError as error:
            raise SimulationError(
                LoadWorldCode.RESOURCE_PARSE_ERROR, client_message(resource_name(request.uri), error)
            ) from error

    def finish_load(self, request: LoadRequest, scene: SceneSpec) -> WorldInfo:
        """Creates the world of a scene that ``read_world`` returned; the state is then STOPPED.

        Raises:
            SimulationError: the world cannot be created, or a client has requested to quit meanwhile.
        """
        if self._state is not SimulationState.LOADING_WORLD:
            raise SimulationError(Result.INCORRECT_STATE, f"the simulation became {self._state.name} while the world was read")
        self._state = SimulationState.NO_WORLD
        try:
            self._enter(scene, uri=request.uri, text="" if request.uri.strip() else request.text)
        except GibsonSimError as error:
            raise SimulationError(
                LoadWorldCode.RESOURCE_PARSE_ERROR, client_message(resource_name(request.uri), error)
            ) from error
        self._state = SimulationState.STOPPED
        return self.current_world()

    def abandon_load(self) -> None:
        """Ends the loading of a world that could not be read; the state is then NO_WORLD."""
        if self._state is SimulationState.LOADING_WORLD:
            self._state = SimulationState.NO_WORLD

    def unload_world(self) -> None:
        """Unloads the world.

        Raises:
            SimulationError: WorldCode.NO_WORLD_LOADED, or INCORRECT_STATE while one is being loaded.
        """
        if self._state in (SimulationState.LOADING_WORLD, SimulationState.QUITTING):
            raise SimulationError(Result.INCORRECT_STATE, f"the simulation is {self._state.name}; wait until it has finished")
        self.current_world()
        self._leave()
        self._state = SimulationState.NO_WORLD

    def current_world(self) -> WorldInfo:
        """Returns the description of the loaded world, or raises SimulationError(NO_WORLD_LOADED)."""
        if self._info is None:
            raise SimulationError(WorldCode.NO_WORLD_LOADED, "no world is loaded; see get_available_worlds and load_world")
        return self._info

    def named_poses(self, tags: TagsFilter) -> tuple[NamedPose, ...]:
        """Returns the named poses of the world that pass the filter."""
        tags.check()
        return tuple(pose for pose in self._all_named_poses() if tags.passes(pose.tags))

    def named_pose_bounds(self, name: str) -> Bounds:
        """Returns the box of free space around a named pose, in the frame of the pose, m."""
        for pose in self._all_named_poses():
            if pose.name == name:
                return box_bounds(pose.low, pose.high)
        raise SimulationError(Result.NOT_FOUND, f"pose {quoted(name)} does not exist; see get_named_poses")

    def close(self) -> None:
        """Frees the world; a second call does nothing."""
        self._leave()
        if self._state is not SimulationState.QUITTING:
            self._state = SimulationState.NO_WORLD

    def _all_named_poses(self) -> tuple[NamedPose, ...]:
        if self._first_scene is None:
            raise SimulationError(
                Result.INCORRECT_STATE, f"the simulation is {self._state.name}, so there are no poses; load a world first"
            )
        if self._named_poses is None:
            self._named_poses = named_poses(self._first_scene)
        return self._named_poses

    def _enter(self, scene: SceneSpec, uri: str, text: str = "") -> None:
        """Creates the world of a scene, with a revision higher than that of all previous scenes."""
        world = self._make_world(
            replace(scene, revision=self._empty.revision + 1),
            step_hz=self._config.time.step_hz,
            cmd_vel_timeout=self._config.commands.cmd_vel_timeout,
            seed=self._config.world.seed,
            grasping=_grasp_settings(self._config.commands),
            servo=_servo_settings(self._config.commands),
        )
        if self._config.time.reset_time == "monotonic":
            world.set_step_count(self._steps_before)
        entry = description_of(uri) if uri else None
        description, tags = (entry.description, entry.tags) if entry is not None else ("", ())
        self._world, self._info = world, WorldInfo(scene.name, uri, text, description, tags)
        self._population = Population(world, robot_tf=self._config.world.robot_tf)
        self._first_scene, self._named_poses = world.scene, None
        self._begin_epoch(LastReset(int(_ALL), world.step_count == 0))

    def _leave(self) -> None:
        """Frees the world, if there is one."""
        self._steps.clear("the world was unloaded")
        if self._world is not None:
            self._empty = replace(self._empty, revision=self._world.scene.revision + 1)
            self._steps_before = self._world.step_count
            self._world.close()
        self._world = self._population = self._info = self._first_scene = None

    @property
    def epoch_step(self) -> int:
        """Number of steps since the epoch began; without a world, those of the last world in it."""
        return (self._steps_before if self._world is None else self._world.step_count) - self._epoch_start

    def _begin_epoch(self, reset: LastReset) -> None:
        self._epoch_start = 0 if self._world is None else self._world.step_count
        self.epoch += 1
        self.last_reset = reset


def _grasp_settings(commands: CommandSettings) -> GraspSettings:
    """Returns the grasp settings of all grippers; distance in m, forces in N, angle converted to rad."""
    return GraspSettings(
        cast(GraspMode, commands.grasp_mode),  # ``CommandSettings`` has checked it
        commands.grasp_distance,
        commands.grasp_force,
        commands.grasp_release_force,
        math.radians(commands.grasp_release_angle_deg),
    )


def _servo_settings(commands: CommandSettings) -> ServoSettings:
    """Returns the settings of the Cartesian servo."""
    return ServoSettings(commands.servo_max_linear, commands.servo_max_angular, commands.servo_timeout)
