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
from gibson_sim_tools.making.pixels import fill_gaps_mirrored, hidden_texels

_COLOR_COST = 4.0
"""Cost of the colour pass, in samples of the light pass."""


def main() -> None:
    """Builds the building and bakes the missing atlases."""
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
    _report_progress(f"{len(assembly.owner)} triangles, {assembly.density:.0f} pixels per metre", 0.02)
    atlases = sorted({int(a) for a in assembly.atlas if a >= 0})
    missing = [
        (k, pass_name) for pass_name in ("color", "light") for k in atlases if not (work / f"{pass_name}_{k}.npy").exists()
    ]
    mirrors = work / "mirrors.npz"
    if missing or not mirrors.exists():
        stage = BakedStage(building, assembly, quality.samples)
        _bake_all(stage, quality, missing, work)
        if not mirrors.exists():
            _render_mirrors(assembly, quality, mirrors)
    _report_progress("baked", 1.0)


def _bake_all(stage: BakedStage, quality: Quality, missing: list[tuple[int, str]], work: Path) -> None:
    # The last atlas has the smallest charts, with the fewest pixels for the denoiser.
    factors = np.linspace(1.0, 2.0, quality.atlases) if quality.atlases > 1 else np.ones(1)
    costs = [_COLOR_COST if pass_name == "color" else quality.samples * factors[k] for k, pass_name in missing]
    done = 0.0
    for (atlas, pass_name), cost in zip(missing, costs, strict=True):
        _report_progress(f"{pass_name} of atlas {atlas + 1} of {quality.atlases}", 0.02 + 0.96 * done / sum(costs))
        size_px = quality.size_px
        image = stage.color(atlas, size_px) if pass_name == "color" else stage.light(atlas, size_px // 2, float(factors[atlas]))
        covered = image[..., 3] > 0.5
        if pass_name == "light":
            # Texels inside other geometry are dark and must not bleed onto visible ones.
            covered &= ~hidden_texels(stage.openness(atlas, size_px // 2), covered)
            image[..., :3] = denoise(fill_gaps_mirrored(image[..., :3], covered))
        part = work / f"{pass_name}_{atlas}.part.npy"
        np.save(part, np.concatenate([image[..., :3], covered[..., None]], axis=-1).astype(np.float16))
        os.replace(part, work / f"{pass_name}_{atlas}.npy")
        done += cost


def _render_mirrors(assembly: Assembly, quality: Quality, path: Path) -> None:
    """Writes the reflection of each mirror, the index of its atlas, and its corners in the atlas."""
    _report_progress("mirrors", 0.98)
    rows: dict[str, Any] = {}
    for number, mirror in enumerate(mirrors_of(assembly)):
        rows[f"image_{number}"] = reflection(mirror, 2 * quality.samples).astype(np.float16)
        rows[f"uv_{number}"], rows[f"atlas_{number}"] = mirror.uv, mirror.atlas
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, **rows)
    os.replace(part, path)


def _report_progress(text: str, done: float) -> None:
    print(json.dumps({"text": text, "done": round(done, 4)}), flush=True)


if __name__ == "__main__":
    main()
