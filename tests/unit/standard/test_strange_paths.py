"""Any source that a client names gets an answer soon; an invalid one is reported as the client's error."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.errors import GibsonSimError
from gibson_sim.scenes import sources
from gibson_sim.scenes.sources import walk
from gibson_sim.scenes.spawning import load_spawnable, spawn_name
from gibson_sim.standard import catalogue
from gibson_sim.standard.filters import TagsFilter
from gibson_sim.types import Pose

STRANGE = (
    "/", "/proc", "../..", "/dev", "/proc/self/fd", "a\0b", "\ud800", "x" * 10**6, "", ".", "a\nb", "~nobody/\0", "file:///a%00b",
    "package://__main__/x", "~" + "x" * 300, "model://\0", "package://../../x",
)  # fmt: skip


def _answers(ask: Callable[[], object]) -> None:
    listed = []
    scandir = os.scandir

    def counted(*args: Any) -> Any:
        listed.append(args)
        return scandir(*args)

    with suppress(GibsonSimError), pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "scandir", counted)
        ask()
    assert len(listed) <= sources._MAX_ENTRIES, "it searched everything"


def _read_bytes() -> int:
    """Returns how many bytes this process has read from files so far."""
    return int(re.findall(r"^rchar: (\d+)", Path("/proc/self/io").read_text(), re.MULTILINE)[0])


@pytest.mark.parametrize("source", STRANGE, ids=lambda source: ascii(source)[:20])
def test_any_source_is_answered(source: str) -> None:
    _answers(lambda: catalogue.spawnables((source,)))
    _answers(lambda: catalogue.available_worlds((source,), TagsFilter(), continue_on_error=False))


@pytest.mark.parametrize("uri", STRANGE, ids=lambda uri: ascii(uri)[:20])
def test_any_uri_to_spawn_is_answered(uri: str) -> None:
    _answers(lambda: spawn_name(uri, ""))
    _answers(lambda: load_spawnable(uri, "", name="x", pose=Pose()))


def test_pipe_in_a_folder_is_not_waited_for(tmp_path: Path) -> None:
    for name in ("a.sdf", "scene.yaml", "robot.yaml", "model.config", "b.urdf", "c.glb"):
        os.mkfifo(tmp_path / name)
    _answers(lambda: catalogue.spawnables((str(tmp_path),)))
    _answers(lambda: catalogue.available_worlds((str(tmp_path),), TagsFilter(), continue_on_error=False))


def test_search_ends_after_so_many_entries_and_levels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path.joinpath(*["d"] * 20)
    deep.mkdir(parents=True)
    assert len(list(walk(tmp_path))) == sources._MAX_LEVELS + 1
    monkeypatch.setattr(sources, "_MAX_ENTRIES", 5)
    with pytest.raises(GibsonSimError, match="more than 5 files and folders"):
        list(walk(tmp_path))


def test_folders_full_of_large_descriptions_are_listed_briefly_and_not_read_whole(tmp_path: Path) -> None:
    for k in range(50):
        (tmp_path / f"w{k}").mkdir()
        (tmp_path / f"w{k}" / "scene.yaml").write_text(f"name: world {k}\nobjects:\n" + "- a\n" * 60_000)
        (tmp_path / f"m{k}").mkdir()
        (tmp_path / f"m{k}" / "model.config").write_text("<model>" + "<a/>" * 100_000 + "</model>")
    (tmp_path / "long").mkdir()
    (tmp_path / "long" / "scene.yaml").write_text(f"name: {'n' * 5000}\ndescription: {'d' * 3000}")
    (tmp_path / "told").mkdir()
    (tmp_path / "told" / "model.config").write_text(f"<model><description>{'d' * 50_000}</description></model>")
    before = _read_bytes()
    worlds = catalogue.available_worlds((str(tmp_path),), TagsFilter(), continue_on_error=False)
    things, _ = catalogue.spawnables((str(tmp_path),))
    assert _read_bytes() - before < 10 * 2**20, "the descriptions have 30 MiB: they were read whole"
    assert len([world for world in worlds if world.uri.startswith("file:")]) == 51
    assert "world 17" in {world.name for world in worlds}
    assert len([thing for thing in things if thing.uri.startswith("file:")]) == 51
    assert max(len(text) for world in worlds for text in (world.name, world.description)) < 1000
    assert max(len(thing.description) for thing in things) < 1000


def test_folders_of_one_request_count_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_MAX_ENTRIES", 50)
    for k in range(10):
        (tmp_path / f"{k}").mkdir()
        for name in "abcdefghi":
            (tmp_path / f"{k}" / f"{name}.glb").touch()
    folders = tuple(str(tmp_path / f"{k}") for k in range(10))
    found, remark = catalogue.spawnables(folders)
    assert len([thing for thing in found if thing.uri.startswith("file:")]) == 45
    assert "is left out: 50 files and folders were searched" in remark
    with pytest.raises(GibsonSimError, match="is left out: 50 files"):
        catalogue.available_worlds(folders, TagsFilter(), continue_on_error=False)
