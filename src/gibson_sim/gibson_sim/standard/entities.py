"""Names, namespaces, categories and tags of entities, by the rules of the standard and of ROS."""

from __future__ import annotations

import re
from collections.abc import Container
from dataclasses import dataclass, field
from enum import IntEnum

from gibson_sim.description.body import BodySpec
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.standard.codes import Result, SimulationError, SpawnCode

LONGEST_NAME = 255
LONGEST_NAMESPACE = 245
"""Limit of rmw."""
MOST_TAGS, LONGEST_TAG, LONGEST_DESCRIPTION = 100, 255, 10_000
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NAMESPACE = re.compile(r"/?(?!\d)\w+(/(?!\d)\w+)*", re.ASCII)
_HUMAN_CLASSES = ("human", "person", "people", "pedestrian")


class Category(IntEnum):
    """Categories of the standard; it has no number 3."""

    OBJECT = 0
    ROBOT = 1
    HUMAN = 2
    DYNAMIC_OBJECT = 4
    STATIC_OBJECT = 5


@dataclass(frozen=True, slots=True)
class EntityInfo:
    """The properties of an entity that ``set_entity_info`` sets."""

    category: int = Category.OBJECT
    description: str = ""
    tags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Entity:
    """A robot or a body of the world."""

    name: str
    info: EntityInfo = field(default_factory=EntityInfo)
    namespace: str = ""
    """Of its ROS interfaces; empty = none was requested."""
    spawned: bool = False
    """A service spawned it; a reset of spawned entities removes it."""


def initial_info(spec: RobotSpec | BodySpec) -> EntityInfo:
    """Returns the info of an entity before a client sets it."""
    if isinstance(spec, RobotSpec):
        return EntityInfo(Category.ROBOT, "robot")
    tags = (spec.semantic_class,) if spec.semantic_class else ()
    if spec.semantic_class.lower() in _HUMAN_CLASSES:
        return EntityInfo(Category.HUMAN, spec.semantic_class, tags)
    return EntityInfo(Category.STATIC_OBJECT if spec.static else Category.DYNAMIC_OBJECT, spec.semantic_class, tags)


def check_info(info: EntityInfo) -> EntityInfo:
    """Returns the info if it is valid, or raises SimulationError."""
    if info.category not in list(Category):
        known = ", ".join(f"{c.value} {c.name}" for c in Category)
        raise SimulationError(Result.OPERATION_FAILED, f"category is {info.category}, must be one of {known}")
    if len(info.tags) > MOST_TAGS or any(len(tag) > LONGEST_TAG for tag in info.tags):
        raise SimulationError(
            Result.OPERATION_FAILED, f"an entity may have {MOST_TAGS} tags of {LONGEST_TAG} characters; these are more or longer"
        )
    if len(info.description) > LONGEST_DESCRIPTION:
        raise SimulationError(
            Result.OPERATION_FAILED,
            f"the description has {len(info.description)} characters, must have at most {LONGEST_DESCRIPTION}",
        )
    return info


def is_name(name: str) -> bool:
    """Returns whether a name is valid for an entity: it becomes part of frames, topics and links."""
    return len(name) <= LONGEST_NAME and _NAME.fullmatch(name) is not None


def check_namespace(namespace: str) -> str:
    """Returns the namespace, or raises SimulationError(NAMESPACE_INVALID); empty = none."""
    valid = len(namespace) <= LONGEST_NAMESPACE and "__" not in namespace and _NAMESPACE.fullmatch(namespace)
    if namespace not in ("", "/") and not valid:
        raise SimulationError(
            SpawnCode.NAMESPACE_INVALID,
            f"namespace {quoted(namespace)} is not usable in ROS; use words of letters, digits and single _, no digit first, "
            f"with / between them, {LONGEST_NAMESPACE} characters at most",
        )
    return namespace


def choose_name(requested: str, in_file: str, allow_renaming: bool, used: Container[str]) -> str:
    """Returns the name of a new entity.

    Args:
        requested: the name in the client's request; empty = the name in the file.
        in_file: the name in the file; empty = it has none.
        allow_renaming: make up a name if there is none, or it is in use, or the file's is invalid.
        used: names of all entities.

    Raises:
        SimulationError: SpawnCode.NAME_INVALID or NAME_NOT_UNIQUE.
    """
    rule = f"use letters, digits and _, a letter first, {LONGEST_NAME} characters at most"
    if requested and not is_name(requested):
        raise SimulationError(SpawnCode.NAME_INVALID, f"name {quoted(requested)} is not usable in ROS; {rule}")
    name = requested or in_file
    if not allow_renaming:
        if not name:
            raise SimulationError(
                SpawnCode.NAME_INVALID, "name is empty and the file has none; give a name, or set allow_renaming"
            )
        if not is_name(name):
            raise SimulationError(
                SpawnCode.NAME_INVALID, "the name in the file is not usable in ROS; give a name, or set allow_renaming"
            )
        if name in used:
            raise SimulationError(
                SpawnCode.NAME_NOT_UNIQUE, f"there is an entity {quoted(name)} already; give another name, or set allow_renaming"
            )
        return name
    base = usable_name(name)
    if base not in used:
        return base
    number = 2
    while (candidate := f"{base[: LONGEST_NAME - 12]}_{number}") in used:
        number += 1
    return candidate


def usable_name(text: str) -> str:
    """Returns a valid name made of ``text``: characters that ROS does not allow become ``_``; ``entity`` if nothing is left."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text[:LONGEST_NAME])
    if not name.strip("_"):
        return "entity"
    return name if is_name(name) else f"entity_{name.lstrip('_')}"[:LONGEST_NAME]
