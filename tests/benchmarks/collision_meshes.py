"""A scan against what stands for it: time of a physics step, and the same contacts at 10,000 places.

    python tests/benchmarks/collision_meshes.py [--mesh SCAN.ply] [--triangles 300000] [--objects 50]

A robot drives among boxes that lie on the floor, in both worlds by turns; the time is that of the processor. Without ``--mesh`` the
scan is a generated floor of twelve rooms with 5 mm of noise.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.geometry.triangle_meshes import weld
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.collision.scan import scan_shapes
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose, VelocityCommand
from gibson_sim_tools.generator.rooms import rooms_mesh
from support.probes import BOX, SPHERE, random_places, verdicts, write_mesh

Shapes = tuple[tuple[Shape, Pose], ...]
NOISE = 0.005
PROBES = 5_000
"""Spheres, and as many boxes."""
ROUNDS = 3
STEPS = 480
ROOM = (5.3, 5.0)
"""Middle of a room of the generated floor, metres."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--mesh", type=Path)
    parser.add_argument("--triangles", type=int, default=300_000)
    parser.add_argument("--objects", type=int, default=50)
    args = parser.parse_args()
    vertices, triangles = _scan(args.mesh, args.triangles)
    with TemporaryDirectory() as folder:
        full = ((write_mesh(Path(folder) / "full.obj", vertices, triangles), Pose()),)
        started = time.process_time()
        simple = scan_shapes(vertices, triangles, "scan", folder=Path(folder) / "cache")
        print(f"{len(triangles)} triangles, simplified in {time.process_time() - started:.1f} s to {_count(simple)}")
        if args.mesh is None:
            for objects in (0, args.objects):
                _compare_steps(full, simple, objects)
        for name, kind, sizes in (("spheres", SPHERE, (0.1, 0.2, 0.3)), ("boxes", BOX, (0.2, 0.35, 0.5))):
            places = random_places(vertices, PROBES, np.random.default_rng(0))
            one, other = (verdicts(shapes, places, sizes, kind) for shapes in (full, simple))
            print(f"{PROBES} {name}: {100 * one.mean():.1f} % touch the scan, {100 * (one == other).mean():.2f} % are equal")


def _scan(mesh: Path | None, count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    if mesh is not None:
        vertices, triangles = load_mesh(mesh, [mesh.resolve().parent]).merged()
        return weld(vertices, triangles)
    points, corners = weld(*rooms_mesh(count, 0, 1024).merged())
    return points + np.random.default_rng(0).normal(0.0, NOISE, points.shape), corners


def _count(shapes: Shapes) -> str:
    meshes = [shape for shape, _ in shapes if shape.kind == "mesh"]
    count = sum(len(load_mesh(Path(shape.mesh), [Path(shape.mesh).parent]).merged()[1]) for shape in meshes)
    return f"{count} triangles and {len(shapes) - len(meshes)} boxes"


def _compare_steps(full: Shapes, simple: Shapes, objects: int) -> None:
    worlds = [_world(shapes, objects) for shapes in (full, simple)]
    times: list[list[float]] = [[], []]
    for _ in range(ROUNDS):
        for world, spent in zip(worlds, times, strict=True):
            started = time.process_time()
            for _ in range(STEPS // 12):
                world.command("robot", VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.6), world.stamp_ns))
                world.step(12)
            spent.append((time.process_time() - started) / STEPS)
    for world in worlds:
        world.close()
    one, other = (1e6 * float(np.median(spent)) for spent in times)
    print(
        f"robot and {objects} objects: {one:.0f} us a step on the scan, {other:.0f} us on what stands for it: {one / other:.1f} times"
    )


def _world(shapes: Shapes, objects: int) -> PhysicsWorld:
    robot = replace(load_robot("gibson_bot"), start=pose_from_xyz_rpy((*ROOM, 0.02)))
    collisions = tuple(CollisionSpec("scan", shape, pose) for shape, pose in shapes)
    side = math.ceil(math.sqrt(objects + 20)) if objects else 0
    grid = [(x, y) for x in np.linspace(-1.3, 1.3, side) for y in np.linspace(-1.3, 1.3, side) if math.hypot(x, y) > 0.75]
    bodies = tuple(_box(f"box_{i}", ROOM[0] + x, ROOM[1] + y) for i, (x, y) in enumerate(grid[:objects]))
    return PhysicsWorld(SceneSpec("bench", Path(), "", (), collisions, robots=(robot,), bodies=bodies))


def _box(name: str, x: float, y: float) -> BodySpec:
    inertial = Inertial(1.0, Pose(), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    link = UrdfLink("body", (), (UrdfCollision(Shape("box", (0.2, 0.15, 0.1)), Pose()),), inertial, 0.5)
    return BodySpec(name, UrdfModel(name, Path(name), (link,), ()), pose_from_xyz_rpy((x, y, 0.06)))


if __name__ == "__main__":
    main()
