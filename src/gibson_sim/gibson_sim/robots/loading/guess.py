"""``Guess``: one value of a ``robot.yaml`` that was guessed, and why. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Guess:
    """One guessed value."""

    key: str
    """Key of the ``robot.yaml`` that it belongs to."""
    text: str
    """The value, and from what it was guessed."""
    part: str = ""
    """Key inside of that section, if the line is about one value of it; empty = the whole section."""
    by_hand: str = ""
    """What to set in the file, since a description does not say it; empty = nothing."""

    def __str__(self) -> str:
        """Returns the line for the user."""
        return f"{self.part or self.key}: {self.text}"
