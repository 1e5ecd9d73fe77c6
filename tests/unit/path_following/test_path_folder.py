"""A path is written whole and read as it was; a folder of a stranger is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.errors import PathFolderError
from gibson_path_following.path_folder import check_path, load_path, save_path
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


def test_a_folder_is_not_overwritten_unless_it_is_a_path_and_that_is_wanted(tmp_path: Path) -> None:
    save_path(straight_path(3), tmp_path / "a")
    with pytest.raises(PathFolderError, match=r"cannot write .*a: it exists; give a new folder"):
        save_path(straight_path(2), tmp_path / "a")
    save_path(straight_path(2), tmp_path / "a", replace=True)
    assert len(load_path(tmp_path / "a").nodes) == 2
    (tmp_path / "mine").mkdir()
    with pytest.raises(PathFolderError, match=r"cannot write .*mine: it exists without a path in it"):
        save_path(straight_path(2), tmp_path / "mine", replace=True)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "mine"]


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PathFolderError, match=r"cannot write .*file/a: "):
        save_path(straight_path(2), tmp_path / "file" / "a")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


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
