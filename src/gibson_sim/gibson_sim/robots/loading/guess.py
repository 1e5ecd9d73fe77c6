"""``Guess``: a guessed value of a ``robot.yaml``, and its source. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Guess:
    """A guessed value."""

    key: str
    """Key of the ``robot.yaml`` for the value."""
    text: str
    """Value, and its source."""
    part: str = ""
    """Key within that section, if the line is about one of its values; empty = the whole section."""
    by_hand: str = ""
    """Value that the user must set, since a description does not contain it; empty = none."""

    def __str__(self) -> str:
        """Returns the line for the user."""
        return f"{self.part or self.key}: {self.text}"
