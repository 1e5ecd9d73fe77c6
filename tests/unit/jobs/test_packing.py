"""Files and folders that travel by the digests of their contents."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.jobs import packing
from gibson_sim.jobs.packing import Contents, Entry, FileCache, digest_of, entries_of, unpack

ABC = "bddd813c634239723171ef3fee98579b94964e3bb1cb3e427262c8c068d52319"
"""BLAKE2b of "abc" with 32 bytes, as `b2sum -l 256` prints it."""
LIMIT = 1000


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "hall"
    (folder / "meshes" / "empty").mkdir(parents=True)
    (folder / "scene.yaml").write_text("abc")
    (folder / "meshes" / "a.obj").write_text("abc")
    (folder / "run.sh").write_text("#!/bin/sh\n")
    (folder / "run.sh").chmod(0o755)
    (folder / "meshes" / "link").symlink_to("../scene.yaml")
    return folder


def packed(root: Path, *, limit: int = LIMIT, links_may_leave: bool = False) -> tuple[tuple[Entry, ...], Contents]:
    contents: Contents = {}
    return entries_of(root, contents.__setitem__, limit_bytes=limit, links_may_leave=links_may_leave), contents


def test_a_folder_is_its_entries_and_each_content_once(scene: Path) -> None:
    entries, contents = packed(scene)
    run = digest_of(b"#!/bin/sh\n")
    assert entries == (
        Entry("", "folder"),
        Entry("meshes", "folder"),
        Entry("meshes/a.obj", "file", ABC),
        Entry("meshes/empty", "folder"),
        Entry("meshes/link", "link", "../scene.yaml"),
        Entry("run.sh", "file", run, True),
        Entry("scene.yaml", "file", ABC),
    )
    assert contents == {ABC: b"abc", run: b"#!/bin/sh\n"}


def test_a_file_is_one_entry(scene: Path) -> None:
    assert packed(scene / "scene.yaml") == ((Entry("", "file", ABC),), {ABC: b"abc"})


def test_unpacked_files_are_those_that_were_packed(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    unpack(tmp_path / "copy", *packed(scene))
    assert packed(tmp_path / "copy") == packed(scene)


def test_a_cache_fetches_missing_files_and_returns_a_read_only_tree(scene: Path, tmp_path: Path) -> None:
    entries, contents = packed(scene)
    fetched: list[list[str]] = []

    def fetch(digests: list[str]) -> Contents:
        fetched.append(sorted(digests))
        return {digest: contents[digest] for digest in digests}

    cache = FileCache(tmp_path / "cache")
    place = cache.store("hall", entries, fetch)
    assert place.name == "hall"
    assert packed(place) == (entries, contents)
    assert (place / "scene.yaml").stat().st_mode & 0o777 == 0o444
    assert (place / "run.sh").stat().st_mode & 0o777 == 0o555
    assert cache.store("hall", entries, fetch) == place
    file = cache.store("other.yaml", (Entry("", "file", ABC),), fetch)
    assert (file.name, file.read_text()) == ("other.yaml", "abc")
    assert fetched == [sorted(contents)]


def test_a_cache_mends_a_damaged_content(tmp_path: Path) -> None:
    cache = FileCache(tmp_path)
    cache.store("a", (Entry("", "file", ABC),), lambda _: {ABC: b"abc"})
    (tmp_path / "contents" / ABC).chmod(0o644)
    (tmp_path / "contents" / ABC).write_text("ab")
    assert cache.store("b", (Entry("", "file", ABC),), lambda _: {ABC: b"abc"}).read_text() == "abc"


def test_a_content_that_changed_on_the_way_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GibsonSimError, match="x was damaged in transfer"):
        unpack(tmp_path, (Entry("x", "file", ABC),), {ABC: b"abd"})
    with pytest.raises(GibsonSimError, match="x was damaged in transfer"):
        FileCache(tmp_path / "cache").store("hall", (Entry("x", "file", ABC),), lambda _: {ABC: b"abd"})
    assert sorted(path.name for path in (tmp_path / "cache").rglob("*")) == ["contents", "trees"]


@pytest.mark.parametrize("target", ["/etc/hostname", "../../outside", "../through/../outside"])
def test_a_link_that_leaves_the_folder_is_refused_in_what_a_unit_reads(scene: Path, target: str) -> None:
    (scene.parent / "outside").write_text("secret")
    (scene / "through").symlink_to("meshes/..")
    (scene / "meshes" / "outside").symlink_to(target)
    with pytest.raises(ConfigError, match=r"outside is a link to '.*', outside of .*/hall: put a copy there"):
        packed(scene)


def test_links_of_what_a_unit_wrote_stay_links(scene: Path, tmp_path: Path) -> None:
    (scene / "out").symlink_to("/etc/hostname")
    entries, contents = packed(scene, links_may_leave=True)
    (tmp_path / "copy").mkdir()
    unpack(tmp_path / "copy", entries, contents)
    assert os.readlink(tmp_path / "copy" / "out") == "/etc/hostname"


def test_nothing_is_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "copy").mkdir()
    entries = (Entry("a", "link", "../elsewhere"), Entry("a/x", "file", ABC))
    with pytest.raises(GibsonSimError, match="copy/a: File exists"):
        unpack(tmp_path / "copy", entries, {ABC: b"abc"})
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("path", ["../x", "/x", "a/../../x", "a\0"])
def test_a_path_that_leaves_the_folder_is_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(GibsonSimError, match=r"an entry has the path .*, which leads out of its folder"):
        unpack(tmp_path, (Entry(path, "file", ABC),), {ABC: b"abc"})


def test_too_much_is_refused(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(packed(scene, limit=16)[0]) == 7
    with pytest.raises(ConfigError, match="/hall has more than 15 bytes; name a smaller folder, or allow more"):
        packed(scene, limit=15)
    monkeypatch.setattr(packing, "MAX_ENTRIES", 6)
    with pytest.raises(ConfigError, match="/hall has more than 6 files and folders"):
        packed(scene)


def test_a_pipe_is_refused_in_what_a_unit_reads_and_left_out_of_what_it_wrote(scene: Path) -> None:
    os.mkfifo(scene / "pipe")
    with pytest.raises(ConfigError, match="/hall/pipe is neither a file nor a folder"):
        packed(scene)
    assert "pipe" not in [entry.path for entry in packed(scene, links_may_leave=True)[0]]
