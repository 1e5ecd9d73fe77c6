"""Fixtures that need an EGL device; software is enough."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator

import pytest

from gibson_sim.errors import GibsonSimError, GraphicsUnavailableError
from gibson_sim.render.context import GlContext, list_devices, open_context
from gibson_sim.render.readback.cuda import CudaPython


@pytest.fixture(scope="session")
def egl() -> None:
    """Skips, with a warning, if no device can draw; fails instead if ``GIBSON_REQUIRE`` names egl."""
    try:
        open_context().close()
    except GraphicsUnavailableError as e:
        if "egl" in os.environ.get("GIBSON_REQUIRE", ""):
            pytest.fail(f"GIBSON_REQUIRE names egl: {e}")
        message = f"SKIPPED: {e}"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)


@pytest.fixture
def nvidia() -> Iterator[tuple[GlContext, CudaPython]]:
    """OpenGL and CUDA on one GPU; skips, with a warning, if there is none; fails instead if ``GIBSON_REQUIRE`` names gpu."""
    context: GlContext | None = None
    try:
        gpus = [d.index for d in list_devices() if d.usable and "nvidia" in d.vendor.lower()]
        if not gpus:
            raise GraphicsUnavailableError("EGL shows no NVIDIA GPU")
        context = open_context(gpus[0])
        driver = CudaPython()
    except GibsonSimError as e:
        if context is not None:
            context.close()
        if "gpu" in os.environ.get("GIBSON_REQUIRE", ""):
            pytest.fail(f"GIBSON_REQUIRE names gpu: {e}")
        message = f"SKIPPED: {e}"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    yield context, driver
    context.close()
