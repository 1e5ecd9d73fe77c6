"""Shared-memory leftovers and exit codes of the launcher."""

from __future__ import annotations

import argparse
import fcntl
import mmap
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from gibson_sim.cli.environment import enclave_variables, environment_of, in_wheels, node_environment
from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.processes import shared_memory
from gibson_sim.processes.shared_memory import remove_dead_segments


def test_dead_segments_are_removed_and_live_ones_stay(tmp_path: Path) -> None:
    dead = ["fastrtps_dead", "fastrtps_dead_el", "fastrtps_port7001", "fastrtps_port7001_el", "sem.fastrtps_port7001_mutex"]
    orphan = ["fastrtps_port7002", "sem.fastrtps_port7002_mutex"]
    alive = ["fastrtps_alive", "fastrtps_alive_el", "fastrtps_port7003", "fastrtps_port7003_el", "sem.fastrtps_port7003_mutex"]
    for name in (*dead, *orphan, *alive, "somebody_else_el"):
        (tmp_path / name).touch()
    with (tmp_path / "fastrtps_alive_el").open("r+") as a, (tmp_path / "fastrtps_port7003_el").open("r+") as b:
        fcntl.flock(a, fcntl.LOCK_EX)
        fcntl.flock(b, fcntl.LOCK_EX)
        remove_dead_segments(tmp_path)
        # The next process that opens a port reuses its lock file.
        assert {p.name for p in tmp_path.iterdir()} == {*alive, "fastrtps_port7001_el", "somebody_else_el"}


def test_folders_and_links_of_such_names_are_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_memory, "SETTLED_S", 0.0)
    precious = tmp_path / "precious"
    precious.write_text("to be kept")
    for name in ("fastrtps_port7001", "fastrtps_port7002_el"):
        (tmp_path / name).mkdir()
    (tmp_path / "fastrtps_port7003_el").symlink_to("fastrtps_port7003_el")
    (tmp_path / "fastrtps_planted_el").symlink_to(precious)
    before = sorted(tmp_path.iterdir())
    assert remove_dead_segments(tmp_path) == []
    assert sorted(tmp_path.iterdir()) == before
    assert precious.read_text() == "to be kept"


def _write_port(path: Path, *nodes: tuple[int, ...]) -> None:
    """Writes a port with nodes: number, listeners, timeout and a third of it in ms, capacity, waiting listeners, flags."""
    path.write_bytes(bytes(1000) + b"".join(struct.pack("<7I", *node) for node in nodes) + bytes(1000))


def test_port_of_a_dead_reader_is_marked_as_unusable_for_its_writers_and_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its writers then open the port of the reader that takes its place, and do not remove it by name."""
    port, lock = tmp_path / "fastrtps_port7003", tmp_path / "fastrtps_port7003_el"
    _write_port(port, (7003, 1, 10_000, 3333, 512, 1, 0b111))
    lock.touch()
    monkeypatch.setattr(shared_memory, "SETTLED_S", 0.0)
    with port.open("r+b") as file, mmap.mmap(file.fileno(), 0) as segment:
        with lock.open("r+") as reader:
            fcntl.flock(reader, fcntl.LOCK_EX)
            assert remove_dead_segments(tmp_path) == []
            assert struct.unpack_from("<I", segment, 1024) == (0b111,), "its reader runs"
        assert remove_dead_segments(tmp_path) == [port]
        assert struct.unpack_from("<I", segment, 1024) == (0b110,)


def test_port_whose_mark_is_not_unique_is_left_alone(tmp_path: Path) -> None:
    port = tmp_path / "fastrtps_port7003"
    node = (7003, 1, 10_000, 3333, 512, 1, 0b111)
    _write_port(port, node, node)
    before = port.read_bytes()
    assert not shared_memory.mark_unusable(port)
    assert port.read_bytes() == before
    for other in ((7004, *node[1:]), (*node[:3], 3000, *node[4:]), (*node[:6], 0b1111)):
        _write_port(port, other)
        assert not shared_memory.mark_unusable(port)
    assert not shared_memory.mark_unusable(tmp_path / "fastrtps_portal")
    assert not shared_memory.mark_unusable(tmp_path / "fastrtps_port7005"), "it is gone"


def test_port_with_a_writer_stays_until_it_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last process to close a port removes it by name: by then this could be the port of another process. Here the mark is not found."""
    port, lock = tmp_path / "fastrtps_port7003", tmp_path / "fastrtps_port7003_el"
    port.write_bytes(bytes(4096))
    lock.touch()
    monkeypatch.setattr(shared_memory, "SETTLED_S", 0.0)
    with port.open("r+b") as file, mmap.mmap(file.fileno(), 4096):
        assert remove_dead_segments(tmp_path) == []
    assert remove_dead_segments(tmp_path) == [port]


def test_locks_are_not_tried_while_a_process_may_acquire_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A starting process that finds its lock held for an instant gets no shared memory; one without a lock file counts as dead."""
    tried: list[Path] = []
    for name in ("fastrtps_port7003", "fastrtps_port7003_el", "fastrtps_new", "fastrtps_new_el"):
        (tmp_path / name).touch()
    monkeypatch.setattr(shared_memory, "_remove", lambda guarded, lock, port: tried.append(lock) or [])
    with (tmp_path / "fastrtps_port7003_el").open("r+") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert shared_memory._sweep(tmp_path) == ([], True), "the one is held, the other too young"
    assert not tried


def test_port_that_is_locked_during_the_check_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "fastrtps_port7002").touch()
    lock = tmp_path / "fastrtps_port7002_el"
    with lock.open("w") as held:
        lock.rename(tmp_path / "not_yet")

        def meanwhile(_: float) -> None:
            (tmp_path / "not_yet").rename(lock)
            fcntl.flock(held, fcntl.LOCK_EX)

        monkeypatch.setattr(shared_memory.time, "sleep", meanwhile)
        remove_dead_segments(tmp_path)
        assert (tmp_path / "fastrtps_port7002").exists()


def _cli(*argv: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", *argv], capture_output=True, text=True, check=False)


def test_help_documents_the_exit_codes() -> None:
    done = _cli("--help")
    assert done.returncode == 0
    assert "3  a simulation runs in this ROS domain already" in done.stdout


@pytest.mark.parametrize(
    ("argv", "code", "text"),
    [
        (("run", "--scene", "/no/such/scene"), 1, "/no/such/scene"),
        (("run", "--step-hz", "7"), 1, "setting 'step_hz' is 7, must be 60 to 10000 Hz"),
        (("run", "--video", "film.avi"), 1, "must end in .mp4"),
        (("run", "--no-render", "--video", "film.mp4"), 1, "--no-render makes no images"),
        (("run", "--bogus"), 2, "unrecognized arguments: --bogus"),
    ],
)
def test_bad_command_line_ends_with_one_line_on_stderr(argv: tuple[str, ...], code: int, text: str) -> None:
    done = _cli(*argv)
    assert done.returncode == code
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("gibson-sim: error:")
    assert text in last
    assert code == 2 or len(done.stderr.strip().splitlines()) == 1


def test_record_into_a_folder_with_content_is_refused(tmp_path: Path) -> None:
    (tmp_path / "precious").touch()
    done = _cli("run", "--record", str(tmp_path))
    assert done.returncode == 1
    assert "is not an empty folder" in done.stderr
    assert (tmp_path / "precious").exists()


def test_node_gets_its_own_enclave_with_security() -> None:
    assert enclave_variables({}, "render") == {}
    assert enclave_variables({"ROS_SECURITY_ENABLE": "true"}, "render") == {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/gibson_sim/render"}
    chosen = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_ENCLAVE_OVERRIDE": "/mine"}
    assert enclave_variables(chosen, "render") == {}


@pytest.mark.skipif(not in_wheels(), reason="SKIPPED: this ROS may be able to encrypt; that of pip cannot")
def test_security_is_refused_with_ros_from_pip() -> None:
    with pytest.raises(EnvironmentProblemError, match="ROS_SECURITY_ENABLE is 'true', but ROS from pip cannot encrypt"):
        node_environment({"ROS_SECURITY_ENABLE": "true"})


@pytest.mark.skipif(not in_wheels(), reason="SKIPPED: the ROS of this machine is not from pip")
def test_the_library_path_of_another_environment_with_ros_from_pip_is_left() -> None:
    done = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    other = node_environment({**done, "LD_LIBRARY_PATH": "/other/venv/lib"})
    assert not {"_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH"} & set(other), "its nodes would not find librcl_action.so"
    own = f"{sys.prefix}/lib:/opt/cuda/lib"
    assert node_environment({**done, "LD_LIBRARY_PATH": own})["LD_LIBRARY_PATH"] == own
    assert node_environment({"LD_LIBRARY_PATH": "/opt/cuda/lib"})["LD_LIBRARY_PATH"] == "/opt/cuda/lib"


@pytest.mark.parametrize("domain", [-3, 232, 9999])
def test_a_domain_outside_the_range_of_dds_is_refused_before_anything_starts(domain: int) -> None:
    with pytest.raises(EnvironmentProblemError, match=f"'{domain}', must be a whole number from 0 to 231"):
        environment_of(argparse.Namespace(domain_id=domain, reach=None))
