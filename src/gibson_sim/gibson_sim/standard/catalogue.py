"""Lists the spawnables and worlds of the default sources and of the sources in a client's request."""

from __future__ import annotations

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.scenes.sources import Search
from gibson_sim.scenes.spawnables import Spawnable, find_spawnables, spawnables_below
from gibson_sim.scenes.worlds import WorldEntry, built_in_worlds, find_world, worlds_below
from gibson_sim.standard.codes import Result, SimulationError, WorldsCode, shortened
from gibson_sim.standard.filters import TagsFilter

_MAX_SOURCES = 1000
"""Maximum number of sources in a request."""


def available_worlds(sources: tuple[str, ...], tags: TagsFilter, *, continue_on_error: bool) -> tuple[WorldEntry, ...]:
    """Returns the worlds that can be loaded.

    Args:
        sources: folders in addition to the default sources.
        tags: filter on the tags of worlds.
        continue_on_error: skip unreadable sources, unless no source has a world.

    Raises:
        SimulationError: a source cannot be read, there are too many, or the filter is invalid.
    """
    tags.check()
    _check_number(sources)
    worlds_by_uri: dict[str, WorldEntry] = {}
    failures: list[SimulationError] = []
    search = Search()
    for source, code in ((None, WorldsCode.DEFAULT_SOURCES_FAILED), *((source, Result.NOT_FOUND) for source in sources)):
        try:
            worlds = (
                built_in_worlds()
                if source is None
                else worlds_below((source,), continue_on_error=continue_on_error, search=search)
            )
            worlds_by_uri.update({world.uri: world for world in worlds})
        except GibsonSimError as error:
            failures.append(SimulationError(code, str(error)))
    if failures and not (continue_on_error and worlds_by_uri):
        raise failures[0]
    return tuple(world for world in worlds_by_uri.values() if tags.passes(world.tags))


def spawnables(sources: tuple[str, ...]) -> tuple[tuple[Spawnable, ...], str]:
    """Returns the spawnables, and one line that names the unusable sources: these do not make the request fail.

    Raises:
        SimulationError: there are too many sources.
    """
    _check_number(sources)
    spawnables_by_uri = {spawnable.uri: spawnable for spawnable in find_spawnables(())}
    failures = []
    search = Search()
    for source in sources:
        try:
            spawnables_by_uri.update({spawnable.uri: spawnable for spawnable in spawnables_below((source,), search)})
        except GibsonSimError as error:
            failures.append(f"source {quoted(source)}: {error}")
    return tuple(spawnables_by_uri.values()), shortened("; ".join(failures))


def _check_number(sources: tuple[str, ...]) -> None:
    if len(sources) > _MAX_SOURCES:
        raise SimulationError(
            Result.OPERATION_FAILED,
            f"{len(sources)} sources are given, at most {_MAX_SOURCES} are searched; give folders above them",
        )


def description_of(uri: str) -> WorldEntry | None:
    """Returns the description of the world with a URI, without loading it; None if no world or more than one has this URI."""
    try:
        return find_world(uri)
    except GibsonSimError:
        return None
