"""The meshes of ``arm_bot``."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.formats.load_mesh import load_shape
from gibson_sim.robots.load import load_robot
from gibson_sim_tools.making.robots.arm_bot import FINISHES, arm_bot_solids, write_arm_bot
from gibson_sim_tools.making.robots.surfaces import ClosedSurface, Section, box, loft, tube


def volume(solid: ClosedSurface) -> float:
    """Returns the volume of a closed surface with outward triangles, cubic metres."""
    a, b, c = (solid.vertices[solid.triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_a_sharp_box_has_its_volume_and_a_rounded_one_a_little_less() -> None:
    sharp = box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0), "shell", 1e-6, 0.0)
    assert volume(sharp) == pytest.approx(6.0, rel=1e-4)
    assert 5.5 < volume(box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0), "shell", 0.1, 0.1)) < 6.0


def test_a_tube_has_the_volume_of_a_cylinder_and_stands_where_it_is_put() -> None:
    solid = tube([(-0.5, 0.2), (0.5, 0.2)], "shell").transformed((1.0, 0.0, 0.0), (0.0, math.pi / 2, 0.0))
    assert volume(solid) == pytest.approx(math.pi * 0.04, rel=0.02)
    assert np.ptp(solid.vertices, axis=0) == pytest.approx([1.0, 0.4, 0.4], abs=1e-3)
    assert solid.vertices.mean(axis=0) == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)


def test_normals_point_outward_and_edges_are_shared() -> None:
    solid = loft([Section(0.0, 0.1, 0.2, 0.05), Section(0.3, 0.2, 0.1, 0.05)], "shell", 0.02)
    assert np.linalg.norm(solid.normals, axis=1) == pytest.approx(1.0)
    middle = np.array([0.0, 0.0, 0.15])
    assert np.einsum("ij,ij->i", solid.vertices - middle, solid.normals).min() > 0.0
    edges = np.sort(np.concatenate([solid.triangles[:, [0, 1]], solid.triangles[:, [1, 2]], solid.triangles[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert set(counts.tolist()) == {2}


def test_the_meshes_that_are_shipped_are_those_that_the_command_makes(root: Path, tmp_path: Path) -> None:
    shipped = root / "config/robots/arm_bot/meshes"
    made = write_arm_bot(tmp_path)
    assert {file.name for file in made} == {file.name for file in shipped.iterdir()}
    for file in made:
        # The last bits of sines differ from machine to machine.
        ours, theirs = (load_shape(Shape("mesh", mesh=str(path)), [path.parent]) for path in (file, shipped / file.name))
        assert ours.bounds == pytest.approx(theirs.bounds, abs=1e-6)
        assert [part.material for part in ours.parts] == [part.material for part in theirs.parts]
        assert ours.triangle_count == theirs.triangle_count


def test_every_mesh_is_used_and_small(root: Path) -> None:
    robot = load_robot(root / "config/robots/arm_bot")
    used = {Path(visual.shape.mesh).stem for visual in robot.visuals}
    assert used == set(arm_bot_solids())
    assert {solid.finish for solids in arm_bot_solids().values() for solid in solids} <= set(FINISHES)
    assert sum(file.stat().st_size for file in (root / "config/robots/arm_bot/meshes").iterdir()) < 1_000_000
