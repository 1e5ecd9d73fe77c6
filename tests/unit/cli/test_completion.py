"""Completion of command lines: by argcomplete's protocol, and in a real bash."""

from __future__ import annotations

import os
import pty
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from support.completion import completions


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("gibson-sim sna", {"snapshot"}),
        ("gibson-sim param", {"param", "params"}),
        ("gibson-sim sn drive", set()),
        ("gibson-sim run --compression ", {"none", "zstd", "lz4"}),
        ("gibson-sim run --scene lind", {"linden_flat"}),
        ("gibson-sim run --robot omni", {"omni_bot"}),
        ("gibson-sim run --duration ", set()),
        ("gibson-sim drive sq", {"square"}),
        ("gibson-sim run --drive to", {"tour"}),
        ("gibson-sim load orch", {"orchard_house"}),
        ("gibson-sim spawn bottle_", {"bottle_water", "bottle_wine"}),
        ("gibson-sim spawn bottle_water --at 1,2 --na", {"--name"}),
        ("gibson-sim completion ", {"bash", "zsh", "fish"}),
        ("gibson-sim topic ec", {"echo"}),
        ("gibson-sim scene map har", {"harbour_flat"}),
        ("gibson-sim top --no-such-option x", set()),
    ],
)
def test_built_in_names_are_completed(line: str, found: set[str], tmp_path: Path) -> None:
    assert completions(line, tmp_path) == (found, "")


def test_commands_of_other_packages_are_completed(tmp_path: Path) -> None:
    assert {"bench", "run", "scene", "topic"} <= completions("gibson-sim ", tmp_path)[0]
    assert {"map", "view", "import"} <= completions("gibson-sim scene ", tmp_path)[0]


def test_files_are_completed_where_a_scene_may_be_one(tmp_path: Path) -> None:
    (tmp_path / "my_world.sdf").touch()
    assert completions("gibson-sim run --scene my_", tmp_path) == ({"my_world.sdf"}, "")


@pytest.mark.parametrize("line", ["gibson-sim topic echo ", "gibson-sim param get /physics "])
def test_malformed_environment_prints_no_completions(line: str, tmp_path: Path) -> None:
    assert completions(line, tmp_path, ROS_DOMAIN_ID="no number") == (set(), "")
    assert completions(line, tmp_path, COMP_POINT="no number") == (set(), "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_there_is_a_script_for_each_shell(shell: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gibson_sim.cli.main", "completion", shell], capture_output=True, text=True, check=True
    )
    assert "_ARGCOMPLETE" in done.stdout and "gibson-sim" in done.stdout
    program = shutil.which(shell)
    if program:
        checked = subprocess.run([program, "-n"], input=done.stdout, capture_output=True, text=True, check=False)
        assert (checked.returncode, checked.stderr) == (0, "")


class _Terminal:
    """An interactive bash."""

    def __init__(self, folder: Path) -> None:
        self._master, slave = pty.openpty()
        environment = {
            **os.environ,
            "HOME": str(folder),
            "TERM": "dumb",
            "PATH": f"{Path(sys.prefix) / 'bin'}:{os.environ['PATH']}",
        }
        command = ["bash", "--norc", "--noprofile", "-i"]
        self._process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, env=environment, cwd=folder, start_new_session=True
        )
        os.close(slave)

    def type(self, keys: str, until: str) -> str:
        """Types keys and returns what appears, once ``until`` has; fails after a minute without it."""
        os.write(self._master, keys.encode())
        seen, ends = "", time.monotonic() + 60.0
        while until not in seen:
            assert time.monotonic() < ends, seen
            if select.select([self._master], [], [], 1.0)[0]:
                seen += os.read(self._master, 65536).decode(errors="replace")
        return seen

    def close(self) -> None:
        """Ends it."""
        self._process.kill()
        self._process.wait()
        os.close(self._master)


def test_bash_completes_a_scene_after_env_sh(root: Path, tmp_path: Path) -> None:
    if shutil.which("bash") is None:
        pytest.skip("SKIPPED: no bash on this machine")
    ours = Path(sys.prefix) == root / ".venv"  # env.sh activates that environment alone
    terminal = _Terminal(tmp_path)
    try:
        setup = f". '{root}/env.sh'" if ours else 'eval "$(gibson-sim completion bash)"'
        terminal.type(f"{setup}; echo re''ady\n", "ready\r\n")
        terminal.type("gibson-sim run --scene lind\t", "linden_flat ")
        terminal.type("--compression zs\t", "zstd ")
    finally:
        terminal.close()
