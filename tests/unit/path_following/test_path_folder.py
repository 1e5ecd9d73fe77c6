"""A path is written completely and read back equal; an untrusted folder is refused in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.errors import PathFolderError
from gibson_path_following.paths import path_folder
from gibson_path_following.paths.path_folder import (
    PathWriter,
    check_folder,
    check_path,
    load_path,
    max_nodes,
    new_folder,
    save_path,
)
from gibson_path_following.types import PathNode, RecordedPath, Velocity
from support.path_views import STEP_NS, fisheye_view, straight_path


def test_a_path_is_read_as_it_was_written(tmp_path: Path) -> None:
    before = straight_path(3, angular=0.125)
    before = replace(before, nodes=(*before.nodes[:2], replace(before.nodes[2], pose=None, velocities=())))
    save_path(before, tmp_path / "kitchen")
    after = load_path(tmp_path / "kitchen")
    assert (after.camera, after.spacing, after.length) == ("pinhole", 0.2, 0.4)
    assert after.hfov == pytest.approx(before.hfov, abs=1e-7)
    for a, b in zip(after.nodes, before.nodes, strict=True):
        assert (a.stamp_ns, a.distance, a.velocities, a.pose) == (b.stamp_ns, b.distance, b.velocities, b.pose)
        assert np.array_equal(a.view[0], b.view[0])
    assert sorted(file.name for file in (tmp_path / "kitchen").iterdir()) == [
        "images",
        "nodes.csv",
        "path.yaml",
        "velocities.csv",
    ]


def test_both_fisheyes_are_kept(tmp_path: Path) -> None:
    nodes = tuple(PathNode(fisheye_view(i), i * STEP_NS, 0.2 * i, ((0, Velocity(0.4)),)) for i in range(2))
    save_path(RecordedPath("fisheye_pair", 3.1, nodes), tmp_path / "hall")
    assert (tmp_path / "hall/images/000001_back.png").is_file()
    assert np.array_equal(load_path(tmp_path / "hall").nodes[1].view[1], nodes[1].view[1])


def test_only_the_folder_of_a_path_is_overwritten_and_only_on_request(tmp_path: Path) -> None:
    save_path(straight_path(3), tmp_path / "a")
    with pytest.raises(PathFolderError, match=r"cannot write .*a: it exists; give a new folder"):
        save_path(straight_path(2), tmp_path / "a")
    save_path(straight_path(2), tmp_path / "a", replace=True)
    assert len(load_path(tmp_path / "a").nodes) == 2
    (tmp_path / "mine").mkdir()
    with pytest.raises(PathFolderError, match=r"cannot write .*mine: it exists without a path in it"):
        save_path(straight_path(2), tmp_path / "mine", replace=True)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "mine"]


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PathFolderError, match=r"cannot write .*file/a: "):
        save_path(straight_path(2), tmp_path / "file" / "a")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_an_older_path_stays_if_the_new_one_cannot_take_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_path(straight_path(3), tmp_path / "a")
    rename = Path.rename

    def fail_for_the_draft(self: Path, target: Path) -> Path:
        if self.suffix == ".part":
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_for_the_draft)
    with pytest.raises(PathFolderError, match=r"cannot write .*a: Input/output error"):
        save_path(straight_path(2), tmp_path / "a", replace=True)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"] and len(load_path(tmp_path / "a").nodes) == 3


@pytest.mark.parametrize("name", ["notes.txt", "images/notes.txt"])
def test_a_folder_that_holds_other_files_is_not_replaced(tmp_path: Path, name: str) -> None:
    save_path(straight_path(3), tmp_path / "a")
    (tmp_path / "a" / name).write_text("mine")
    for write in (
        lambda: check_folder(tmp_path / "a", replace=True),
        lambda: save_path(straight_path(2), tmp_path / "a", replace=True),
    ):
        with pytest.raises(PathFolderError, match=f"a: it holds '{name}' besides a path, which would be deleted; move that away"):
            write()
    assert (tmp_path / "a" / name).read_text() == "mine"


def test_a_path_of_another_recorder_that_was_faster_is_not_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = path_folder._write

    def write_late(path: RecordedPath, draft: Path) -> None:
        write(path, draft)
        (tmp_path / "a").mkdir()

    monkeypatch.setattr(path_folder, "_write", write_late)
    with pytest.raises(PathFolderError, match=r"a: it exists; give a new folder"):
        save_path(straight_path(2), tmp_path / "a")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


def _names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_folder_has_one_writer_at_a_time(tmp_path: Path) -> None:
    with PathWriter(tmp_path / "a", replace=True) as writer:
        (tmp_path / "link").symlink_to("a")
        for folder in (tmp_path / "a", tmp_path / "link"):
            line = f"cannot write {folder}: another recorder has this folder; end that one, or give another folder"
            with pytest.raises(PathFolderError, match=f"^{line}$"):
                PathWriter(folder, replace=True)
        save_path(straight_path(2), tmp_path / "b")
        writer.write(straight_path(3))
        writer.write(straight_path(4))
    save_path(straight_path(2), tmp_path / "a", replace=True)
    assert _names(tmp_path) == ["a", "b", "link"]


KILLED = """
import os, signal, sys
from gibson_path_following.paths import path_folder
from support.path_views import straight_path

name, done = sys.argv[1], getattr(path_folder, sys.argv[1])
def killed(*args):
    done(*args)
    os.kill(os.getpid(), signal.SIGKILL)
setattr(path_folder, name, killed)
with path_folder.PathWriter(sys.argv[2], replace=True) as writer:
    writer.write(straight_path(2))
"""
"""Ends by SIGKILL after a function of ``path_folder`` that it calls while it writes a path."""


def _kill(function: str, folder: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run([sys.executable, "-c", KILLED, function, str(folder)], env=environment, check=False)
    assert ended.returncode == -signal.SIGKILL


@pytest.mark.parametrize("function", ["_write", "check_path"])
def test_remains_of_a_killed_writer_are_removed_and_those_of_a_running_one_stay(tmp_path: Path, function: str) -> None:
    with PathWriter(tmp_path / "running") as running:
        running._draft.mkdir()
        _kill(function, tmp_path / "killed")
        left = {file.suffix for file in tmp_path.iterdir() if file.stem != running._draft.stem}
        assert left == ({".part", ".lock"} if function == "_write" else {".lock"})
        PathWriter(tmp_path / "other").close()
        assert _names(tmp_path) == [running._draft.with_suffix(".lock").name, running._draft.name]


def test_an_older_path_that_a_killed_writer_had_moved_away_is_restored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    save_path(straight_path(3), tmp_path / "a")
    with PathWriter(tmp_path / "a", replace=True) as writer:
        (tmp_path / "a").rename(writer._old)
    with pytest.raises(PathFolderError, match=r"a: it exists; give a new folder, or set replace to true"):
        PathWriter(tmp_path / "a")
    assert _names(tmp_path) == ["a"] and len(load_path(tmp_path / "a").nodes) == 3
    assert caplog.messages == [
        f"{tmp_path / 'a'}: restored the older path, which a recorder that was killed had not replaced yet"
    ]


def test_a_link_to_a_path_stays_one_that_leads_to_the_new_path(tmp_path: Path) -> None:
    save_path(straight_path(3), tmp_path / "monday")
    (tmp_path / "newest").symlink_to("monday")
    save_path(straight_path(2), tmp_path / "newest", replace=True)
    assert (tmp_path / "newest").is_symlink() and len(load_path(tmp_path / "monday").nodes) == 2


def test_names_of_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    save_path(straight_path(2), "~/deeper/kitchen")
    assert len(load_path(tmp_path / "deeper/kitchen").nodes) == len(load_path("~/deeper/kitchen").nodes) == 2
    save_path(straight_path(2), tmp_path / ("n" * 255))
    monkeypatch.chdir(tmp_path)
    for name, words in (
        (".", "it exists; give a new folder"),
        ("..", "it exists; give a new folder"),
        ("/", "it exists; give a new folder"),
        ("n" * 256, "File name too long; give another folder"),
        ("a\0b", "embedded null byte; give another folder"),
        ("/proc/path", "No such file or directory; give another folder"),  # no permission tells
        ("deeper/kitchen/path.yaml/a", "path.yaml is not a folder; give another folder"),
    ):
        with pytest.raises(PathFolderError, match=words):
            check_folder(name)
    with pytest.raises(PathFolderError, match="it exists without a path in it"):
        check_folder("/", replace=True)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["deeper", "n" * 255]


def test_a_new_folder_beside_another_has_the_next_number(tmp_path: Path) -> None:
    for number in (2, 3):
        assert new_folder(tmp_path / "a") == tmp_path / f"a-{number}"
        (tmp_path / f"a-{number}").mkdir()


def _edit(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return edit


def _cut_image(folder: Path) -> None:
    file = folder / "images/000001_front.png"
    file.write_bytes(file.read_bytes()[:60])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda folder: (folder / "path.yaml").unlink(),
            r"path\.yaml: No such file or directory; give a folder that was recorded",
        ),
        (
            _edit("path.yaml", "format: 1", "format: 2"),
            r"path\.yaml: format is 2, this version reads 1; update gibson_path_following",
        ),
        (_edit("path.yaml", "format: 1", "format: true"), r"path\.yaml: format is True, must be 1; record the path again"),
        (_edit("path.yaml", "format: 1", "format: 1.0"), r"path\.yaml: format is 1\.0, must be 1; record the path again"),
        (
            _edit("path.yaml", "format: 1", "format: !!timestamp foo"),
            r"path\.yaml is not YAML .*: aliases and tags are not allowed",
        ),
        (_edit("path.yaml", "hfov_deg: 100.0", "hfov_deg: 400"), r"path\.yaml: hfov_deg is 400, must be a number from 1 to 179"),
        (_edit("path.yaml", "hfov_deg: 100.0", "hfov_deg: .nan"), r"path\.yaml: hfov_deg is nan, must be a number from 1 to 179"),
        (_edit("path.yaml", "camera: pinhole", "camera: [a]"), r"path\.yaml: camera is \['a'\], must be one of pinhole, fisheye"),
        (_edit("path.yaml", "camera:", "lens:"), r"path\.yaml: 'lens' is unknown; known: format, camera"),
        (_edit("path.yaml", "width: 96", ""), r"path\.yaml: width is missing; needed: format"),
        (_edit("path.yaml", "nodes: 3", "nodes: 4"), r"nodes\.csv has 3 nodes, but path\.yaml says 4"),
        (_edit("path.yaml", "nodes: 3", "nodes: 20000"), r"nodes\.csv has 3 nodes, but path\.yaml says 20000"),
        (
            _edit("path.yaml", "format: 1", "format: &a [*a]"),
            r"path\.yaml is not YAML that can be read: aliases and tags are not",
        ),
        (_edit("path.yaml", "width: 96", "width: 48"), r"front\.png has 96x64 pixels, but path\.yaml says 48x64"),
        (_edit("nodes.csv", "node,stamp_ns", "id,stamp_ns"), r"nodes\.csv: its first line must be node,stamp_ns"),
        (_edit("nodes.csv", "1,500000000", "2,500000000"), r"nodes\.csv, line 3: node is '2', must be 1"),
        (
            _edit("nodes.csv", "1,500000000,0.2", "1,500000000,inf"),
            r"nodes\.csv, line 3: distance_m is 'inf', must be a number of",
        ),
        (
            _edit("nodes.csv", "1,500000000,0.2", "1,500000000,1e308"),
            r"line 3: distance_m is '1e308', must be a number of at most 1e\+08",
        ),
        (lambda folder: (folder / "nodes.csv").write_bytes(b"\xff\xfe\x00"), r"nodes\.csv is not a CSV file in UTF-8: "),
        (_edit("nodes.csv", "1,500000000", "1,0"), r"nodes\.csv, line 3: stamp_ns must grow"),
        (_edit("velocities.csv", "1,0,0.4", "9,0,0.4"), r"velocities\.csv, line 3: node is 9, must be 0 to 2"),
        (_edit("velocities.csv", "1,0,0.4", "1,0"), r"velocities\.csv, line 3: 3 values, must be 4"),
        (lambda folder: (folder / "images/000002_front.png").write_bytes(b"GIF89a"), r"000002_front\.png is not a PNG image"),
        (_cut_image, r"000001_front\.png is a broken PNG image"),
    ],
)
def test_a_broken_folder_is_refused_in_one_line(tmp_path: Path, spoil: Callable[[Path], None], words: str) -> None:
    save_path(straight_path(3), tmp_path / "a")
    spoil(tmp_path / "a")
    with pytest.raises(PathFolderError, match=words) as caught:
        load_path(tmp_path / "a")
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_and_a_blank_last_line_do_no_harm(tmp_path: Path) -> None:
    save_path(straight_path(3), tmp_path / "a")
    for name in ("nodes.csv", "velocities.csv"):
        file = tmp_path / "a" / name
        file.write_text(file.read_text() + "\r\n\n", encoding="utf-8-sig")
    assert len(load_path(tmp_path / "a").nodes) == 3


def test_a_path_must_have_nodes_that_belong_together() -> None:
    path = straight_path(3)
    with pytest.raises(PathFolderError, match=r"a path has 2 to 20000 nodes, this one 1"):
        check_path(replace(path, nodes=path.nodes[:1]))
    small = replace(path.nodes[1], view=(path.nodes[1].view[0][:32],))
    with pytest.raises(PathFolderError, match=r"an image of node 1 is \(32, 96, 3\) uint8, the first one is \(64, 96, 3\)"):
        check_path(replace(path, nodes=(path.nodes[0], small, path.nodes[2])))
    with pytest.raises(PathFolderError, match=r"node 1: stamps must grow"):
        check_path(replace(path, nodes=path.nodes[::-1]))
    with pytest.raises(PathFolderError, match=r"node 0 has 1 images, a fisheye_pair camera has 2"):
        check_path(replace(path, camera="fisheye_pair"))


def test_a_path_is_written_only_within_the_limits_of_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = straight_path(3)
    last = path.nodes[2]
    for spoilt, words in (
        (replace(path, hfov=3.5), "hfov_deg is 200.535228, must be a number from 1 to 179"),
        (replace(path, spacing=0.0), "spacing_m is 0.0, must be a number from 0.001 to 100"),
        (replace(path, nodes=(*path.nodes[:2], replace(last, distance=float("inf")))), "the distance of node 2 is inf, must be"),
        (replace(path, nodes=(*path.nodes[:2], replace(last, pose=(0.0, 1e308, 0.0)))), r"the y of node 2 is 1e\+308, must be"),
        (
            replace(path, nodes=(*path.nodes[:2], replace(last, velocities=((0, Velocity(0.0, 1e9)),)))),
            "the velocity of node 2 is",
        ),
        (
            replace(path, nodes=tuple(replace(node, view=(node.view[0][:4],)) for node in path.nodes)),
            "height is 4, must be a whole",
        ),
    ):
        with pytest.raises(PathFolderError, match=f"cannot write .*a: {words}"):
            save_path(spoilt, tmp_path / "a")
    monkeypatch.setattr(path_folder, "MAX_PIXELS", 2 * 96 * 64)
    assert max_nodes("pinhole", 96, 64) == 2 and max_nodes("fisheye_pair", 96, 64) == 1
    save_path(straight_path(2), tmp_path / "a")
    with pytest.raises(PathFolderError, match="its images have 0 megapixels, at most 0 are read; record smaller ones"):
        check_path(path)
    monkeypatch.setattr(path_folder, "MAX_VELOCITIES", 2)
    with pytest.raises(PathFolderError, match="a path has at most 2 velocities, this one 3; record shorter ones"):
        check_path(path)


def test_as_many_velocities_as_are_written_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_folder, "MAX_VELOCITIES", 1000)
    longest = Velocity(-1.2345678901234567e-101, -1.2345678901234567e-102)
    path = straight_path(2)
    first = replace(path.nodes[0], velocities=tuple((10**18 + k, longest) for k in range(999)))
    save_path(replace(path, nodes=(first, path.nodes[1])), tmp_path / "a")
    assert load_path(tmp_path / "a").nodes[0].velocities == first.velocities
