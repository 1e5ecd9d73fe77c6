"""Poses in another convention and depths of another scale are detected; photographs are selected by coverage."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gibson_sim.formats.mesh import TO_Z_UP
from gibson_sim.geometry.transforms import invert
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.conventions import photo_consistency, resolve_convention, with_convention
from gibson_sim_tools.texturing.photograph_selection import select_photographs
from support.painted_wall import painted_wall, photographed, row_of_cameras

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """The wall, photographs of it at their true poses, and depth images."""
    wall = painted_wall()
    found = photographed(
        tmp_path_factory.mktemp("wall"), wall, row_of_cameras(6, np.random.default_rng(2)), [1.0, 1.3, 0.8, 1.1, 0.7, 1.2]
    )
    for item in found.items:
        cv2.imwrite(str(item.file.with_suffix(".depth.png")), wall.depth(item.T_world_camera, 1000.0))
    return wall, replace(found, items=tuple(replace(item, depth=item.file.with_suffix(".depth.png")) for item in found.items))


def test_correct_poses_stay_as_read(taken):
    wall, photographs = taken
    found = photo_consistency(wall.surface, photographs)
    assert found.coverage > 0.7 and found.correlation > 0.9
    same, text = resolve_convention(wall.surface, photographs)
    assert same is photographs and text == ""


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("opengl", lambda T: T @ OPENGL),
        ("opencv-world-to-camera", invert),
        ("opengl-world-to-camera", lambda T: invert(T @ OPENGL)),
        ("y-up", lambda T: np.block([[TO_Z_UP["y"].T, np.zeros((3, 1))], [0.0, 0.0, 0.0, 1.0]]) @ T),
    ],
)
def test_another_convention_is_named_and_used_on_request(taken, name, written):
    wall, photographs = taken
    given = photographs.with_poses(np.stack([written(T) for T in photographs.poses]))
    with pytest.raises(ScanError, match=f"poses are read as {name} .* give --pose-convention {name}, or auto"):
        resolve_convention(wall.surface, given)
    mended, text = resolve_convention(wall.surface, given, "auto")
    np.testing.assert_allclose(mended.poses, photographs.poses, atol=1e-12)
    assert text.startswith(f"poses are read as {name}")
    np.testing.assert_allclose(resolve_convention(wall.surface, given, name)[0].poses, photographs.poses, atol=1e-12)


def test_conventions_are_those_of_the_file_whatever_its_layout(taken):
    photographs = taken[1]
    # nerfstudio's layout was read as OpenGL: what the file holds is the pose with y and z turned.
    nerfstudio = replace(photographs, layout="nerfstudio")
    np.testing.assert_allclose(with_convention(nerfstudio, "opencv").poses, photographs.poses @ OPENGL)
    np.testing.assert_allclose(with_convention(nerfstudio, "opengl").poses, photographs.poses)
    colmap = replace(photographs, layout="colmap")
    np.testing.assert_allclose(with_convention(colmap, "opencv").poses[1], invert(photographs.poses[1]))


def test_poses_before_nerfstudios_applied_transform(taken):
    wall, photographs = taken
    applied_transform = np.eye(4)[[1, 2, 0, 3]]
    given = replace(photographs.with_poses(applied_transform @ photographs.poses), applied_transform=applied_transform)
    np.testing.assert_allclose(resolve_convention(wall.surface, given, "auto")[0].poses, photographs.poses, atol=1e-12)
    with pytest.raises(ScanError, match="has no applied_transform"):
        with_convention(photographs, "before-applied-transform")


def test_depth_images_reveal_another_scale_of_mesh_and_poses(taken):
    wall, photographs = taken
    poses = photographs.poses
    poses[:, :3, 3] /= 2.5
    small = TriangleMesh(wall.surface.vertices / 2.5, wall.surface.triangles)
    with pytest.raises(ScanError, match=r"2.5 times as far as in the mesh; .* give --unit 2.5"):
        resolve_convention(small, photographs.with_poses(poses))
    resolve_convention(wall.surface, photographs)


def without_depth(photographs):
    return replace(photographs, items=tuple(replace(item, depth=None) for item in photographs.items))


def test_photographs_that_agree_poorly_are_used_with_a_warning(taken):
    wall, photographs = taken
    wrong = without_depth(photographs).with_poses(photographs.poses[[3, 5, 0, 4, 1, 2]])
    _, text = resolve_convention(wall.surface, wrong)
    assert text.startswith("warning: photographs agree poorly on the mesh (agreement 0.")


def test_depths_that_agree_with_the_mesh_outweigh_photographs_that_do_not(taken):
    wall, photographs = taken
    grey = replace(photographs, items=tuple(replace(item, file=photographs.items[0].file) for item in photographs.items))
    assert resolve_convention(wall.surface, grey)[1] == ""


def test_selected_photographs_cover_the_wall(taken):
    wall, photographs = taken
    # Three times the same view from the left, one from the right: of two, each side is one.
    few = photographs.subset([0, 0, 0, 5])
    assert 3 in select_photographs(wall.surface, few, 2).tolist()
    assert select_photographs(wall.surface, few, 4).tolist() == [0, 1, 2, 3]
    # A photograph of the back of the wall shows nothing of it.
    behind = few.poses
    behind[3] = np.diag([1.0, 1.0, -1.0, 1.0]) @ behind[3] @ np.diag([-1.0, 1.0, 1.0, 1.0])
    assert 3 not in select_photographs(wall.surface, few.with_poses(behind), 2).tolist()
