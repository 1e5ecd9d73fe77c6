"""Ctrl-C at any moment of a process: no stack trace, and the documented exit code."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gibson_sim.interrupts import Interruptible

NTH_IMPORT = """
import os, signal, sys

class Interrupt:
    count = None
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["TEST_COUNT_FROM"]:
            self.count = 0
        if self.count is not None:
            self.count += 1
            if self.count == int(os.environ["TEST_INTERRUPT_AT"]):
                os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
"""
"""Interrupts the process that loads it in the middle of an import, more exactly than any delay before a signal could."""


def _interrupted(tmp_path: Path, command: list[str], count_from: str, at: int) -> subprocess.CompletedProcess[str]:
    (tmp_path / "sitecustomize.py").write_text(NTH_IMPORT)
    env = {**os.environ, "PYTHONPATH": str(tmp_path), "TEST_COUNT_FROM": count_from, "TEST_INTERRUPT_AT": str(at)}
    return subprocess.run([sys.executable, *command], env=env, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("at", [1, 2, 10, 40, 80, 120])
@pytest.mark.parametrize("command", [("run", "--scene", "nosuch"), ("task", "--list"), ("scene", "check", "nosuch")])
def test_a_command_that_is_interrupted_while_it_loads_is_silent(tmp_path: Path, command: tuple[str, ...], at: int) -> None:
    done = _interrupted(tmp_path, ["-m", "gibson_sim.cli.main", *command], "gibson_sim.cli.command_line", at)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", ""), "as a shell shows it: 130"


@pytest.mark.parametrize("at", [1, 20, 200, 600])
@pytest.mark.parametrize("module", ["nodes.physics_node", "recording.render_bag"])
def test_a_node_that_is_interrupted_while_it_loads_is_silent(tmp_path: Path, module: str, at: int) -> None:
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("SKIPPED: no rclpy in this Python; run `make setup`")
    command = ["-m", "gibson_sim.ros.nodes.start", f"gibson_sim.ros.{module}", "--ros-args"]
    done = _interrupted(tmp_path, command, f"gibson_sim.ros.{module}", at)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def test_a_process_starts_with_ctrl_c_blocked_until_it_is_ready() -> None:
    """Python's own handler, which prints a stack trace, is active before the first line of a program."""
    begin = "import os, signal; from gibson_sim import interrupts; "
    child = (
        "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('kept', flush=True); "
        + begin
        + "interrupts.end_silently(); print(1)"
    )
    parent = (
        begin + f"import subprocess, sys\nwith interrupts.held_back():\n    subprocess.run([sys.executable, '-c', {child!r}])"
    )
    done = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("kept\n", "")


def test_an_interrupt_in_a_destructor_is_not_lost(capsys: pytest.CaptureFixture[str]) -> None:
    class Doomed:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):
                pass

    def work() -> None:
        with interruptible:
            doomed = Doomed()
            del doomed
            deadline = time.monotonic() + 60.0
            while time.monotonic() < deadline:
                pass

    before = signal.getsignal(signal.SIGINT), sys.unraisablehook
    interruptible = Interruptible()
    with pytest.raises(KeyboardInterrupt):
        work()
    assert interruptible.was_interrupted
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == before
    assert capsys.readouterr().err == ""
