"""scene.yaml: ``visual``, the splats that are drawn over the scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.formats.splats import splats_ply
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec, SplatsSpec, drawn_scene
from support.splat_files import random_splats, spz


def _load(folder: Path, visual: str) -> SceneSpec:
    (folder / "scene.yaml").write_text(f"objects: [{{box: [1, 1, 1]}}]\nvisual: {visual}\n")
    (folder / "room.ply").write_bytes(splats_ply(random_splats(3)))
    (folder / "room.spz").write_bytes(spz(random_splats(3)))
    (folder / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    return load_scene(folder)


def test_a_scene_names_its_splats_their_pose_and_their_scale(tmp_path: Path) -> None:
    scene = _load(tmp_path, "{splats: room.ply, pose: {xyz: [1, 2, 3], rpy_deg: [0, 0, 90]}, scale: 0.5}")
    assert scene.splats is not None and scene.splats.file == str(tmp_path / "room.ply") and scene.splats.scale == 0.5
    np.testing.assert_allclose(matrix_from_pose(scene.splats.pose) @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-9)
    assert drawn_scene(scene, ()).splats == scene.splats
    assert drawn_scene(scene, ()).instances == ("", "box")


def test_the_up_axis_is_that_of_the_format_unless_it_is_given(tmp_path: Path) -> None:
    turned = []
    for visual in ("{splats: room.spz}", "{splats: room.ply}", "{splats: room.ply, up_axis: y}"):
        splats = _load(tmp_path, visual).splats
        assert splats is not None
        turned.append(matrix_from_pose(splats.pose) @ [0, 1, 0, 1])
    np.testing.assert_allclose(turned, [[0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 1, 1]], atol=1e-9)


def test_other_splats_make_another_scene(tmp_path: Path) -> None:
    digests = {_load(tmp_path, visual).content_hash for visual in ("{splats: room.ply}", "{splats: room.spz}")}
    assert len(digests) == 2


@pytest.mark.parametrize(
    ("visual", "message"),
    [
        ("{splat: room.ply}", "did you mean 'splats'"),
        ("{scale: 2}", "has no key splats; give the name of a PLY or SPZ file"),
        ("{splats: none.ply}", r"none\.ply: cannot be read: No such file"),
        ("{splats: photo.jpg}", r"photo\.jpg: is not a file of splats; known are"),
        ("{splats: ../../etc/passwd}", "lies outside the scene's folder"),
        ("{splats: room.ply, scale: 0}", "scale"),
        ("{splats: room.ply, up_axis: w}", "up_axis is .*must be x, y or z"),
        ("room.ply", "visual"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_file_and_the_place(tmp_path: Path, visual: str, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        _load(tmp_path, visual)
    assert "scene.yaml: visual" in str(caught.value) and "\n" not in str(caught.value)


def test_an_impossible_scale_is_refused() -> None:
    with pytest.raises(ConfigError, match="splats: scale is 0"):
        SplatsSpec("/a.ply", scale=0.0)
