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

MAX_NAME_LENGTH = 255
"""Maximum length of a name, characters."""
MAX_NAMESPACE_LENGTH = 245
"""Maximum length of a namespace, characters: the limit of rmw."""
MAX_TAGS, MAX_TAG_LENGTH, MAX_DESCRIPTION_LENGTH = 100, 255, 10_000
"""Maximum number of tags of an entity, and maximum lengths of a tag and of a description, characters."""
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
    """Namespace of its ROS interfaces; empty = none was requested."""
    spawned: bool = False
    """Whether a service spawned it, so that a reset of spawned entities removes it."""


def initial_info(spec: RobotSpec | BodySpec) -> EntityInfo:
    """Returns the info of an entity until a client sets it."""
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
    if len(info.tags) > MAX_TAGS or any(len(tag) > MAX_TAG_LENGTH for tag in info.tags):
        raise SimulationError(
            Result.OPERATION_FAILED,
            f"the tags are too many or too long; an entity may have {MAX_TAGS} tags of {MAX_TAG_LENGTH} characters",
        )
    if len(info.description) > MAX_DESCRIPTION_LENGTH:
        raise SimulationError(
            Result.OPERATION_FAILED,
            f"the description has {len(info.description)} characters, must have at most {MAX_DESCRIPTION_LENGTH}",
        )
    return info


def is_name(name: str) -> bool:
    """Returns whether a name is valid for an entity: names of frames, topics and links contain it."""
    return len(name) <= MAX_NAME_LENGTH and _NAME.fullmatch(name) is not None


def check_namespace(namespace: str) -> str:
    """Returns the namespace if it is valid or empty, or raises SimulationError(NAMESPACE_INVALID)."""
    valid = len(namespace) <= MAX_NAMESPACE_LENGTH and "__" not in namespace and _NAMESPACE.fullmatch(namespace)
    if namespace not in ("", "/") and not valid:
        raise SimulationError(
            SpawnCode.NAMESPACE_INVALID,
            f"namespace {quoted(namespace)} is not usable in ROS; use words of letters, digits and single _, no digit first, "
            f"with / between them, {MAX_NAMESPACE_LENGTH} characters at most",
        )
    return namespace


def choose_name(requested: str, in_file: str, allow_renaming: bool, used: Container[str]) -> str:
    """Returns the name of a new entity.

    Args:
        requested: the name in the client's request; empty = the name in the file.
        in_file: the name in the file; empty = it has none.
        allow_renaming: generate a unique name if none is given, it is in use, or the name in the file is invalid.
        used: names of all entities.

    Raises:
        SimulationError: SpawnCode.NAME_INVALID or NAME_NOT_UNIQUE.
    """
    rule = f"use letters, digits and _, a letter first, {MAX_NAME_LENGTH} characters at most"
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
                SpawnCode.NAME_NOT_UNIQUE, f"an entity {quoted(name)} exists already; give another name, or set allow_renaming"
            )
        return name
    base = usable_name(name)
    if base not in used:
        return base
    number = 2
    while (candidate := f"{base[: MAX_NAME_LENGTH - 12]}_{number}") in used:
        number += 1
    return candidate


def usable_name(text: str) -> str:
    """Returns a valid name derived from ``text``: characters that ROS does not allow become ``_``; ``entity`` if no other is left."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text[:MAX_NAME_LENGTH])
    if not name.strip("_"):
        return "entity"
    return name if is_name(name) else f"entity_{name.lstrip('_')}"[:MAX_NAME_LENGTH]
