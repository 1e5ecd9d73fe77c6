"""Converts the messages of ``simulation_interfaces``, 1.x and 2.x, which differ in their fields."""

from __future__ import annotations

from typing import Any

from simulation_interfaces.msg import (
    Bounds as RosBounds,
    EntityCategory,
    EntityInfo as RosEntityInfo,
    EntityState as RosEntityState,
    NamedPose as RosNamedPose,
    Resource,
    Spawnable as RosSpawnable,
    WorldResource,
)

from gibson_sim.maps.named_poses import NamedPose
from gibson_sim.ros.conversions.basics import header_to_msg, pose_to_msg, vector_from_msg, vector_to_msg
from gibson_sim.scenes.spawning import Spawnable
from gibson_sim.standard.bounds import MAX_POINTS, Bounds, box_bounds
from gibson_sim.standard.entities import EntityInfo
from gibson_sim.standard.filters import EntityFilters, TagsFilter
from gibson_sim.standard.population import EntityState, SpawnRequest, StateChange
from gibson_sim.standard.requests import LoadRequest, WorldInfo
from gibson_sim.types import WORLD_FRAME, Quat


def spawn_request_from_msg(msg: Any) -> SpawnRequest:
    """Returns the request in a SpawnEntity (1.x and 2.x) or an item of SpawnEntities."""
    uri, text = _resource(msg, "entity_resource")
    pose = msg.initial_pose.pose
    return SpawnRequest(
        name=msg.name,
        allow_renaming=msg.allow_renaming,
        uri=uri,
        text=text,
        namespace=msg.entity_namespace,
        frame_id=msg.initial_pose.header.frame_id,
        position=vector_from_msg(pose.position),
        quat_xyzw=_quat(pose.orientation),
    )


def load_request_from_msg(msg: Any) -> LoadRequest:
    """Returns the request in a LoadWorld (1.x and 2.x)."""
    uri, text = _resource(msg, "world_resource")
    return LoadRequest(uri, text, msg.fail_on_unsupported_element, msg.ignore_missing_or_unsupported_assets)


def state_change_from_msg(msg: Any) -> StateChange:
    """Returns the request in a SetEntityState; in 1.x it always sets pose, twist and acceleration."""
    state = msg.state
    return StateChange(
        frame_id=state.header.frame_id,
        position=vector_from_msg(state.pose.position),
        quat_xyzw=_quat(state.pose.orientation),
        linear=vector_from_msg(state.twist.linear),
        angular=vector_from_msg(state.twist.angular),
        acceleration=(*vector_from_msg(state.acceleration.linear), *vector_from_msg(state.acceleration.angular)),
        set_pose=getattr(msg, "set_pose", True),
        set_twist=getattr(msg, "set_twist", True),
        set_acceleration=getattr(msg, "set_acceleration", True),
    )


def tags_filter_from_msg(msg: Any) -> TagsFilter:
    """Returns the tags filter in a message."""
    return TagsFilter(tuple(msg.tags), msg.filter_mode)


def filters_from_msg(msg: Any) -> EntityFilters:
    """Returns the filters of GetEntities and GetEntitiesStates."""
    return EntityFilters(
        pattern=msg.filter,
        categories=tuple(item.category for item in msg.categories),
        tags=tags_filter_from_msg(msg.tags),
        bounds=bounds_from_msg(msg.bounds),
    )


def bounds_from_msg(msg: Any) -> Bounds:
    """Returns the volume in a message; excess points are dropped, except one, by which the volume is refused."""
    return Bounds(msg.type, tuple(vector_from_msg(point) for point in msg.points[: MAX_POINTS + 1]))


def bounds_to_msg(bounds: Bounds) -> RosBounds:
    """Returns the volume as a message."""
    return RosBounds(type=int(bounds.kind), points=[vector_to_msg(point) for point in bounds.points])


def entity_info_from_msg(msg: Any) -> EntityInfo:
    """Returns the category, description and tags in a message."""
    return EntityInfo(msg.category.category, msg.description, tuple(msg.tags))


def entity_info_to_msg(info: EntityInfo) -> RosEntityInfo:
    """Returns the category, description and tags of an entity as a message."""
    return RosEntityInfo(category=EntityCategory(category=int(info.category)), description=info.description, tags=list(info.tags))


def entity_state_to_msg(state: EntityState, stamp_ns: int) -> RosEntityState:
    """Returns the pose and velocity of an entity in the world frame as a message; the acceleration is 0."""
    msg = RosEntityState(header=header_to_msg(stamp_ns, WORLD_FRAME), pose=pose_to_msg(state.pose))
    msg.twist.linear, msg.twist.angular = vector_to_msg(state.linear), vector_to_msg(state.angular)
    return msg


def named_pose_to_msg(pose: NamedPose) -> RosNamedPose:
    """Returns a named pose as a message."""
    return RosNamedPose(name=pose.name, description=pose.description, tags=list(pose.tags), pose=pose_to_msg(pose.pose))


def spawnable_to_msg(spawnable: Spawnable) -> RosSpawnable:
    """Returns a spawnable as a message (1.x and 2.x)."""
    msg = RosSpawnable(description=spawnable.description)
    if hasattr(msg, "uri"):
        msg.uri = spawnable.uri
    else:
        msg.entity_resource = Resource(uri=spawnable.uri)
    if spawnable.bounds is not None:
        msg.spawn_bounds = bounds_to_msg(box_bounds(*spawnable.bounds))
    return msg


def world_to_msg(world: WorldInfo) -> WorldResource:
    """Returns a world as a message."""
    resource = Resource(uri=world.uri, resource_string=world.text)
    return WorldResource(name=world.name, world_resource=resource, description=world.description, tags=list(world.tags))


def _resource(msg: Any, field: str) -> tuple[str, str]:
    """Returns uri and text, which are fields of the message itself in 1.x, and of its ``Resource`` in 2.x."""
    resource = getattr(msg, field, msg)
    return resource.uri, resource.resource_string


def _quat(msg: Any) -> Quat:
    return (msg.x, msg.y, msg.z, msg.w)
