"""The lock of a ROS domain: one holder at a time."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.processes.domain_lock import DomainLock, is_held

TAKE = "import sys; from gibson_sim.processes.domain_lock import DomainLock; DomainLock(int(sys.argv[1]))"
NOBODY = 65534


@pytest.fixture
def domain_id() -> int:
    """A domain that no simulation and no other test has: beyond those of ROS."""
    return 1000 + os.getpid()


@pytest.fixture
def lock(domain_id: int) -> Iterator[DomainLock]:
    """Holds that domain."""
    lock = DomainLock(domain_id)
    yield lock
    lock.close()


def _take_elsewhere(domain_id: int, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", TAKE, str(domain_id)]
    return subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=False)


def test_second_simulation_in_a_domain_is_refused_and_told_what_to_do(domain_id: int, lock: DomainLock) -> None:
    expected = f"runs in ROS domain {domain_id} already \\(process {os.getpid()}\\): stop it, or choose another domain"
    for _ in range(3):
        with pytest.raises(AlreadyRunningError, match=expected):
            DomainLock(domain_id)
    lock.close()
    lock.close()
    DomainLock(domain_id).close()


def test_tools_see_that_a_simulation_starts_in_a_domain(domain_id: int) -> None:
    assert not is_held(domain_id)
    lock = DomainLock(domain_id)
    assert is_held(domain_id) and not is_held(int(str(domain_id)[:-1]))
    lock.close()
    assert not is_held(domain_id)


def test_other_domain_is_free(domain_id: int, lock: DomainLock) -> None:
    DomainLock(domain_id + 100_000).close()


def test_another_folder_for_temporary_files_lets_no_second_simulation_in(
    domain_id: int, lock: DomainLock, tmp_path: Path
) -> None:
    done = _take_elsewhere(domain_id, TMPDIR=str(tmp_path))
    assert done.returncode == 1
    assert f"AlreadyRunningError: a simulation runs in ROS domain {domain_id} already (process {os.getpid()})" in done.stderr


def test_planted_links_and_folders_are_neither_followed_nor_in_the_way(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    precious = tmp_path / "precious"
    precious.write_text("to be kept")
    (tmp_path / f"gibson-sim-domain-{domain_id}.lock").symlink_to(precious)
    (tmp_path / f"gibson-sim-domain-{domain_id + 100_000}.lock").mkdir()
    DomainLock(domain_id).close()
    DomainLock(domain_id + 100_000).close()
    assert precious.read_text() == "to be kept"


def test_lock_is_free_once_its_process_is_killed(domain_id: int) -> None:
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"{TAKE.replace('DomainLock(int', 'lock = DomainLock(int')}; print(flush=True); input()",
            str(domain_id),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    with pytest.raises(AlreadyRunningError, match=f"process {holder.pid}"):
        DomainLock(domain_id)
    holder.kill()
    holder.communicate()
    DomainLock(domain_id).close()


def test_holder_of_another_user_is_named(domain_id: int, monkeypatch: pytest.MonkeyPatch, lock: DomainLock) -> None:
    monkeypatch.setattr(os, "getuid", lambda: NOBODY)
    with pytest.raises(AlreadyRunningError, match=r"process \d+ of user \w+\): choose another domain") as caught:
        DomainLock(domain_id)
    assert "stop it" not in str(caught.value)


def test_process_that_squats_without_listening_is_a_refusal_and_no_crash(domain_id: int) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as squatter:
        squatter.bind(f"\0gibson-sim-domain-{domain_id}")
        with pytest.raises(AlreadyRunningError, match="its process cannot be identified"):
            DomainLock(domain_id)
