"""A mesh as a rigid body: mass, inertia and shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.scenes.mass_properties import hull_solid
from gibson_sim.scenes.spawning import mesh_body
from support.gltf import Gltf

CUBE_FACES = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"


def write_box_obj(path: Path, low: tuple[float, float, float], high: tuple[float, float, float]) -> Path:
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + CUBE_FACES)
    return path


def test_box_has_the_mass_and_inertia_of_a_box(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path / "box.obj", (1.0, 0.0, 0.0), (1.2, 0.3, 0.5))
    (link,) = mesh_body(path, MeshLoader((tmp_path,))).links
    inertial = link.inertial
    assert inertial is not None
    # 0.2 x 0.3 x 0.5 m: 0.03 m^3, 9 kg; about x: 9/12 (0.09 + 0.25), about y: 9/12 (0.04 + 0.25), about z: 9/12 (0.04 + 0.09).
    assert inertial.mass == pytest.approx(9.0, rel=1e-5)
    assert inertial.pose.position == pytest.approx((1.1, 0.15, 0.25), rel=1e-5)
    np.testing.assert_allclose(inertial.inertia, [0.255, 0, 0, 0.2175, 0, 0.0975], atol=1e-5)


def test_tetrahedron_has_the_second_moments_of_a_tetrahedron() -> None:
    solid = hull_solid(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    assert solid.mass == pytest.approx(1 / 6)
    np.testing.assert_allclose(solid.center, [0.25, 0.25, 0.25])
    # About the corner: each int x^2 = 1/60, int xy = 1/120; less V c c^T = 1/6 * 1/16 = 1/96: 1/160 and -1/480.
    expected = np.full((3, 3), 1 / 480)
    np.fill_diagonal(expected, 2 / 160)
    np.testing.assert_allclose(solid.inertia, expected, atol=1e-12)


def test_hollow_shape_counts_as_its_hull(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path / "open.obj", (0, 0, 0), (0.2, 0.2, 0.2))
    text = path.read_text()
    # A box without its lid, and with a sheet inside.
    path.write_text(text.replace("f 2 6 8 4\n", "v 0.1 0.1 0.1\nv 0.1 0.1 0.15\nv 0.15 0.1 0.1\nf 9 10 11\n"))
    inertial = mesh_body(path, MeshLoader((tmp_path,))).links[0].inertial
    assert inertial is not None
    assert inertial.mass == pytest.approx(2.4, rel=1e-5)  # 0.008 m^3
    assert inertial.pose.position == pytest.approx((0.1, 0.1, 0.1), rel=1e-5)


def test_inertia_goes_with_the_mass_that_is_used(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path / "big.obj", (0, 0, 0), (1, 1, 1))
    inertial = mesh_body(path, MeshLoader((tmp_path,))).links[0].inertial
    assert inertial is not None
    assert inertial.inertia[0] == pytest.approx(100.0 / 6)


def test_small_thing_weighs_at_least_10_grams(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path / "pin.obj", (0, 0, 0), (0.01, 0.01, 0.01))
    inertial = mesh_body(path, MeshLoader((tmp_path,))).links[0].inertial
    assert inertial is not None
    assert inertial.mass == 0.01


@pytest.mark.parametrize(
    "points", [[[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 0, 0], [1, 0, 0], [2, 0, 0]]], ids=["sheet", "line"]
)
def test_flat_things_have_mass_and_inertia(points: list[list[float]]) -> None:
    solid = hull_solid(np.array(points, dtype=float))
    assert solid.mass > 0
    assert (np.linalg.eigvalsh(solid.inertia) > 0).all()


def test_body_is_drawn_and_collides_as_the_same_file(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path / "box.obj", (0, 0, 0), (1, 1, 1))
    model = mesh_body(path, MeshLoader((tmp_path,)))
    (link,) = model.links
    assert link.visuals[0].shape == link.collisions[0].shape == Shape("mesh", (1.0, 1.0, 1.0), str(path))
    assert link.friction == 0.5
    assert (model.name, model.joints) == ("box", ())


def test_glb_is_turned_to_z_up(tmp_path: Path) -> None:
    # A tetrahedron whose tip is 3 m up, which is +y in the file.
    gltf = Gltf()
    corners = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 3, 0]]
    gltf.triangle(corners, [0, 1, 2, 0, 1, 3, 1, 2, 3, 0, 2, 3])
    inertial = mesh_body(gltf.write(tmp_path / "tip.glb"), MeshLoader((tmp_path,))).links[0].inertial
    assert inertial is not None
    assert inertial.pose.position == pytest.approx((0.25, -0.25, 0.75), abs=1e-6)
    assert inertial.mass == pytest.approx(100.0)  # 0.5 m^3, 150 kg, at most 100


def test_broken_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.stl").write_bytes(b"solid")
    with pytest.raises(MeshError, match=r"x\.stl"):
        mesh_body(tmp_path / "x.stl", MeshLoader((tmp_path,)))


def test_mesh_that_is_larger_than_allowed_is_refused(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path / "box.obj", (0, 0, 0), (1, 1, 1))
    with pytest.raises(MeshError, match="is too large: it has 0 MB"):
        MeshLoader((tmp_path,), max_bytes=10).mesh(path)
