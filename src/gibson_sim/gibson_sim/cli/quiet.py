"""Suppresses logged warnings in commands that print them themselves."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Suppresses logged warnings, as a decorator or for a block; restores the level afterwards."""
    logger = logging.getLogger("gibson_sim")
    previous_level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(previous_level)
