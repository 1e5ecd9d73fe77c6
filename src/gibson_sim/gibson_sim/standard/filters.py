"""Filters of a client's request on entities, poses and worlds; an item must pass all filters that are set."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from gibson_sim.standard.bounds import Bounds, BoundsType, OverlapTest
from gibson_sim.standard.codes import Result, SimulationError
from gibson_sim.standard.entities import Entity
from gibson_sim.standard.posix_regex import PatternError, PosixRegex

FILTER_MODE_ANY, FILTER_MODE_ALL = 0, 1


@dataclass(frozen=True, slots=True)
class TagsFilter:
    """Passes items with any or all of the tags; without tags, every item passes."""

    tags: tuple[str, ...] = ()
    mode: int = FILTER_MODE_ANY

    def check(self) -> None:
        """Raises SimulationError if the mode is unknown."""
        if self.mode not in (FILTER_MODE_ANY, FILTER_MODE_ALL):
            raise SimulationError(
                Result.OPERATION_FAILED, f"filter_mode of the tags is {self.mode}, must be 0 (any of them) or 1 (all of them)"
            )

    def passes(self, tags: Iterable[str]) -> bool:
        """Returns whether an item with these tags passes."""
        item_tags = set(tags)
        if not self.tags:
            return True
        return item_tags.issuperset(self.tags) if self.mode == FILTER_MODE_ALL else not item_tags.isdisjoint(self.tags)


@dataclass(frozen=True, slots=True)
class EntityFilters:
    """Filters on entities."""

    pattern: str = ""
    """POSIX extended regular expression that must match a part of the name; empty = any name."""
    categories: tuple[int, ...] = ()
    """Numbers of the allowed categories; empty = any."""
    tags: TagsFilter = field(default_factory=TagsFilter)
    bounds: Bounds = field(default_factory=lambda: Bounds(BoundsType.EMPTY))
    """Volume that the entity's bounding box must overlap, world frame, m."""


def filtered(
    entities: Iterable[Entity], filters: EntityFilters, box_of: Callable[[str], tuple[ArrayLike, ArrayLike]]
) -> tuple[Entity, ...]:
    """Returns the entities that pass all filters.

    Args:
        entities: all entities.
        filters: filters of the request.
        box_of: returns the lower and upper corner, each (3,), m, of an entity's bounding box, world frame; called only for entities that
            pass all other filters.

    Raises:
        SimulationError: a filter is invalid.
    """
    try:
        pattern = PosixRegex(filters.pattern)
    except PatternError as error:
        raise SimulationError(Result.OPERATION_FAILED, f"filter: {error}") from error
    filters.tags.check()
    volume = OverlapTest(filters.bounds)
    return tuple(
        entity
        for entity in entities
        if (not filters.categories or entity.info.category in filters.categories)
        and filters.tags.passes(entity.info.tags)
        and pattern.search(entity.name)
        and (volume.always_true or volume.overlaps_box(*box_of(entity.name)))
    )
