"""Units of work on a Ray cluster of this machine, where Ray is installed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from support.processes import wait_for_end

TESTS = Path(__file__).resolve().parents[2]
CLUSTER = """
import logging, sys, ray
ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR, _temp_dir=sys.argv[1])
print(ray.get_runtime_context().gcs_address, flush=True)
sys.stdin.read()
"""
"""A program that is a cluster until its input ends."""
DRIVER = """
import json, sys
from dataclasses import asdict
from pathlib import Path
from gibson_sim.errors import GibsonSimError
from gibson_sim.interrupts import Interruptible, die
from gibson_sim.jobs.local import LocalWorkers
from gibson_sim.jobs.ray_cluster import RayCluster
from gibson_sim.jobs.units import Unit, run_units
address, output, options, units = json.loads(sys.argv[1])
units = [Unit(name, f"support.work:{function}", arguments, tuple(map(Path, files))) for name, function, arguments, files in units]
try:
    with Interruptible():
        backend = RayCluster(address, **options) if address else LocalWorkers(2)
        for result in run_units(units, backend, output=Path(output)):
            print(json.dumps([result.id, result.value, result.error, result.attempts]), flush=True)
except GibsonSimError as error:
    print(json.dumps(str(error)))
except KeyboardInterrupt:
    die()
"""
"""A program that runs units, on a cluster or on this machine."""


@pytest.fixture(scope="module")
def cluster() -> Iterator[tuple[str, dict[str, str]]]:
    """Address of a cluster of two cores, and the environment of its clients."""
    if find_spec("ray") is None:
        message = "SKIPPED: no Ray; pip install 'gibson_sim[ray]'"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    folder = tempfile.mkdtemp(prefix="gsray", dir="/tmp")  # sockets have short paths
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": uuid4().hex,
        "XDG_CACHE_HOME": f"{folder}/cache",
    }
    with subprocess.Popen(
        [sys.executable, "-c", CLUSTER, folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield process.stdout.readline().strip(), environment
        process.stdin.close()
    shutil.rmtree(folder, ignore_errors=True)


Work = tuple[str, str, dict[str, Any], list[str]]
"""Id, function, arguments and files of a unit."""


def start(address: str, environment: dict[str, str], output: Path, units: list[Work], **options: Any) -> subprocess.Popen[str]:
    values = json.dumps([address, str(output), options, units])
    return subprocess.Popen([sys.executable, "-c", DRIVER, values], stdout=subprocess.PIPE, text=True, env=environment)


def end(process: subprocess.Popen[str]) -> list[Any]:
    output, _ = process.communicate()
    return [json.loads(line) for line in output.splitlines() if line.startswith(("[", '"'))]  # Ray reports dead workers there


def files_below(folder: Path) -> dict[str, tuple[bytes, bool]]:
    return {
        str(path.relative_to(folder)): (path.read_bytes() if path.is_file() else b"", os.access(path, os.X_OK))
        for path in sorted(folder.rglob("*"))
    }


def waiting_pids(pipe: Path) -> list[int]:
    """Returns the worker process of a unit that waits, its child, and its Ray worker."""
    reader = os.open(pipe, os.O_RDWR)
    text = ""
    while not text.endswith("\n"):
        text += os.read(reader, 1000).decode()
    os.close(reader)
    return [int(word) for word in text.split()]


def test_a_cluster_gives_the_results_of_local_workers(cluster: tuple[str, dict[str, str]], tmp_path: Path) -> None:
    address, environment = cluster
    scene = tmp_path / "scene"
    (scene / "scripts").mkdir(parents=True)
    (scene / "scripts" / "run.sh").write_text("#!/bin/sh\n")
    (scene / "scripts" / "run.sh").chmod(0o755)
    (scene / "scene.yaml").write_text("name: hall")
    (scene / "same.yaml").symlink_to("scene.yaml")
    shipped = [str(scene)]
    units: list[Work] = [
        *((f"u{k}", "square", {"x": k}, []) for k in range(6)),
        ("script", "read", {"path": str(scene / "scripts" / "run.sh")}, shipped),
        ("link", "read", {"path": os.path.relpath(scene / "same.yaml")}, shipped),
        ("large", "echo", {"files": {"a/b.bin": 5_000_000}, "text": "x" * 100_000}, []),
        ("fails", "refuse", {}, []),
        ("divides", "divide", {"x": 0}, []),
    ]
    local = end(start("", environment, tmp_path / "local", units))
    assert local[6:8] == [["script", ["run.sh", "#!/bin/sh\n", True], "", 1], ["link", ["same.yaml", "name: hall", False], "", 1]]
    assert end(start(address, environment, tmp_path / "ray", units)) == local
    assert files_below(tmp_path / "ray") == files_below(tmp_path / "local")


def test_all_results_are_there_after_a_ray_worker_was_killed(cluster: tuple[str, dict[str, str]], tmp_path: Path) -> None:
    address, environment = cluster
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    killed: Work = ("killed", "wait_once", {"pipe": str(pipe), "note": str(tmp_path / "note")}, [])
    squares: list[Work] = [(f"u{k}", "square", {"x": k}, []) for k in range(6)]
    process = start(address, environment, tmp_path / "out", [killed, *squares])
    pids = waiting_pids(pipe)
    os.kill(pids[2], signal.SIGKILL)
    assert end(process) == [["killed", [], "", 2], *([f"u{k}", {"square": k * k}, "", 1] for k in range(6))]
    assert [path.name for path in (tmp_path / "out" / "killed").iterdir()] == ["whole"]
    wait_for_end(pids)


def test_a_unit_that_always_kills_its_worker_fails_at_the_third_attempt(
    cluster: tuple[str, dict[str, str]], tmp_path: Path
) -> None:
    address, environment = cluster
    process = start(address, environment, tmp_path, [("u", "die", {"signal": signal.SIGKILL}, [])])
    assert end(process) == [["u", None, f"its worker was killed by SIGKILL (out of memory?) on {os.uname().nodename}", 3]]


def test_ctrl_c_ends_the_units_on_the_cluster(cluster: tuple[str, dict[str, str]], tmp_path: Path) -> None:
    address, environment = cluster
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    process = start(address, environment, tmp_path / "out", [("u", "wait", {"pipe": str(pipe)}, [])])
    pids = waiting_pids(pipe)
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == -signal.SIGINT
    wait_for_end(pids[:2])


def test_the_units_end_when_the_caller_is_killed(cluster: tuple[str, dict[str, str]], tmp_path: Path) -> None:
    address, environment = cluster
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    process = start(address, environment, tmp_path / "out", [("u", "wait", {"pipe": str(pipe), "deaf": True}, [])])
    pids = waiting_pids(pipe)
    process.kill()
    process.communicate()
    wait_for_end(pids)


def test_files_over_the_limit_are_refused_in_one_line(cluster: tuple[str, dict[str, str]], tmp_path: Path) -> None:
    address, environment = cluster
    (tmp_path / "a").write_bytes(b"a" * 700)
    (tmp_path / "b").write_bytes(b"b" * 400)
    units: list[Work] = [(name, "read", {"path": str(tmp_path / name)}, [str(tmp_path / name)]) for name in ("a", "b")]
    process = start(address, environment, tmp_path / "out", units, limit_bytes=1000)
    assert end(process) == [
        f"the files of the units have more than 1.0 KB together, up to {tmp_path}/b; name fewer files, or put large ones at the same path on all "
        "machines"
    ]
