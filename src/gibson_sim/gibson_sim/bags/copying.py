"""What a new bag needs to take over topics of another one as they are: definitions of their types, and quality of service."""

from __future__ import annotations

from collections.abc import Iterable

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat

from gibson_sim.bags.definitions import canonical_type
from gibson_sim.bags.metadata import FOREVER_NS, TopicQos
from gibson_sim.types import NS_PER_S

_SEPARATOR = "=" * 80
_HISTORIES = ("keep_last", "keep_all")
_RELIABILITIES = ("reliable", "best_effort")
_DURABILITIES = ("transient_local", "volatile")


def definitions_of(connections: Iterable[Connection]) -> dict[str, str]:
    """Returns the text of each message type that a bag embeds, nested types too, by type name.

    The bytes of a copied message are of these definitions, whatever is installed here.
    """
    found: dict[str, str] = {}
    for connection in connections:
        if connection.msgdef.format != MessageDefinitionFormat.MSG:
            continue
        first, *nested = connection.msgdef.data.split(_SEPARATOR)
        found[canonical_type(connection.msgtype)] = first.strip() + "\n"
        for part in nested:
            head, _, text = part.strip().partition("\n")
            found[canonical_type(head.removeprefix("MSG:").strip())] = text.strip() + "\n"
    return found


def offered_qos(connection: Connection) -> TopicQos:
    """Returns the quality of service that a topic was recorded with; what the bag does not tell is the default."""
    profiles = connection.ext.offered_qos_profiles if isinstance(connection.ext, ConnectionExtRosbag2) else []
    if not profiles:
        return TopicQos()
    profile, default = profiles[0], TopicQos()

    def word(value: str, known: tuple[str, ...], otherwise: str) -> str:
        return value.lower() if value.lower() in known else otherwise

    def nanoseconds(sec: int, nsec: int) -> int:
        return sec * NS_PER_S + nsec or FOREVER_NS

    return TopicQos(
        history=word(profile.history.name, _HISTORIES, default.history),
        depth=profile.depth or default.depth,
        reliability=word(profile.reliability.name, _RELIABILITIES, default.reliability),
        durability=word(profile.durability.name, _DURABILITIES, default.durability),
        deadline_ns=nanoseconds(profile.deadline.sec, profile.deadline.nsec),
        lifespan_ns=nanoseconds(profile.lifespan.sec, profile.lifespan.nsec),
    )
