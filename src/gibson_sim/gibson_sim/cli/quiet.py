"""Commands that print warnings themselves."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps the log of warnings away, as a decorator or for a block; afterwards it is as it was."""
    logger = logging.getLogger("gibson_sim")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
