"""Headless Chromium, for what needs a real browser: measurements, tests and screenshots of the live page."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from gibson_sim.errors import EnvironmentProblemError

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing")
"""Options with which WebGL is rendered without a GPU. The page itself is composed by the processor, as a browser with a window does without a
GPU; headless, Chromium would use SwiftShader for it, too, which takes a core for six images a second."""


def chromium_path() -> str:
    """Returns the path of the Chromium executable on this machine.

    Raises:
        EnvironmentProblemError: there is none.
    """
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        raise EnvironmentProblemError("no Chromium on this machine: apt-get install chromium")
    return found


@contextmanager
def chromium(*, webgl: bool = False) -> Iterator[Any]:
    """Runs Chromium inside the block; the value is a ``playwright.sync_api.Browser``.

    Args:
        webgl: whether to render WebGL, in software.

    Raises:
        EnvironmentProblemError: there is no Chromium, or no playwright.
    """
    path = chromium_path()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise EnvironmentProblemError("playwright is needed: pip install 'gibson_sim_bench[web]'") from error
    # As root Chromium has no sandbox; it opens our own page alone.
    arguments = [*(("--no-sandbox",) if os.geteuid() == 0 else ()), *(_WEBGL if webgl else ())]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=arguments)
        try:
            yield browser
        finally:
            browser.close()
