"""Scenes for Gibson Sim: made, imported, checked and scanned; sub-commands of ``gibson-sim scene``."""

from __future__ import annotations

import os
from pathlib import Path

import gibson_sim

__version__ = "0.1.0"


def package_path() -> str:
    """Returns the ``PYTHONPATH`` by which another interpreter, Blender's, finds this package and ``gibson_sim``."""
    return os.pathsep.join(dict.fromkeys(str(Path(file).resolve().parents[1]) for file in (gibson_sim.__file__, __file__)))
