"""Drawing needs an EGL device; software is enough."""

from __future__ import annotations

import os
import warnings

import pytest

from gibson_sim.errors import GraphicsUnavailableError
from gibson_sim.render.context import open_context


@pytest.fixture(scope="session")
def egl() -> None:
    """Skips, loudly, where nothing can draw; fails instead where ``GIBSON_REQUIRE`` names egl."""
    try:
        open_context().close()
    except GraphicsUnavailableError as e:
        if "egl" in os.environ.get("GIBSON_REQUIRE", ""):
            pytest.fail(f"GIBSON_REQUIRE names egl: {e}")
        message = f"SKIPPED: {e}"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
