"""One process at a time makes an output folder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from gibson_sim.errors import SceneError, WriteError
from gibson_sim.processes.folder_lock import locked_folder

HOLDER = """
import os, sys
from pathlib import Path
from gibson_sim.errors import SceneError
from gibson_sim.processes.folder_lock import locked_folder
with locked_folder(Path(sys.argv[1]), SceneError("in use")):
    print("locked", flush=True)
    sys.stdin.readline()
    os.kill(os.getpid(), 9)
"""


def test_another_process_is_refused_until_the_first_one_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "out"
    command = [sys.executable, "-c", HOLDER, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdin is not None and holder.stdout is not None
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(SceneError, match=r"^in use$"), locked_folder(folder, SceneError("in use")):
            raise AssertionError("it is locked")
        holder.stdin.write("\n")
        holder.stdin.flush()
        assert holder.wait() == -9
    with locked_folder(folder, SceneError("in use")):
        assert list(folder.iterdir()) == []


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    with pytest.raises(WriteError, match=r"out: Not a directory$"), locked_folder(tmp_path / "out", SceneError("in use")):
        raise AssertionError("it is a file")
