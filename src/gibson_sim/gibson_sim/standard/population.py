"""The entities of a loaded world: spawns, deletes, reads and moves them; checks poses and velocities from clients, which are untrusted."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import GibsonSimError, StartError
from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose, matrix_from_quat, pose_from_matrix
from gibson_sim.maps.placement import in_namespace
from gibson_sim.physics.body import prepare_meshes
from gibson_sim.physics.start_checks import has_nothing_below, warn_of_misplaced_robots
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes import spawning
from gibson_sim.standard.bounds import Bounds, box_bounds
from gibson_sim.standard.codes import EntityStateCode, Result, SimulationError, SpawnCode, client_message
from gibson_sim.standard.entities import Entity, EntityInfo, check_info, check_namespace, choose_name, initial_info
from gibson_sim.standard.filters import EntityFilters, filtered
from gibson_sim.standard.requests import resource_name
from gibson_sim.types import FARTHEST_M, Pose, Quat, Vec3

MAX_ENTITIES = 2000
"""Maximum number of entities in a world: with more, physics is slow even if all bodies are at rest, and messages that list them are large."""
_LOG = logging.getLogger(__name__)
_MAX_LISTED = 8
"""Maximum number of entities that an error message lists."""
_MAX_SPEED = 1e3
"""Maximum magnitude of each component of a velocity, m/s and rad/s."""
_NORM_TOLERANCE = 0.01
"""Maximum deviation of a quaternion's norm from 1: clients round to two digits."""
_WORLD_FRAMES = ("", "world", "map")
"""Names of the world frame in requests."""


@dataclass(frozen=True, slots=True)
class SpawnRequest:
    """A client's request to spawn an entity, unchecked."""

    name: str = ""
    allow_renaming: bool = False
    uri: str = ""
    text: str = ""
    """Contents of the file; used where ``uri`` is empty."""
    namespace: str = ""
    frame_id: str = ""
    position: Vec3 = (0.0, 0.0, 0.0)
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class PreloadedResource:
    """The resource of a spawn request, read before the request takes effect."""

    in_file: str
    """Name in the resource."""
    name: str
    """Name of the entity, chosen when the resource was read."""
    pose: Pose
    """T_world_root, computed when the resource was read."""
    result: RobotSpec | BodySpec | SimulationError
    """Specification in the resource, or the error in reading it."""


@dataclass(frozen=True, slots=True)
class SpawnOutcome:
    """Result of one of several spawn requests: the entity's name, or an error."""

    name: str = ""
    error: SimulationError | None = None


@dataclass(frozen=True, slots=True)
class EntityState:
    """Pose and velocity of an entity, world frame."""

    pose: Pose
    """T_world_root."""
    linear: Vec3 = (0.0, 0.0, 0.0)
    """Velocity of the root's origin, m/s."""
    angular: Vec3 = (0.0, 0.0, 0.0)
    """Angular velocity, rad/s."""


@dataclass(frozen=True, slots=True)
class StateChange:
    """A client's request to set an entity's state in the frame ``frame_id``, unchecked; m, m/s, rad/s."""

    frame_id: str = ""
    position: Vec3 = (0.0, 0.0, 0.0)
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)
    linear: Vec3 = (0.0, 0.0, 0.0)
    angular: Vec3 = (0.0, 0.0, 0.0)
    acceleration: tuple[float, ...] = (0.0,) * 6
    """Linear and angular acceleration; ignored, but must be 0 for static entities."""
    set_pose: bool = True
    set_twist: bool = True
    set_acceleration: bool = True


def _name_in_file(request: SpawnRequest) -> str:
    return "" if request.name else spawning.spawn_name(request.uri, request.text)


def _load(request: SpawnRequest, name: str, pose: Pose) -> RobotSpec | BodySpec:
    try:
        return spawning.load_spawnable(request.uri, request.text, name=name, pose=pose)
    except spawning.SpawnError as error:
        raise SimulationError(SpawnCode[error.code.name], client_message(resource_name(request.uri), error)) from error


def _preload(request: SpawnRequest, pose: Pose, used: Mapping[str, object]) -> PreloadedResource | None:
    """Reads the resource of a request; returns None if no name can be chosen."""
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
        return PreloadedResource(in_file, name, pose, error)
    if isinstance(spec, BodySpec):
        prepare_meshes(spec)
    return PreloadedResource(in_file, name, pose, spec)


class Population:
    """All robots and bodies of a world. Every method may raise SimulationError with a code of its service."""

    def __init__(self, world: PhysicsWorld, *, robot_tf: str = "namespaced", max_entities: int = MAX_ENTITIES) -> None:
        """Registers the entities that are in ``world``.

        Args:
            world: world of the entities; its owner closes it.
            robot_tf: setting for the transforms of robots with a namespace, see ``gibson_sim.config.PhysicsConfig``.
            max_entities: maximum number of entities.
        """
        self._world, self._robot_tf, self._max_entities = world, robot_tf, max_entities
        self._initial = world.scene
        self._entities: dict[str, Entity] = {}
        self._list_entities()
        warn_of_misplaced_robots(world)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all entities."""
        return tuple(self._entities)

    def select(self, filters: EntityFilters) -> tuple[Entity, ...]:
        """Returns the entities that pass all filters."""
        return filtered(self._entities.values(), filters, self._world.bounds)

    def entity(self, name: str) -> Entity:
        """Returns the entity with a name."""
        entity = self._entities.get(name)
        if entity is None:
            raise SimulationError(Result.NOT_FOUND, f"there is no entity {quoted(name)}; {self._listed()}")
        return entity

    def set_info(self, name: str, info: EntityInfo) -> None:
        """Replaces the category, description and tags of an entity."""
        entity = self.entity(name)
        self._entities[name] = replace(entity, info=check_info(info))

    def state(self, name: str) -> EntityState:
        """Returns the pose and velocity of an entity, world frame."""
        self.entity(name)
        linear, angular = self._world.body_twist(name)
        return EntityState(self._world.body_pose(name), _vec3(linear), _vec3(angular))

    def set_state(self, name: str, change: StateChange) -> None:
        """Sets the pose or velocity of an entity immediately.

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
            T_frame_entity = matrix_from_pose(_checked_pose(change.position, change.quat_xyzw, EntityStateCode.INVALID_POSE))
            pose = self._placed(frame, T_frame_entity, EntityStateCode.INVALID_POSE)
        linear, angular = None, None
        if change.set_twist:
            relative_linear = np.array(_checked_velocity("linear", change.linear, "m/s"))
            relative_angular = np.array(_checked_velocity("angular", change.angular, "rad/s"))
            rotation = matrix_from_quat(frame.pose.quat_xyzw)
            arm = np.array(pose.position) - np.array(frame.pose.position)
            linear = _vec3(rotation @ relative_linear + np.array(frame.linear) + np.cross(frame.angular, arm))
            angular = _vec3(rotation @ relative_angular + np.array(frame.angular))
        self._change(
            Result.OPERATION_FAILED, lambda: self._world.set_state(name, pose if change.set_pose else None, linear, angular)
        )

    def bounds(self, name: str) -> Bounds:
        """Returns the bounding box of an entity's collision shapes, in the frame of its root link, m."""
        self.entity(name)
        T_root_world = invert(matrix_from_pose(self._world.body_pose(name)))
        low, high = self._world.bounds(name, T_frame_world=T_root_world)
        return box_bounds(_vec3(low), _vec3(high))

    def file_reader(self, requests: Sequence[SpawnRequest]) -> Callable[[], list[PreloadedResource | None]]:
        """Returns a function that reads the resources of requests for ``spawn``; any thread may call it, since it changes nothing here.

        Its result has None for a request that cannot be preloaded; ``spawn`` raises the reason.
        """
        used: dict[str, object] = dict(self._entities)
        placed: list[tuple[SpawnRequest, Pose | None]] = []
        for request in requests:
            try:
                placed.append((request, self._spawn_pose(request)))
            except SimulationError:
                placed.append((request, None))

        def read() -> list[PreloadedResource | None]:
            resources: list[PreloadedResource | None] = []
            for request, pose in placed:
                preloaded = None if pose is None else _preload(request, pose, used)
                if preloaded is not None:
                    used[preloaded.name] = preloaded
                resources.append(preloaded)
            return resources

        return read

    def spawn(self, request: SpawnRequest, preloaded: PreloadedResource | None = None) -> str:
        """Adds a robot or a body to the world and returns its name; ``preloaded`` is the result of ``file_reader`` for the request."""
        if not (request.uri.strip() or request.text.strip()):
            raise SimulationError(SpawnCode.NO_RESOURCE, "neither a uri nor a resource_string is given; see get_spawnables")
        if len(self._entities) >= self._max_entities:
            raise SimulationError(
                Result.OPERATION_FAILED, f"the world has {self._max_entities} entities, the maximum: delete some"
            )
        check_namespace(request.namespace)
        pose = self._spawn_pose(request)
        in_file = _name_in_file(request) if preloaded is None else preloaded.in_file
        name = choose_name(request.name, in_file, request.allow_renaming, self._entities)
        if preloaded is not None and isinstance(preloaded.result, SimulationError):
            raise preloaded.result
        is_current = preloaded is not None and (preloaded.name, preloaded.pose) == (name, pose)
        spec = preloaded.result if preloaded is not None and is_current else _load(request, name, pose)
        assert not isinstance(spec, SimulationError)
        namespace = request.namespace.strip("/")
        if isinstance(spec, RobotSpec):
            namespace = self._robot_namespace(name, namespace)
            spec = in_namespace(spec, namespace, self._robot_tf) if namespace else spec
        falls = has_nothing_below(self._world, pose)
        try:
            self._world.add(spec)
        except StartError as error:
            raise SimulationError(SpawnCode.INVALID_POSE, str(error)) from error
        except GibsonSimError as error:
            raise SimulationError(Result.OPERATION_FAILED, client_message(resource_name(request.uri), error)) from error
        self._entities[name] = Entity(name, initial_info(spec), namespace, spawned=True)
        if falls and not self._world.is_static(name):
            x, y, _ = pose.position
            _LOG.warning("spawned %s at %.2f,%.2f, where there is nothing below it: it falls", quoted(name), x, y)
        return name

    def _spawn_pose(self, request: SpawnRequest) -> Pose:
        return self._placed(
            self._frame(request.frame_id, SpawnCode.INVALID_POSE),
            matrix_from_pose(_checked_pose(request.position, request.quat_xyzw, SpawnCode.INVALID_POSE)),
            SpawnCode.INVALID_POSE,
        )

    def spawn_all(self, requests: Sequence[SpawnRequest]) -> tuple[SpawnOutcome, ...]:
        """Spawns entities one after the other; returns the result of each. If some fail, the others stay."""
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
        """Restores the initial entities of the world in their initial order: physics depends on the order."""
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
        """Returns the namespace of a new robot: its name, if none is requested and another robot already has none."""
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
        """Returns the pose and velocity of a frame: the world, or the root link of an entity."""
        if frame_id in _WORLD_FRAMES:
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
        return _checked_pose(pose.position, pose.quat_xyzw, code)

    @staticmethod
    def _change(code: IntEnum, change: Callable[[], None]) -> None:
        """Changes the world; converts its errors to a SimulationError with ``code``."""
        try:
            change()
        except StartError as error:
            raise SimulationError(SpawnCode.INVALID_POSE, str(error)) from error
        except GibsonSimError as error:
            raise SimulationError(code, str(error)) from error

    def _listed(self) -> str:
        names = list(self._entities)
        more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
        return f"there are: {', '.join(names[:_MAX_LISTED]) or 'none'}{more}"


def _checked_pose(position: Vec3, quat_xyzw: Quat, code: IntEnum) -> Pose:
    """Returns the pose with a normalised quaternion; four zeros, the default of some clients' messages, mean no rotation.

    Args:
        position: x, y, z, m.
        quat_xyzw: orientation.
        code: result code of an invalid pose.

    Raises:
        SimulationError: with ``code``.
    """
    if not all(map(math.isfinite, (*position, *quat_xyzw))):
        raise SimulationError(code, f"the pose holds a NaN or an infinity: position {position}, orientation {quat_xyzw}")
    if any(abs(c) > FARTHEST_M for c in position):
        raise SimulationError(
            code, f"position {position} is too far away; each coordinate must be -{FARTHEST_M:g} to {FARTHEST_M:g} m"
        )
    norm = math.hypot(*quat_xyzw)
    if norm == 0.0:
        return Pose(position)
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise SimulationError(code, f"orientation {quat_xyzw} (x, y, z, w) has length {norm:g}, must be 1: normalise it")
    x, y, z, w = (c / norm for c in quat_xyzw)
    return Pose(position, (x, y, z, w))


def _checked_velocity(kind: str, velocity: Vec3, unit: str) -> Vec3:
    """Returns the velocity if it is valid, or raises SimulationError(OPERATION_FAILED); ``kind`` and ``unit`` are for the message."""
    if not all(math.isfinite(c) and abs(c) <= _MAX_SPEED for c in velocity):
        raise SimulationError(
            Result.OPERATION_FAILED,
            f"{kind} velocity is {velocity}, each component must be -{_MAX_SPEED:g} to {_MAX_SPEED:g} {unit}",
        )
    return velocity


def _vec3(values: ArrayLike) -> Vec3:
    """Returns an array (3,) as a tuple of floats."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z)
