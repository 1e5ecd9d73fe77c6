"""Mimic joints (``<mimic>`` in a URDF). Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from gibson_sim.errors import RobotError
from gibson_sim.quoting import quoted


@dataclass(frozen=True, slots=True)
class Mimic:
    """A mimic joint: its position is ``multiplier`` times that of its leader, plus ``offset``."""

    leader: str
    """Name of the leader, which is not a mimic joint itself."""
    multiplier: float = 1.0
    offset: float = 0.0
    """Offset, radians or metres."""

    def position(self, leader: float) -> float:
        """Returns the position of the mimic joint for the position of its leader."""
        return self.multiplier * leader + self.offset


def leaders(mimics: Mapping[str, Mimic], moving: Collection[str], where: str) -> dict[str, Mimic]:
    """Resolves chains of mimic joints: returns each mimic joint with the last joint of its chain as leader.

    Args:
        mimics: Mimic joint -> its leader in the file, which may itself be a mimic joint.
        moving: All movable joints.
        where: The file, for messages.

    Raises:
        RobotError: a leader does not exist or is fixed, or the chain is a cycle.
    """
    resolved = {}
    for name, mimic in mimics.items():
        chain = [name]
        while True:
            if mimic.leader not in moving:
                raise RobotError(
                    f"{where}: joint {quoted(chain[-1])} mimics {quoted(mimic.leader)}, which is not a movable joint; "
                    f"movable joints: {', '.join(moving) or 'none'}"
                )
            if mimic.leader in chain:
                raise RobotError(
                    f"{where}: joints {', '.join(map(repr, chain))} mimic each other in a cycle; one of them must not"
                )
            next_mimic = mimics.get(mimic.leader)
            if next_mimic is None:
                break
            chain.append(mimic.leader)
            mimic = Mimic(next_mimic.leader, mimic.multiplier * next_mimic.multiplier, mimic.position(next_mimic.offset))
        resolved[name] = mimic
    return resolved
