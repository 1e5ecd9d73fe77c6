"""Filters of a client's request on entities, poses and worlds; all filters that are set must pass."""

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
    """Passes things with any of the tags, or with all; no tags = everything passes."""

    tags: tuple[str, ...] = ()
    mode: int = FILTER_MODE_ANY

    def check(self) -> None:
        """Raises SimulationError if the mode is unknown."""
        if self.mode not in (FILTER_MODE_ANY, FILTER_MODE_ALL):
            raise SimulationError(
                Result.OPERATION_FAILED, f"filter_mode of the tags is {self.mode}, must be 0 (any of them) or 1 (all of them)"
            )

    def passes(self, tags: Iterable[str]) -> bool:
        """Returns whether a thing with these tags passes."""
        has = set(tags)
        if not self.tags:
            return True
        return has.issuperset(self.tags) if self.mode == FILTER_MODE_ALL else not has.isdisjoint(self.tags)


@dataclass(frozen=True, slots=True)
class EntityFilters:
    """Filters on entities."""

    pattern: str = ""
    """POSIX extended regular expression, searched in the name; empty = any name."""
    categories: tuple[int, ...] = ()
    """Any of these; empty = any."""
    tags: TagsFilter = field(default_factory=TagsFilter)
    bounds: Bounds = field(default_factory=lambda: Bounds(BoundsType.EMPTY))
    """World frame, metres."""


def filtered(
    entities: Iterable[Entity], filters: EntityFilters, box_of: Callable[[str], tuple[ArrayLike, ArrayLike]]
) -> tuple[Entity, ...]:
    """Returns the entities that pass.

    Args:
        entities: all entities.
        filters: of the request.
        box_of: returns the lowest and the highest corner of an entity, world frame; is called only for entities that pass all other filters.

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
