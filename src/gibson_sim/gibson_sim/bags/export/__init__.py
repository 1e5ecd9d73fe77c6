"""Data sets from bags: images, depth, poses and measurements in the formats of other programs. ``export_bag`` writes one.

``read`` finds the cameras of a bag, ``poses`` their poses; ``tum``, ``nerfstudio``, ``png`` and ``lerobot`` write. Must not import rclpy.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from gibson_sim.bags.export.job import ExportJob, ExportOptions, ExportReport, Format
from gibson_sim.bags.export.lerobot import export_lerobot
from gibson_sim.bags.export.nerfstudio import export_nerfstudio
from gibson_sim.bags.export.png import export_png
from gibson_sim.bags.export.tum import export_tum
from gibson_sim.bags.progress import Advance, no_progress
from gibson_sim.bags.reader import BagReader

__all__ = ["ExportOptions", "ExportReport", "Format", "export_bag"]

_WRITERS: dict[Format, Callable[[ExportJob], None]] = {
    "tum": export_tum,
    "nerfstudio": export_nerfstudio,
    "lerobot": export_lerobot,
    "png": export_png,
}


def export_bag(
    bag: str | Path, to: Format, output: str | Path, options: ExportOptions | None = None, advance: Advance = no_progress
) -> ExportReport:
    """Writes a data set; returns the report.

    Raises:
        RecordError: the bag has nothing to export, or lacks what the format needs.
        WriteError: a file cannot be written.
    """
    with BagReader(bag) as reader:
        job = ExportJob(reader, Path(output), options or ExportOptions(), advance)
        try:
            _WRITERS[to](job)
        except BaseException:
            # A partial data set is indistinguishable from a complete one; the folder was empty before.
            shutil.rmtree(job.output, ignore_errors=True)
            raise
        return job.report
