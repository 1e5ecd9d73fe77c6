"""Rendering of bags as units of work for ``jobs``: ``gibson-sim render`` of several bags."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.client_config import RenderBagConfig
from gibson_sim.config import RenderConfig
from gibson_sim.errors import RecordError
from gibson_sim.ros.nodes.node_main import keep_large_blocks
from gibson_sim.ros.recording.render_bag import render_bag

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Context


def render_one(arguments: dict[str, Any], folder: Path, context: Context) -> str:
    """Renders one bag into the unit's folder; returns the summary as a line.

    Args:
        arguments: ``bag`` and ``render``, the settings; ``files``, the names of the settings in ``bag`` that are files of the unit.
        folder: folder of the new bag.
        context: context of the unit.

    Raises:
        GibsonSimError: the bag cannot be rendered, or the unit is interrupted.
    """
    logging.addLevelName(logging.WARNING, "WARN")
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(message)s")
    keep_large_blocks()
    values = arguments["bag"]
    local_paths = {name: str(context.path(values[name])) for name in arguments["files"]}

    def advance(_: float) -> None:
        if context.stop():
            raise KeyboardInterrupt

    job = RenderBagConfig(**{**values, **local_paths, "output": str(folder)})
    try:
        return render_bag(job, RenderConfig(**arguments["render"]), advance).text()
    except KeyboardInterrupt as error:
        raise RecordError("interrupted: the new bag contains all messages up to now") from error
