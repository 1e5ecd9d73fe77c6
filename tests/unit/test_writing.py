"""Files are written completely or not at all, with the reason."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import WriteError
from gibson_sim.picture_files import write_array, write_picture
from gibson_sim.writing import cannot_write, check_writable, replacing, size_text, write_file


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Makes the system refuse writes that extend a file, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    writes_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # it would be cut off by the limit, too
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = writes_no_bytecode


def test_failed_write_keeps_the_existing_file(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    write_file(file, "old")
    with largest_file(100), pytest.raises(WriteError, match=r"cannot write .*a\.json: File too large \(needs 1\.0 KB or more\)"):
        write_file(file, b"x" * 1000)
    assert file.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.npy"])
def test_picture_that_does_not_fit_leaves_nothing(tmp_path: Path, name: str) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (40, 40, 3), dtype=np.uint8)
    with largest_file(100), pytest.raises(WriteError, match="cannot write"):
        (write_array if name.endswith("npy") else write_picture)(tmp_path / name, pixels)
    assert os.listdir(tmp_path) == []


def test_full_disk_error_states_required_and_free_space(tmp_path: Path) -> None:
    said = str(cannot_write(tmp_path / "a", OSError(errno.ENOSPC, "No space left on device"), 12_300_000))
    assert "No space left on device (needs 12.3 MB or more, free " in said
    assert said.endswith("; free disk space, or choose another folder")


@pytest.mark.parametrize(("size", "said"), [(0, "0 bytes"), (999, "999 bytes"), (1000, "1.0 KB"), (2_500_000_000, "2.5 GB")])
def test_sizes_are_formatted_in_a_suitable_unit(size: int, said: str) -> None:
    assert size_text(size) == said


def test_failed_block_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with replacing(tmp_path / "new/a.txt") as draft:
            draft.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert os.listdir(tmp_path / "new") == []


def test_symbolic_link_and_permissions_are_kept(tmp_path: Path) -> None:
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "real.txt").chmod(0o640)
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_file(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"
    assert (tmp_path / "real.txt").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("name", "said"),
    [("", "Is a directory"), ("file/a", "Not a directory"), ("a\0b", "null byte"), ("x" * 300, "File name too long")],
)
def test_unwritable_destination_is_named(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match=said):
        write_file(tmp_path / name, "x")


def test_picture_of_no_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match=r"its suffix is that of no image format; the name must end in \.png, \.jpg, \.jpeg"):
        write_picture(tmp_path / "a.pnk", np.zeros((2, 2, 3), dtype=np.uint8))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="SKIPPED: no /dev/full here")
def test_device_file_is_written_in_place(tmp_path: Path) -> None:
    write_file("/dev/null", "x")
    assert not Path("/dev/null").is_file()
    with pytest.raises(WriteError, match="cannot write /dev/full: No space left on device"):
        write_file("/dev/full", "x")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="SKIPPED: no /dev/full here")
@pytest.mark.parametrize("words", [("params", "physics"), ("params", "drive")])
def test_output_that_cannot_be_printed_is_reported_in_one_line(words: tuple[str, ...]) -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "gibson_sim.cli.main", *words]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert done.stderr.startswith("gibson-sim: error: cannot write the output: No space left on device")


def test_a_check_of_a_file_writes_nothing_and_keeps_the_existing_one(tmp_path: Path) -> None:
    file = tmp_path / "new" / "a.json"
    check_writable(file)
    assert os.listdir(file.parent) == []
    file.write_text("old")
    check_writable(file)
    assert os.listdir(file.parent) == ["a.json"] and file.read_text() == "old"
    with pytest.raises(WriteError, match="Is a directory"):
        check_writable(tmp_path)
