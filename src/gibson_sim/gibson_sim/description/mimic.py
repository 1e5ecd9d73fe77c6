"""Joints that follow others (``<mimic>`` in a URDF). Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from gibson_sim.errors import RobotError
from gibson_sim.quoting import quoted


@dataclass(frozen=True, slots=True)
class Mimic:
    """The position of a joint is ``multiplier`` times that of its leader, plus ``offset``."""

    leader: str
    """A joint that follows none itself."""
    multiplier: float = 1.0
    offset: float = 0.0
    """Radians or metres."""

    def position(self, leader: float) -> float:
        """Returns the position of the follower for that of its leader."""
        return self.multiplier * leader + self.offset


def leaders(mimics: Mapping[str, Mimic], moving: Collection[str], where: str) -> dict[str, Mimic]:
    """Returns each mimic joint with the joint at the end of its chain of leaders.

    Args:
        mimics: Mimic joint -> the leader that the file gives, which may itself be a mimic joint.
        moving: All joints that move.
        where: The file, for messages.

    Raises:
        RobotError: a leader is missing or does not move, or joints follow each other in a circle.
    """
    out = {}
    for name, mimic in mimics.items():
        passed = [name]
        while True:
            if mimic.leader not in moving:
                raise RobotError(
                    f"{where}: joint {quoted(passed[-1])} mimics {quoted(mimic.leader)}, which is no joint that moves; "
                    f"these do: {', '.join(moving) or 'none'}"
                )
            if mimic.leader in passed:
                raise RobotError(f"{where}: joints {', '.join(map(repr, passed))} mimic each other in a circle; one must lead")
            above = mimics.get(mimic.leader)
            if above is None:
                break
            passed.append(mimic.leader)
            mimic = Mimic(above.leader, mimic.multiplier * above.multiplier, mimic.position(above.offset))
        out[name] = mimic
    return out
