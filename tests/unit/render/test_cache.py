"""A loaded scene is cached for the next start, unless something it depends on has changed; failures cost only time."""

from __future__ import annotations

import dataclasses
import logging
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Appearance, Shape, VisualSpec
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.render import cache as module
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.cache import SceneCache, default_folder
from gibson_sim.types import Pose
from support.scenes import write_square_obj

Visuals = tuple[VisualSpec, ...]
TRIANGLES = 2


@pytest.fixture(autouse=True)
def _small_scenes_are_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SMALLEST", TRIANGLES)


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    """A square whose texture file is missing."""
    return write_square_obj(tmp_path / "model" / "meshes", "missing.png")


@pytest.fixture
def visuals(mesh: Path) -> Visuals:
    return (VisualSpec("square", "", Shape("mesh", mesh=str(mesh)), semantic_class="wall"),)


def _build(visuals: Visuals) -> SceneGeometry:
    folder = Path(visuals[0].shape.mesh).parent.parent
    return build_geometry(visuals, (), MeshLoader([folder]).shape, [(1, 1)] * len(visuals))


def _path(cache: SceneCache, visuals: Visuals, levels_of_detail: bool = True) -> Path:
    return cache.path(visuals, (), [(1, 1)] * len(visuals), levels_of_detail)


@pytest.fixture
def cache(tmp_path: Path) -> SceneCache:
    return SceneCache(tmp_path / "cache")


@pytest.fixture
def kept(cache: SceneCache, visuals: Visuals) -> Path:
    """The stored file of the scene."""
    path = _path(cache, visuals)
    cache.store(path, _build(visuals))
    assert path.is_file()
    return path


def test_a_loaded_scene_equals_the_stored_one(cache: SceneCache, visuals: Visuals, kept: Path) -> None:
    stored, loaded = _build(visuals), cache.load(kept)
    assert loaded is not None
    for field in dataclasses.fields(SceneGeometry):
        expected, found = getattr(stored, field.name), getattr(loaded, field.name)
        if isinstance(expected, np.ndarray):
            assert found.dtype == expected.dtype
            np.testing.assert_array_equal(found, expected, err_msg=field.name)
        elif field.name != "textures":
            assert found == expected, field.name
    assert loaded.triangles == TRIANGLES
    assert loaded.warnings


def test_a_scene_that_was_never_stored_is_not_there(
    cache: SceneCache, visuals: Visuals, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert cache.load(_path(cache, visuals)) is None
    assert not caplog.records


def _append(mesh: Path) -> None:
    times = mesh.stat()
    mesh.write_text(mesh.read_text() + "# longer\n")
    os.utime(mesh, ns=(times.st_atime_ns, times.st_mtime_ns))


def _touch(mesh: Path) -> None:
    os.utime(mesh, ns=(0, mesh.stat().st_mtime_ns + 1))


def _change_material(mesh: Path) -> None:
    (mesh.parent / "square.mtl").write_text("newmtl m\nKd 0.1 0.9 0.1\n")


def _put_texture(mesh: Path) -> None:
    (mesh.parent / "missing.png").write_bytes(b"now it is there")


@pytest.mark.parametrize("change", [_append, _touch, Path.unlink, _change_material, _put_texture])
def test_a_changed_file_invalidates_the_entry(cache: SceneCache, mesh: Path, kept: Path, change: Callable[[Path], None]) -> None:
    assert cache.load(kept) is not None
    change(mesh)
    assert cache.load(kept) is None


def test_every_input_of_the_result_changes_the_cache_file(
    cache: SceneCache, visuals: Visuals, monkeypatch: pytest.MonkeyPatch
) -> None:
    square = visuals[0]
    others = [
        replace(square, pose=Pose((0.0, 0.0, 1e-9))),
        replace(square, color=(1.0, 0.0, 0.0, 1.0)),
        replace(square, semantic_class="floor"),
        replace(square, shape=replace(square.shape, size=(1.0, 1.0, 2.0))),
        replace(square, appearance=Appearance(hue=0.1)),
    ]
    names = [_path(cache, visuals), _path(cache, visuals, levels_of_detail=False)]
    moving = (replace(square, link="a/b"),)
    names += [cache.path(moving, links, [(1, 1)], True) for links in ((), ("a/b",), ("c/d", "a/b"))]
    names += [cache.path(visuals, (), [(1, 2)], True), *(_path(cache, (other,)) for other in others)]
    monkeypatch.setattr(module, "_code_digest", lambda: "other code")
    names.append(_path(cache, visuals))
    monkeypatch.setattr(module, "simplifier", lambda: None)
    names.append(_path(cache, visuals))
    assert len(set(names)) == len(names)


def test_equal_scenes_have_the_same_file(cache: SceneCache, visuals: Visuals) -> None:
    assert _path(cache, visuals) == _path(cache, tuple(replace(v) for v in visuals))


@pytest.mark.parametrize("part", [0.0, 0.01, 0.3, 0.9, 0.9999])
def test_a_truncated_file_is_not_used_and_reported(
    cache: SceneCache, kept: Path, caplog: pytest.LogCaptureFixture, part: float
) -> None:
    content = kept.read_bytes()
    kept.write_bytes(content[: int(part * len(content))])
    with caplog.at_level(logging.WARNING):
        assert cache.load(kept) is None
    assert str(kept) in caplog.text


@pytest.mark.parametrize("seed", range(12))
def test_a_file_with_a_corrupt_header_is_not_used(
    cache: SceneCache, kept: Path, seed: int, caplog: pytest.LogCaptureFixture
) -> None:
    content = bytearray(kept.read_bytes())
    rng = np.random.default_rng(seed)
    start = 0 if seed == 0 else len(module._MAGIC) if seed == 1 else int(rng.integers(20, 400))
    content[start : start + 64] = rng.bytes(64)
    kept.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert cache.load(kept) is None
    assert "loaded from its files" in caplog.text


def test_a_pickle_of_another_type_is_not_used(cache: SceneCache, kept: Path, caplog: pytest.LogCaptureFixture) -> None:
    with kept.open("wb") as file:
        module._pack(file, ["not", "a", "scene"])
    with caplog.at_level(logging.WARNING):
        assert cache.load(kept) is None
    assert str(kept) in caplog.text


def test_a_folder_that_cannot_be_made_is_a_warning(tmp_path: Path, visuals: Visuals, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("in the way")
    cache = SceneCache(tmp_path / "file" / "cache")
    path = _path(cache, visuals)
    with caplog.at_level(logging.WARNING):
        assert cache.load(path) is None
        cache.store(path, _build(visuals))
    assert "cannot be cached" in caplog.text


def test_a_folder_that_cannot_be_written_to_is_a_warning(
    cache: SceneCache, visuals: Visuals, kept: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    # File permissions do not stop root, who may run this test.
    def refuse(*args: object, **kwargs: object) -> None:
        raise PermissionError(13, "Permission denied")

    content = kept.read_bytes()
    monkeypatch.setattr(module, "_pack", refuse)
    with caplog.at_level(logging.WARNING):
        cache.store(kept, _build(visuals))
    assert "cannot be cached" in caplog.text
    assert "Permission denied" in caplog.text
    assert [file.name for file in kept.parent.iterdir()] == [kept.name], "nothing half-written is left"
    assert kept.read_bytes() == content


def test_a_small_scene_is_not_kept(cache: SceneCache, visuals: Visuals, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SMALLEST", TRIANGLES + 1)
    path = _path(cache, visuals)
    cache.store(path, _build(visuals))
    assert not path.parent.exists()


def test_the_least_recently_used_file_is_deleted_first(tmp_path: Path, visuals: Visuals) -> None:
    scenes = [(replace(visuals[0], name=f"square {k}"),) for k in range(4)]
    large = SceneCache(tmp_path / "cache")
    paths = [_path(large, scene) for scene in scenes]
    for k in range(3):
        large.store(paths[k], _build(scenes[k]))
        os.utime(paths[k], ns=(0, (k + 1) * 10**9))
    assert large.load(paths[0]) is not None  # recently used
    size = paths[0].stat().st_size
    small = SceneCache(tmp_path / "cache", limit_bytes=int(2.5 * size))
    small.store(paths[3], _build(scenes[3]))
    assert [path.is_file() for path in paths] == [True, False, False, True]


def test_one_scene_above_the_limit_is_kept_alone(tmp_path: Path, visuals: Visuals) -> None:
    cache = SceneCache(tmp_path / "cache", limit_bytes=1)
    other = (replace(visuals[0], name="other"),)
    for k, scene in enumerate((visuals, other)):
        cache.store(_path(cache, scene), _build(scene))
        os.utime(_path(cache, scene), ns=(0, (k + 1) * 10**9))
    assert cache.load(_path(cache, visuals)) is None
    assert cache.load(_path(cache, other)) is not None


def test_the_folder_is_where_the_desktop_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert default_folder() == Path("/somewhere/gibson-sim/scenes")


def test_links_behind_those_that_are_drawn_change_no_file(cache: SceneCache, visuals: Visuals) -> None:
    moving = (replace(visuals[0], link="a/b"),)
    assert cache.path(moving, ("a/b",), [(1, 1)], True) == cache.path(moving, ("a/b", "view_follow"), [(1, 1)], True)
