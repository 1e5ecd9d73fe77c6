"""The benchmark of renderers, from the scene's files to the picture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim_bench.render import RenderPlan, measure
from gibson_sim_bench.scenes.bench_scenes import bench_scene, export_for_peers
from gibson_sim_bench.timing import FIVE

pytestmark = pytest.mark.egl


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A red floor with a blue wall in the north, 4 m x 4 m, one mesh with one texture; the user's cache is empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "room"
    folder.mkdir()
    picture = np.zeros((64, 64, 3), dtype=np.uint8)
    picture[:32] = (255, 0, 0)  # blue, as OpenCV has it: the upper half
    picture[32:] = (0, 0, 255)
    cv2.imwrite(str(folder / "atlas.png"), picture)
    (folder / "room.mtl").write_text("newmtl atlas\nKd 1 1 1\nmap_Kd atlas.png\n")
    (folder / "room.obj").write_text(
        "mtllib room.mtl\nusemtl atlas\n"
        "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nv 0 4 2.5\nv 4 4 2.5\n"
        "vt 0.1 0.1\nvt 0.9 0.1\nvt 0.9 0.4\nvt 0.1 0.4\nvt 0.1 0.6\nvt 0.9 0.6\nvt 0.9 0.9\nvt 0.1 0.9\n"
        "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 4/5 3/6 6/7\nf 4/5 6/7 5/8\n"
    )
    (folder / "scene.yaml").write_text(
        "name: room\nfloor_z: 0.0\nobjects:\n- {name: room, mesh: room.obj, semantic_class: wall}\n"
    )
    return folder


@pytest.mark.usefixtures("egl")
def test_a_small_scene_is_measured_and_its_picture_written(room: Path, tmp_path: Path) -> None:
    plan = RenderPlan(scenes=(str(room),), sizes=((64, 64),), outputs=(("rgb",), FIVE), frames=6, images=tmp_path / "images")
    report = measure(plan)
    assert [(row.scene, row.triangles, row.outputs) for row in report.rows] == [("room", 4, ("rgb",)), ("room", 4, FIVE)]
    assert all(0.0 < row.p5 <= row.fps <= row.p95 for row in report.rows)
    image = cv2.imread(str(tmp_path / "images" / "room_64x64_Gibson_Sim.png"))
    assert image.shape == (64, 64, 3)
    assert "/" not in "".join(f"{key}{value}" for info in report.contestants.values() for key, value in info.items())


def test_peers_get_the_same_triangles_and_the_texture_as_a_picture(room: Path) -> None:
    folder = export_for_peers(bench_scene(str(room)))
    with np.load(folder / "mesh.npz") as arrays:
        assert len(arrays["triangles"]) == 4
        # The wall's top shows the upper part of the picture: v counts from the top.
        top = arrays["vertices"][:, 2] > 2.0
        np.testing.assert_allclose(arrays["uvs"][top][:, 1], 0.1, atol=1e-6)
    picture = cv2.imread(str(folder / "atlas.png"))
    assert tuple(picture[0, 0]) == (255, 0, 0)
    assert sum(line.startswith("f ") for line in (folder / "mesh.obj").read_text().splitlines()) == 4
