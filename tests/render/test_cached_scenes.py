"""A renderer draws the same from the cache as from the files."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.config import DETAIL_PX
from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.render import cache, renderer as module
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import OUTPUTS, Frame
from render.drawing import box, eye_at, scene, state
from support.surfaces import bumpy_sphere, detail_from

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

CAMERA = eye_at((-2.0, 0.5, 0.7), look_at=(0.0, 0.0, 0.0), width=90, height=70, outputs=OUTPUTS)
NOW, BEFORE = (state(("a",), [(0.0, y, 0.0)]) for y in (0.0, 0.1))


@pytest.fixture
def drawn(tmp_path: Path) -> DrawnScene:
    """A bumpy ball with a texture, in a file, on a link; a box in the world, and a mesh whose file is missing."""
    part = bumpy_sphere(26)
    folder = tmp_path / "models" / "ball"
    folder.mkdir(parents=True)
    image = np.random.default_rng(4).integers(0, 255, (16, 16, 3), dtype=np.uint8)
    assert cv2.imwrite(str(folder / "noise.png"), image)
    (folder / "ball.mtl").write_text("newmtl m\nmap_Kd noise.png\n")
    lines = ["mtllib ball.mtl", "usemtl m", *(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in part.vertices.tolist())]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in part.uvs.tolist()]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in triangle) for triangle in part.triangles.tolist()]
    (folder / "ball.obj").write_text("\n".join(lines) + "\n")
    ball = VisualSpec("ball", "a", Shape("mesh", mesh=str(folder / "ball.obj")), semantic_class="ball")
    missing = VisualSpec("missing", "", Shape("mesh", mesh=str(folder / "missing.obj")))
    return scene(ball, box((0.5, 1.2, 0.0)), missing, links=("a",))


@pytest.fixture(autouse=True)
def _small_scenes_are_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "SMALLEST", 1)


def _draw(
    drawn: DrawnScene, folder: Path | None, detail_px: float = DETAIL_PX
) -> tuple[Frame, tuple[str, ...], dict[str, object]]:
    with Renderer(drawn, MeshFiles(cache=folder), RenderOptions(detail_px=detail_px)) as renderer:
        return renderer.render(NOW, [CAMERA], BEFORE)[0], renderer.warnings, renderer.info


def test_cached_scene_has_equal_images_warnings_and_counts(
    drawn: DrawnScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, first = _draw(drawn, None), _draw(drawn, tmp_path / "cache")

    def must_not_load(*args: object, **kwargs: object) -> None:
        raise AssertionError("the scene was loaded from its files")

    monkeypatch.setattr(module, "build_geometry", must_not_load)
    second = _draw(drawn, tmp_path / "cache")
    for output in OUTPUTS:
        for other in (plain, first):
            np.testing.assert_array_equal(getattr(second[0], output), getattr(other[0], output), err_msg=output)
    assert np.isfinite(second[0].depth).sum() > 500
    assert second[1:] == first[1:] == plain[1:]
    assert any("missing" in warning for warning in second[1])


def test_a_mesh_that_changed_is_drawn_as_it_is_now(drawn: DrawnScene, tmp_path: Path) -> None:
    before, _, _ = _draw(drawn, tmp_path / "cache")
    mesh = Path(drawn.visuals[0].shape.mesh)
    mesh.write_text("".join(f"{line}\n" for line in mesh.read_text().splitlines() if not line.startswith("f "))
                    + "f 1/1 500/500 700/700\n")  # fmt: skip
    after, _, _ = _draw(drawn, tmp_path / "cache")
    expected, _, _ = _draw(drawn, None)
    np.testing.assert_array_equal(after.depth, expected.depth)
    assert not np.array_equal(after.depth, before.depth)


def test_a_texture_that_changed_is_seen(drawn: DrawnScene, tmp_path: Path) -> None:
    _draw(drawn, tmp_path / "cache")
    red = np.zeros((16, 16, 3), dtype=np.uint8)
    red[..., 2] = 255  # OpenCV's order is blue, green, red
    assert cv2.imwrite(str(Path(drawn.visuals[0].shape.mesh).parent / "noise.png"), red)
    frame, _, _ = _draw(drawn, tmp_path / "cache")
    ball = frame.rgb[frame.instance == 1]
    assert ball[:, 0].min() > 40
    assert ball[:, 1:].max() < 5


def test_a_mesh_that_was_missing_before_is_drawn(drawn: DrawnScene, tmp_path: Path) -> None:
    _, warnings, info = _draw(drawn, tmp_path / "cache")
    assert any("missing" in warning for warning in warnings)
    ball = Path(drawn.visuals[0].shape.mesh)
    (ball.parent / "missing.obj").write_text(ball.read_text())
    _, warnings, more = _draw(drawn, tmp_path / "cache")
    assert not any("missing" in warning for warning in warnings)
    assert more["triangles"] > info["triangles"]


def test_levels_of_detail_and_all_triangles_are_kept_apart(drawn: DrawnScene, tmp_path: Path) -> None:
    with detail_from(1):
        _, _, coarse = _draw(drawn, tmp_path / "cache")
        _, _, fine = _draw(drawn, tmp_path / "cache", detail_px=0.0)
    assert len(list((tmp_path / "cache").glob("*.scene"))) == 2
    assert fine["clusters"] < coarse["clusters"] or cache.simplifier() is None


def test_a_damaged_file_costs_a_warning_and_nothing_else(
    drawn: DrawnScene, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    expected, _, _ = _draw(drawn, tmp_path / "cache")
    (file,) = (tmp_path / "cache").glob("*.scene")
    file.write_bytes(file.read_bytes()[:-1])
    with caplog.at_level(logging.WARNING):
        frame, _, _ = _draw(drawn, tmp_path / "cache")
    assert str(file) in caplog.text
    np.testing.assert_array_equal(frame.rgb, expected.rgb)
    assert cache.SceneCache(tmp_path / "cache").load(file) is not None, "it was written anew"


def test_without_a_cache_nothing_is_written(drawn: DrawnScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    before = sorted(tmp_path.rglob("*"))
    _draw(drawn, None)
    assert sorted(file for file in tmp_path.rglob("*") if ".cache/mesa" not in str(file)) == before


@pytest.mark.parametrize("which", ["the file", "its folder", "the folder above"])
def test_file_that_others_may_write_is_not_unpickled(
    drawn: DrawnScene, tmp_path: Path, which: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "gibson-sim" / "scenes"
    folder.mkdir(parents=True, mode=0o700)
    folder.parent.chmod(0o700)
    kept = cache.SceneCache(folder)
    file = folder / "a.scene"
    _explosive(file)
    {"the file": file, "its folder": folder, "the folder above": folder.parent}[which].chmod(0o777)
    assert kept.load(file) is None
    assert kept.load(file) is None
    assert not (tmp_path / "fired").exists()
    assert [record.message.count("may be written by others") for record in caplog.records] == [1]


def test_link_in_the_place_of_a_file_is_not_followed(drawn: DrawnScene, tmp_path: Path) -> None:
    folder = tmp_path / "scenes"
    folder.mkdir(mode=0o700)
    _explosive(tmp_path / "elsewhere.scene")
    (folder / "a.scene").symlink_to(tmp_path / "elsewhere.scene")
    assert cache.SceneCache(folder).load(folder / "a.scene") is None
    assert not (tmp_path / "fired").exists()


def test_file_of_another_user_is_not_unpickled(drawn: DrawnScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "scenes"
    folder.mkdir(mode=0o700)
    _explosive(folder / "a.scene")
    real = cache.os.fstat

    def of_another(descriptor: int) -> os.stat_result:
        found = list(real(descriptor))
        found[4] = os.getuid() + 1000
        return os.stat_result(found)

    monkeypatch.setattr(cache.os, "fstat", of_another)
    assert cache.SceneCache(folder).load(folder / "a.scene") is None
    assert not (tmp_path / "fired").exists()


def _explosive(file: Path) -> None:
    """Writes a whole cache file whose pickle makes the file ``fired`` at the top of the test's folder."""
    top = next(folder for folder in file.parents if folder.name not in ("scenes", "gibson-sim"))

    class Fires:
        def __reduce__(self) -> tuple[object, ...]:
            return (os.mkdir, (str(top / "fired"),))

    with file.open("wb") as out:
        cache._pack(out, (Fires(), []))
    file.chmod(0o600)
