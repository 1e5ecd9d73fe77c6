"""Lists the spawnables and worlds in the default sources and in those that a client names."""

from __future__ import annotations

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.scenes.sources import Search
from gibson_sim.scenes.spawnables import Spawnable, find_spawnables, spawnables_below
from gibson_sim.scenes.worlds import WorldEntry, own_worlds, world_of, worlds_below
from gibson_sim.standard.codes import Result, SimulationError, WorldsCode, shortened
from gibson_sim.standard.filters import TagsFilter


def available_worlds(sources: tuple[str, ...], tags: TagsFilter, *, continue_on_error: bool) -> tuple[WorldEntry, ...]:
    """Returns the worlds that can be loaded.

    Args:
        sources: folders in addition to the default sources.
        tags: filter on the worlds' tags.
        continue_on_error: skip sources that cannot be read, unless no source has a world.

    Raises:
        SimulationError: a source cannot be read, or the filter is invalid.
    """
    tags.check()
    found: dict[str, WorldEntry] = {}
    failures: list[SimulationError] = []
    search = Search()
    for source, code in ((None, WorldsCode.DEFAULT_SOURCES_FAILED), *((source, Result.NOT_FOUND) for source in sources)):
        try:
            worlds = (
                own_worlds() if source is None else worlds_below((source,), continue_on_error=continue_on_error, search=search)
            )
            found.update({world.uri: world for world in worlds})
        except GibsonSimError as error:
            failures.append(SimulationError(code, str(error)))
    if failures and not (continue_on_error and found):
        raise failures[0]
    return tuple(world for world in found.values() if tags.passes(world.tags))


def spawnables(sources: tuple[str, ...]) -> tuple[tuple[Spawnable, ...], str]:
    """Returns the spawnables, and one line that names the sources without any: these do not make the request fail."""
    found = {spawnable.uri: spawnable for spawnable in find_spawnables(())}
    failures = []
    search = Search()
    for source in sources:
        try:
            found.update({spawnable.uri: spawnable for spawnable in spawnables_below((source,), search)})
        except GibsonSimError as error:
            failures.append(f"source {quoted(source)}: {error}")
    return tuple(found.values()), shortened("; ".join(failures))


def description_of(uri: str) -> WorldEntry | None:
    """Returns the description of the world with a URI, without loading it; None if there is none, or more than one."""
    try:
        return world_of(uri)
    except GibsonSimError:
        return None
