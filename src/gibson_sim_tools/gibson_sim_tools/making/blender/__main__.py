"""``python -m gibson_sim_tools.making.blender PLAN WORK``: builds and bakes a building in a Python interpreter with Blender.

PLAN is a file of ``gibson_sim_tools.making.building``; WORK is a folder, whose finished files are kept. Each line on standard output
reports progress as JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.errors import GibsonSimError
from gibson_sim_tools.making.blender.assembly import Assembly, assemble
from gibson_sim_tools.making.blender.bake import BakedStage
from gibson_sim_tools.making.blender.denoise import denoise
from gibson_sim_tools.making.blender.mirrors import mirrors_of, reflection
from gibson_sim_tools.making.building import Quality, read_plan
from gibson_sim_tools.making.pixels import fill_gaps_mirrored, limit_outliers

_LAST_FACTOR = 1.5
"""Factor of the samples of the last light map."""


def main() -> None:
    """Builds the building and bakes the missing light maps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", type=Path)
    parser.add_argument("work", type=Path)
    args = parser.parse_args()
    try:
        _build_and_bake(args.plan, args.work)
    except GibsonSimError as error:
        sys.exit(f"{error}")


def _build_and_bake(plan: Path, work: Path) -> None:
    building, quality = read_plan(plan)
    _report_progress("furniture and walls", 0.0)
    assembly = assemble(building, quality.atlases, quality.size_px)
    mesh = work / "mesh.npz"
    if not mesh.exists():
        assembly.save(work / "mesh.part.npz")
        os.replace(work / "mesh.part.npz", mesh)
    _report_progress(f"{len(assembly.owner)} triangles, {assembly.density:.0f} texels per metre", 0.02)
    missing = [k for k in sorted({int(a) for a in assembly.atlas if a >= 0}) if not (work / f"light_{k}.npy").exists()]
    mirrors = work / "mirrors.npz"
    if missing or not mirrors.exists():
        stage = BakedStage(building, assembly, quality.size_px)
        _bake_all(stage, quality, missing, work)
        if not mirrors.exists():
            _render_mirrors(assembly, quality, mirrors)
    _report_progress("baked", 1.0)


def _bake_all(stage: BakedStage, quality: Quality, missing: list[int], work: Path) -> None:
    for done, atlas in enumerate(missing):
        _report_progress(f"light map {atlas + 1} of {quality.atlases}", 0.02 + 0.96 * done / len(missing))
        # The last light map has the smallest charts, with the fewest texels for the denoiser.
        is_last = atlas == quality.atlases - 1 > 0
        image = stage.light(atlas, round(quality.samples * (_LAST_FACTOR if is_last else 1.0)))
        covered = image[..., 3] > 0.5
        image[..., :3] = denoise(limit_outliers(fill_gaps_mirrored(image[..., :3], covered)))
        part = work / f"light_{atlas}.part.npy"
        np.save(part, np.concatenate([image[..., :3], np.round(image[..., 3:])], axis=-1).astype(np.float32))
        os.replace(part, work / f"light_{atlas}.npy")


def _render_mirrors(assembly: Assembly, quality: Quality, path: Path) -> None:
    """Writes the reflection of each mirror."""
    _report_progress("mirrors", 0.98)
    rows: dict[str, Any] = {}
    for number, mirror in enumerate(mirrors_of(assembly)):
        rows[f"image_{number}"] = reflection(mirror, 2 * quality.samples).astype(np.float16)
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, **rows)
    os.replace(part, path)


def _report_progress(text: str, done: float) -> None:
    print(json.dumps({"text": text, "done": round(done, 4)}), flush=True)


if __name__ == "__main__":
    main()
