"""Scans turned by random rotations: levelled upright, or "not sure", and never wrong.

    python tests/benchmarks/upright.py [SCENE|MESH|SCAN ...] [--rotations 50] [--cues]

A scene is scanned first (preset kinect, 120 images of 320x240), and the mesh is the one of its depth images: noisy, with holes, without
textures. Meshes and models are taken as they are, folders of posed RGB-D as their depth images. z must be up in all of them. Exit code 1 if one
is laid on its side or on its head. ``--cues`` prints what speaks for each direction, of which ``geometry/upright.py`` has the weights.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gibson_sim.geometry.patches import flat_patches
from gibson_sim.geometry.upright import CUES, find_candidates
from gibson_sim.render.cache import default_folder
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.importing.checks.facts import scene_geometry
from gibson_sim_tools.scanning.capture import ScanSettings, scan
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.settings import PRESETS, Defects, ScanCamera, TourSettings
from support.turning import depth_mesh, random_rotation, verdict

F64 = NDArray[np.float64]
SCENES = ("linden_flat", "garden_house", "corner_shop", "print_works_office")


def mesh_of(source: str) -> tuple[F64, NDArray[np.integer]]:
    """Returns vertices and triangles of what is named on the command line."""
    path = Path(source)
    if (path / "depth").is_dir():
        return depth_mesh(open_posed_rgbd(path))
    scene = load_scene(source)
    if path.exists():
        geometry = scene_geometry(scene)
        return geometry.vertices, geometry.triangles
    with TemporaryDirectory() as folder:
        scan(scene, Path(folder), kinect(120, 320, 240), cache=default_folder())
        return depth_mesh(open_posed_rgbd(Path(folder)))


def kinect(frames: int, width: int, height: int) -> ScanSettings:
    """Returns the preset of that name for a short scan."""
    own = {"frames": frames, "width": width, "height": height, "coverage": 0.9, "seed": 1}
    values = {**PRESETS["kinect"], **own}
    parts = (
        part(**{name: values[name] for name in part.__dataclass_fields__ if name in values})
        for part in (TourSettings, ScanCamera, Defects)
    )
    return ScanSettings(*parts)


def main() -> int:
    """Runs the trials."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", nargs="*", default=SCENES)
    parser.add_argument("--rotations", type=int, default=50)
    parser.add_argument("--cues", action="store_true")
    args = parser.parse_args()
    wrong = 0
    for source in args.source:
        vertices, triangles = mesh_of(source)
        if args.cues:
            patches = flat_patches(vertices, triangles, np.random.default_rng(0))
            for found in find_candidates(patches) if patches is not None else []:
                cues = "  ".join(f"{name} {cue:5.2f}" for name, cue in zip(CUES, found.cues, strict=True))
                print(f"  {np.round(found.up, 2)!s:>22}  {found.chance:.3f}  {cues}")
        counts = Counter(verdict(vertices, triangles, random_rotation(seed)) for seed in range(args.rotations))
        wrong += counts["wrong"]
        print(
            f"{source}: of {args.rotations} " + ", ".join(f"{counts[v]} {v}" for v in ("upright", "not sure", "wrong")),
            flush=True,
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
