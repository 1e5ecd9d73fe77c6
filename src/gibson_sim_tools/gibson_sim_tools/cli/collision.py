"""``gibson-sim scene collision``: writes collision geometry: a convex decomposition of an object, or the simplified mesh of a scan."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.errors import GibsonSimError


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "collision", help="decompose an object's mesh into convex parts for its URDF, or simplify a scan",
        description="Convex decomposition uses CoACD (pip install 'gibson_sim_tools[collision]'), or V-HACD if CoACD is not installed.",
    )  # fmt: skip
    parser.add_argument("mesh", type=Path, metavar="MESH", help="mesh file")
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for part_0.obj, part_1.obj, ... (default: write nothing)"
    )
    parser.add_argument("--scan", action="store_true", help="simplify the mesh, z up, metres, as `collision: simplified` does")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    # Lazy imports: the other sub-commands do not need them.
    from gibson_sim.formats.load_mesh import load_mesh
    from gibson_sim.physics.convex_parts import convex_parts as v_hacd_parts
    from gibson_sim.scenes.collision.scan import scan_shapes
    from gibson_sim_tools.convex_parts import convex_parts

    vertices, triangles = load_mesh(args.mesh, [args.mesh.resolve().parent]).merged()
    if args.scan:
        shapes = [shape for shape, _ in scan_shapes(vertices, triangles, args.mesh.name)]
        files = [Path(shape.mesh) for shape in shapes if shape.kind == "mesh"]
        simplified_count = sum(len(load_mesh(file, [file.parent]).merged()[1]) for file in files)
        print(f"{len(triangles)} triangles: {simplified_count} triangles and {len(shapes) - len(files)} boxes for level floors")
    else:
        files = list(convex_parts(vertices, triangles, args.mesh.name, otherwise=v_hacd_parts))
        print(f"{len(triangles)} triangles: {len(files)} convex parts")
    if args.output is not None:
        try:
            args.output.mkdir(parents=True, exist_ok=True)
            for file in files:
                shutil.copy(file, args.output / file.name)
        except OSError as error:
            raise GibsonSimError(f"{args.output}: cannot be written: {error.strerror or error}; name another --output") from error
        print(args.output)
    return ExitCode.OK
