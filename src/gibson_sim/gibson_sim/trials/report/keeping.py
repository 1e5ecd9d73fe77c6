"""Keeps the path of a judged run and pictures of a failure; removes bags that need not be kept."""

from __future__ import annotations

import logging
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from gibson_sim.bags.film import write_film_strip
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.video import image_topics
from gibson_sim.errors import GibsonSimError
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.paths import write_path
from gibson_sim.trials.run_folder import BAG
from gibson_sim.writing import write_file

FILM, PATH_PLOT, MOTION_PLOT = "film.jpg", "path.png", "motion.png"
PICTURES = {FILM: "film strip", PATH_PLOT: "path on the map", MOTION_PLOT: "velocities and contacts"}
"""Picture files in the folder of a run, in the order of the page -> captions."""
_COLUMNS, _WIDTH = 6, 240
"""Number of frames of a film strip, and the width of each, pixels."""
_DPI = 130.0
_log = logging.getLogger(__name__)


def keep_of_run(result: RunResult, folder: Path, keep: Literal["failed", "all"]) -> None:
    """Writes the path of a run, and pictures if it failed; then removes its bags if it passed and they need not be kept.

    A path or picture that cannot be created is omitted with a warning; the result of the run remains valid.

    Args:
        result: result of the run.
        folder: folder of the run, with its bag in ``bag``.
        keep: runs whose bags are kept.
    """
    bag = folder / BAG
    if bag.is_dir():
        try:
            write_path(bag, folder)
            if not result.passed:
                _write_pictures(bag, folder, result.run.goal[:2])
        except GibsonSimError as error:
            _log.warning("run %d: the page lacks pictures of it: %s", result.run.number, error)
    if result.passed and keep == "failed":
        for old in (bag, *folder.glob(f"{BAG}_epoch*")):
            shutil.rmtree(old, ignore_errors=True)


def _write_pictures(bag: Path, folder: Path, goal: tuple[float, float]) -> None:
    """Writes the pictures of a run; ``goal``: x, y, map frame, metres."""
    with BagReader(bag) as reader:
        has_images = any(reader.topics()[topic].count for topic in image_topics(reader))
    if has_images:
        write_film_strip(bag, folder / FILM, columns=_COLUMNS, width=_WIDTH)
    if find_spec("matplotlib") is not None:
        _write_plots(bag, folder, goal)


def _write_plots(bag: Path, folder: Path, goal: tuple[float, float]) -> None:
    # Imported here: importing matplotlib takes a second, and most runs pass.
    from gibson_sim.bags.plots import panels
    from gibson_sim.bags.plots.load import load_run
    from gibson_sim.bags.plots.plot import draw_motion
    from gibson_sim.bags.plots.style import drawn

    run = load_run(bag)

    def draw_path(figure: Any) -> None:
        panels.draw_paths(figure.subplots(), run, goal)

    rows = max(len(panels.contact_rows(run)), 2)
    height = 1.7 * len(panels.velocity_parts(run)) + 0.8 + 0.24 * rows
    write_file(folder / PATH_PLOT, drawn((5.8, 5.6), draw_path, form="png", dpi=_DPI))
    write_file(folder / MOTION_PLOT, drawn((6.2, height), lambda figure: draw_motion(figure, run), form="png", dpi=_DPI))
