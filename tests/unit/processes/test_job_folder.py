"""Which process removes the folder of a job."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from gibson_sim.processes.job_folder import JobFolder, remove_abandoned

LAUNCHER = """
import os, sys, subprocess
from pathlib import Path
from gibson_sim.processes.job_folder import JobFolder
folder = JobFolder(Path(sys.argv[1]))
(folder.path / "bag").mkdir()
environment = dict(os.environ)
folder.add_to(environment)
node = "import sys; from gibson_sim.processes.job_folder import leave_job; sys.stdin.readline(); leave_job(); print('left', flush=True)"
how = {"env": environment, "pass_fds": (folder.descriptor,)}
nodes = [subprocess.Popen([sys.executable, "-c", node], stdin=int(fd), **how) for fd in sys.argv[2:]]
print("ready", flush=True)
sys.stdin.readline()
os.kill(os.getpid(), 9)
"""


def test_the_last_node_of_a_killed_launcher_removes_the_folder(tmp_path: Path) -> None:
    pipes = [os.pipe(), os.pipe()]
    command = [sys.executable, "-c", LAUNCHER, str(tmp_path), *(str(read) for read, _ in pipes)]
    launcher = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=[read for read, _ in pipes]
    )
    assert launcher.stdin is not None and launcher.stdout is not None
    assert launcher.stdout.readline() == "ready\n"
    with launcher.stdin as stdin:
        stdin.write("\n")
    assert launcher.wait() == -9
    for number, (read, write) in enumerate(pipes):
        assert len(list(tmp_path.iterdir())) == 1, f"{number} of 2 nodes have left"
        assert remove_abandoned(tmp_path) == [], "it is in use"
        os.write(write, b"\n")
        assert launcher.stdout.readline() == "left\n"
        os.close(read)
        os.close(write)
    launcher.stdout.close()
    assert list(tmp_path.iterdir()) == []


def test_the_next_start_removes_a_folder_whose_processes_were_all_killed(tmp_path: Path) -> None:
    make = "import sys, os; from pathlib import Path; from gibson_sim.processes.job_folder import JobFolder; JobFolder(Path(sys.argv[1])); "
    subprocess.run([sys.executable, "-c", make + "os.kill(os.getpid(), 9)", str(tmp_path)], check=False)
    (left,) = tmp_path.iterdir()
    (tmp_path / "gibson-sim-job-file").touch()
    (tmp_path / "gibson-sim-job-link").symlink_to(tmp_path.parent)
    with JobFolder(tmp_path) as folder, JobFolder(tmp_path) as other:
        assert not left.exists()
        assert folder.path.is_dir() and other.path.is_dir(), "neither takes the other for abandoned"
    assert {path.name for path in tmp_path.iterdir()} == {"gibson-sim-job-file", "gibson-sim-job-link"}
