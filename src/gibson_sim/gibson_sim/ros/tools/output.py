"""Output of the command-line tools, line by line: a reader of a pipe gets each at once."""

from __future__ import annotations

import sys


def print_line(text: str = "") -> None:
    """Prints a line of the result on stdout."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def print_error(text: str) -> None:
    """Prints a line about the progress on stderr."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
