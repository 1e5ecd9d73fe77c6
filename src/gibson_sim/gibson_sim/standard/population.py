"""The entities of a loaded world: spawns, deletes, reads and moves them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import GibsonSimError, StartError
from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose, matrix_from_quat, pose_from_matrix
from gibson_sim.maps.placement import in_namespace
from gibson_sim.physics.body import prepare_meshes
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes import spawning
from gibson_sim.standard.bounds import Bounds, box_bounds
from gibson_sim.standard.codes import EntityStateCode, Result, SimulationError, SpawnCode, client_message
from gibson_sim.standard.entities import Entity, EntityInfo, check_info, check_namespace, choose_name, initial_info
from gibson_sim.standard.filters import EntityFilters, filtered
from gibson_sim.standard.poses import WORLD_FRAMES, checked_pose, checked_velocity, vec3
from gibson_sim.types import Pose, Quat, Vec3

MOST_ENTITIES = 2000
"""Greatest number in a world: beyond it the physics of even resting bodies is slow, and messages that list all of them get large."""
_ABOVE, _DEEPEST = 0.1, 1000.0
"""Height above a spawned thing's origin at which the search for a floor begins, since it may be a little inside of it, and its depth, metres."""
_LOG = logging.getLogger(__name__)
_MOST_LISTED = 8
"""Entities that an error message names."""


@dataclass(frozen=True, slots=True)
class SpawnRequest:
    """A client's request to spawn an entity, unchecked."""

    name: str = ""
    allow_renaming: bool = False
    uri: str = ""
    text: str = ""
    """The file itself; used where ``uri`` is empty."""
    namespace: str = ""
    frame_id: str = ""
    position: Vec3 = (0.0, 0.0, 0.0)
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class ReadAhead:
    """The resource of a spawn request, read before the request takes effect."""

    in_file: str
    """Name in the resource."""
    name: str
    """Name of the entity, as it was chosen at that time."""
    pose: Pose
    """T_world_root, as it was at that time."""
    found: RobotSpec | BodySpec | SimulationError


@dataclass(frozen=True, slots=True)
class SpawnOutcome:
    """Result of one of several requests: a name, or an error."""

    name: str = ""
    error: SimulationError | None = None


@dataclass(frozen=True, slots=True)
class EntityState:
    """Pose and velocity of an entity, world frame."""

    pose: Pose
    """T_world_root."""
    linear: Vec3 = (0.0, 0.0, 0.0)
    """m/s, of the root's origin."""
    angular: Vec3 = (0.0, 0.0, 0.0)
    """rad/s."""


@dataclass(frozen=True, slots=True)
class StateChange:
    """A client's request to set an entity's state, unchecked, in the frame ``frame_id``."""

    frame_id: str = ""
    position: Vec3 = (0.0, 0.0, 0.0)
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)
    linear: Vec3 = (0.0, 0.0, 0.0)
    angular: Vec3 = (0.0, 0.0, 0.0)
    acceleration: tuple[float, ...] = (0.0,) * 6
    """Ignored, except that static entities must have none."""
    set_pose: bool = True
    set_twist: bool = True
    set_acceleration: bool = True


def _resource_name(request: SpawnRequest) -> str:
    return quoted(request.uri) if request.uri.strip() else "resource_string"


def _name_in_file(request: SpawnRequest) -> str:
    return "" if request.name else spawning.spawn_name(request.uri, request.text)


def _load(request: SpawnRequest, name: str, pose: Pose) -> RobotSpec | BodySpec:
    try:
        return spawning.load_spawnable(request.uri, request.text, name=name, pose=pose)
    except spawning.SpawnError as error:
        raise SimulationError(SpawnCode[error.code.name], client_message(_resource_name(request), error)) from error


def _read_ahead(request: SpawnRequest, pose: Pose, used: Mapping[str, object]) -> ReadAhead | None:
    """Returns the resource of a request, or the error in reading it; None if no name can be chosen."""
    if not (request.uri.strip() or request.text.strip()):
        return None
    in_file = _name_in_file(request)
    try:
        name = choose_name(request.name, in_file, request.allow_renaming, used)
    except SimulationError:
        return None
    try:
        spec = _load(request, name, pose)
    except SimulationError as error:
        return ReadAhead(in_file, name, pose, error)
    if isinstance(spec, BodySpec):
        prepare_meshes(spec)
    return ReadAhead(in_file, name, pose, spec)


class Population:
    """All robots and bodies of a world. Every method may raise SimulationError with a code of its service."""

    def __init__(self, world: PhysicsWorld, *, robot_tf: str = "namespaced", most: int = MOST_ENTITIES) -> None:
        """Lists the entities that are in ``world``.

        Args:
            world: to be changed; its owner closes it.
            robot_tf: how robots with a namespace publish transforms, see ``gibson_sim.config.PhysicsConfig``.
            most: greatest number of entities.
        """
        self._world, self._robot_tf, self._most = world, robot_tf, most
        self._initial = world.scene
        self._entities: dict[str, Entity] = {}
        self._list_entities()
        for robot in world.scene.robots:
            if self._has_nothing_below(robot.start, robot.name):
                x, y, _ = robot.start.position
                hint = "`gibson-sim scene inspect` shows where a scene has floor, and the names of its starts"
                _LOG.warning("%s starts at %.2f,%.2f, where there is nothing below it: it falls; %s", robot.name, x, y, hint)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all entities."""
        return tuple(self._entities)

    def select(self, filters: EntityFilters) -> tuple[Entity, ...]:
        """Returns the entities that pass all filters."""
        return filtered(self._entities.values(), filters, self._world.bounds)

    def entity(self, name: str) -> Entity:
        """Returns an entity's name, namespace and info."""
        found = self._entities.get(name)
        if found is None:
            raise SimulationError(Result.NOT_FOUND, f"there is no entity {quoted(name)}; {self._listed()}")
        return found

    def set_info(self, name: str, info: EntityInfo) -> None:
        """Replaces category, description and tags of an entity."""
        entity = self.entity(name)
        self._entities[name] = replace(entity, info=check_info(info))

    def state(self, name: str) -> EntityState:
        """Returns pose and velocity of an entity."""
        self.entity(name)
        linear, angular = self._world.body_twist(name)
        return EntityState(self._world.body_pose(name), vec3(linear), vec3(angular))

    def set_state(self, name: str, change: StateChange) -> None:
        """Moves an entity, or changes its velocity, at once.

        A velocity is that of the root's origin relative to the frame; the velocity of a moving frame is added.
        """
        self.entity(name)
        moves = any((*(change.linear if change.set_twist else ()), *(change.angular if change.set_twist else ())))
        accelerates = change.set_acceleration and any(change.acceleration)
        if self._world.is_static(name) and (moves or accelerates):
            raise SimulationError(
                Result.OPERATION_FAILED,
                f"entity {quoted(name)} is static: it can be placed, but its twist and acceleration must be 0",
            )
        frame = self._frame(change.frame_id, EntityStateCode.INVALID_POSE)
        pose = self.state(name).pose
        if change.set_pose:
            T_frame_entity = matrix_from_pose(checked_pose(change.position, change.quat_xyzw, EntityStateCode.INVALID_POSE))
            pose = self._placed(frame, T_frame_entity, EntityStateCode.INVALID_POSE)
        linear, angular = None, None
        if change.set_twist:
            relative_linear = np.array(checked_velocity("linear", change.linear, "m/s"))
            relative_angular = np.array(checked_velocity("angular", change.angular, "rad/s"))
            rotation = matrix_from_quat(frame.pose.quat_xyzw)
            arm = np.array(pose.position) - np.array(frame.pose.position)
            linear = vec3(rotation @ relative_linear + np.array(frame.linear) + np.cross(frame.angular, arm))
            angular = vec3(rotation @ relative_angular + np.array(frame.angular))
        self._change(
            Result.OPERATION_FAILED, lambda: self._world.set_state(name, pose if change.set_pose else None, linear, angular)
        )

    def bounds(self, name: str) -> Bounds:
        """Returns the bounding box of an entity's collision shapes, in the frame of its root link."""
        self.entity(name)
        T_root_world = invert(matrix_from_pose(self._world.body_pose(name)))
        low, high = self._world.bounds(name, T_frame_world=T_root_world)
        return box_bounds(vec3(low), vec3(high))

    def file_reader(self, requests: Sequence[SpawnRequest]) -> Callable[[], list[ReadAhead | None]]:
        """Returns a function that reads the resources of requests for ``spawn``; it touches nothing else and may be called in any thread.

        It returns None for a request that cannot be read ahead; ``spawn`` raises the reason.
        """
        used: dict[str, object] = dict(self._entities)
        placed: list[tuple[SpawnRequest, Pose | None]] = []
        for request in requests:
            try:
                placed.append((request, self._spawn_pose(request)))
            except SimulationError:
                placed.append((request, None))

        def read() -> list[ReadAhead | None]:
            found: list[ReadAhead | None] = []
            for request, pose in placed:
                ahead = None if pose is None else _read_ahead(request, pose, used)
                if ahead is not None:
                    used[ahead.name] = ahead
                found.append(ahead)
            return found

        return read

    def spawn(self, request: SpawnRequest, ahead: ReadAhead | None = None) -> str:
        """Adds a robot or a body to the world and returns its name; ``ahead``: the result of ``file_reader`` for the request."""
        if not (request.uri.strip() or request.text.strip()):
            raise SimulationError(SpawnCode.NO_RESOURCE, "neither a uri nor a resource_string is given; see get_spawnables")
        if len(self._entities) >= self._most:
            raise SimulationError(
                Result.OPERATION_FAILED, f"there are {self._most} entities, and there may not be more: delete some"
            )
        check_namespace(request.namespace)
        pose = self._spawn_pose(request)
        in_file = _name_in_file(request) if ahead is None else ahead.in_file
        name = choose_name(request.name, in_file, request.allow_renaming, self._entities)
        if ahead is not None and isinstance(ahead.found, SimulationError):
            raise ahead.found
        known = ahead is not None and (ahead.name, ahead.pose) == (name, pose)
        spec = ahead.found if ahead is not None and known else _load(request, name, pose)
        assert not isinstance(spec, SimulationError)
        namespace = request.namespace.strip("/")
        if isinstance(spec, RobotSpec):
            namespace = self._robot_namespace(name, namespace)
            spec = in_namespace(spec, namespace, self._robot_tf) if namespace else spec
        falls = self._has_nothing_below(pose)
        try:
            self._world.add(spec)
        except StartError as error:
            raise SimulationError(SpawnCode.INVALID_POSE, str(error)) from error
        except GibsonSimError as error:
            raise SimulationError(Result.OPERATION_FAILED, client_message(_resource_name(request), error)) from error
        self._entities[name] = Entity(name, initial_info(spec), namespace, spawned=True)
        if falls and not self._world.is_static(name):
            x, y, _ = pose.position
            _LOG.warning("spawned %s at %.2f,%.2f, where there is nothing below it: it falls", quoted(name), x, y)
        return name

    def _has_nothing_below(self, pose: Pose, robot: str | None = None) -> bool:
        """Returns whether no floor or thing is below a pose, however deep, but for a ``robot`` that is there already."""
        x, y, z = pose.position
        return bool(np.isinf(self._world.cast_rays([(x, y, z + _ABOVE)], [(0.0, 0.0, -1.0)], _DEEPEST, robot)[0]))

    def _spawn_pose(self, request: SpawnRequest) -> Pose:
        return self._placed(
            self._frame(request.frame_id, SpawnCode.INVALID_POSE),
            matrix_from_pose(checked_pose(request.position, request.quat_xyzw, SpawnCode.INVALID_POSE)),
            SpawnCode.INVALID_POSE,
        )

    def spawn_all(self, requests: Sequence[SpawnRequest]) -> tuple[SpawnOutcome, ...]:
        """Spawns entities one after the other; returns the result of each. Those that were spawned stay if others fail."""
        outcomes = []
        for request in requests:
            try:
                outcomes.append(SpawnOutcome(self.spawn(request)))
            except SimulationError as error:
                outcomes.append(SpawnOutcome(error=error))
        return tuple(outcomes)

    def delete(self, name: str) -> None:
        """Removes an entity from the world."""
        self.entity(name)
        self._change(Result.OPERATION_FAILED, lambda: self._world.remove(name))
        del self._entities[name]

    def delete_spawned(self) -> None:
        """Removes all spawned entities from the world."""
        for name in [e.name for e in self._entities.values() if e.spawned]:
            self.delete(name)

    def restore(self) -> None:
        """Restores the entities that the world was loaded with, in their order: equal order gives equal physics."""
        initial: tuple[RobotSpec | BodySpec, ...] = (*self._initial.robots, *self._initial.bodies)
        try:
            if self._world.names != tuple(spec.name for spec in initial):
                self._world.repopulate(self._initial.robots, self._initial.bodies)
        finally:
            self._entities = {}
            self._list_entities()

    def _list_entities(self) -> None:
        """Adds all robots and bodies of the world to ``_entities``."""
        scene = self._world.scene
        for robot in scene.robots:
            self._entities[robot.name] = Entity(robot.name, initial_info(robot), robot.namespace)
        for body in scene.bodies:
            self._entities[body.name] = Entity(body.name, initial_info(body))

    def _robot_namespace(self, name: str, namespace: str) -> str:
        """Returns the namespace of a new robot: its name if none is requested and another robot has no namespace."""
        used = {robot.namespace: robot.name for robot in self._world.scene.robots}
        if not namespace and namespace in used:
            namespace = name
        if namespace in used:
            raise SimulationError(
                SpawnCode.NAMESPACE_INVALID,
                f"namespace {quoted(namespace)} is that of robot {quoted(used[namespace])}; two robots cannot share their topics",
            )
        return namespace

    def _frame(self, frame_id: str, code: IntEnum) -> EntityState:
        """Returns pose and velocity of a frame: the world, or the root link of an entity."""
        if frame_id in WORLD_FRAMES:
            return EntityState(Pose())
        if frame_id in self._entities:
            return self.state(frame_id)
        raise SimulationError(
            code, f"frame {quoted(frame_id)} is not known; use '', 'world', 'map' or the name of an entity; {self._listed()}"
        )

    @staticmethod
    def _placed(frame: EntityState, T_frame_entity: Mat4, code: IntEnum) -> Pose:
        """Returns T_world_entity, checked like a pose from a client."""
        pose = pose_from_matrix(matrix_from_pose(frame.pose) @ T_frame_entity)
        return checked_pose(pose.position, pose.quat_xyzw, code)

    @staticmethod
    def _change(code: IntEnum, change: Callable[[], None]) -> None:
        """Changes the world; its errors become a SimulationError with ``code``."""
        try:
            change()
        except StartError as error:
            raise SimulationError(SpawnCode.INVALID_POSE, str(error)) from error
        except GibsonSimError as error:
            raise SimulationError(code, str(error)) from error

    def _listed(self) -> str:
        names = list(self._entities)
        more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
        return f"there are: {', '.join(names[:_MOST_LISTED]) or 'none'}{more}"
