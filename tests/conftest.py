"""Fixtures that all tests share."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def root() -> Path:
    """The source tree."""
    return ROOT


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with worlds and robots that other people made: ``$GIBSON_SIM_TEST_DATA``, or ``shared/data`` beside this clone."""
    folder = Path(os.environ.get("GIBSON_SIM_TEST_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        message = f"SKIPPED: no real worlds at {folder}; set GIBSON_SIM_TEST_DATA to a folder that holds them"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    return folder
