"""``gibson-sim doctor``: checks what works on this machine, and names the remedy for what does not.

Whatever may crash or hang (drivers, ROS) runs in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from gibson_sim import __version__
from gibson_sim.cli.environment import add_domain, domain_of, in_wheels, node_environment
from gibson_sim.errors import AlreadyRunningError, GibsonSimError
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.reach import PROFILE_VARIABLE, SUBNET, describe_reach, is_local, profile_of, reach_of
from gibson_sim.resources import known_scenes

Status = Literal["ok", "warn", "FAIL"]
TIMEOUT_S = 60.0
"""Timeout of one check, seconds."""
SHM_WANTED_MB, DISK_WANTED_MB = 256, 2000
"""Minimum free shared memory and disk space; below these a warning is printed."""


@dataclass(frozen=True)
class Finding:
    """A line of the report."""

    what: str
    status: Status
    detail: str
    remedy: str = ""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("doctor", help="check Python, ROS, graphics, DDS and disk, and suggest fixes")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_domain(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the findings; returns 1 if a check fails."""
    findings = []
    domain = partial(_domain, args.domain_id)
    for check in (_python, _ros, _physics, _loops, _graphics, _dds, _shared_memory, _disk, _scenes, domain):
        for finding in check():
            findings.append(finding)
            if not args.json:
                remedy = f"\n         -> {finding.remedy}" if finding.remedy else ""
                print(f"{finding.status:>4}  {finding.what}: {finding.detail}{remedy}", flush=True)
    if args.json:
        print(json.dumps([vars(f) for f in findings], indent=2))
    return 1 if any(f.status == "FAIL" for f in findings) else 0


def _python() -> Iterator[Finding]:
    version = sys.version.split()[0]
    good = (3, 10) <= sys.version_info[:2] <= (3, 13)
    yield Finding(
        "Python",
        "ok" if good else "warn",
        f"{version} at {sys.executable}, gibson-sim {__version__}",
        "" if good else "CPython 3.10 to 3.13 are tested: make a new environment with `PYTHON=python3.12 make setup`",
    )


def _try(code: str) -> tuple[bool, str]:
    """Runs a Python program in the nodes' environment; returns whether it succeeded, and its last line."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], env=node_environment(), capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {TIMEOUT_S:.0f} s"
    except GibsonSimError as error:
        return False, str(error)
    lines = [line for line in (done.stdout if done.returncode == 0 else done.stderr + done.stdout).splitlines() if line.strip()]
    return done.returncode == 0, lines[-1] if lines else f"exit code {done.returncode} without a message"


MESSAGES = {
    "gibson_msgs": True,
    "tf2_msgs": True,
    "control_msgs": False,
    "rosbag2_interfaces": False,
    "simulation_interfaces": False,
}
"""Message package that may be missing in a ROS installation -> whether it is required."""


def _ros() -> Iterator[Finding]:
    source = "from pip" if in_wheels() else "from the ROS installation"
    ok, text = _try("import rclpy; rclpy.init(); print(rclpy.get_rmw_implementation_identifier()); rclpy.try_shutdown()")
    yield Finding(
        "rclpy",
        "ok" if ok else "FAIL",
        f"{source}, {text}" if ok else text,
        "" if ok else "run `make setup`, or pip install 'gibson_sim[ros]', or source your ROS 2 Jazzy installation",
    )
    for package, needed in MESSAGES.items():
        ok, text = _try(f"import {package}; print({package}.__path__[0])")
        remedy = (
            ""
            if ok
            else "run `make setup`, or build the workspace: cd ros_ws && colcon build, then source install/setup.bash; "
            "with pip: pip install 'gibson_sim[ros]'"
        )
        yield Finding(package, "ok" if ok else ("FAIL" if needed else "warn"), text, remedy)


def _physics() -> Iterator[Finding]:
    ok, text = _try("import pybullet as p; c = p.connect(p.DIRECT); print('PyBullet', p.getAPIVersion(c))")
    yield Finding(
        "physics",
        "ok" if ok else "FAIL",
        text,
        "" if ok else "run `make setup`; on CPython 3.12 PyBullet is compiled, which takes some minutes",
    )


def _loops() -> Iterator[Finding]:
    from gibson_sim.geometry.compiling import CAN_COMPILE  # half a second of Numba

    text = (
        "culling and level-of-detail selection are compiled"
        if CAN_COMPILE
        else "not installed: culling and level-of-detail selection run in NumPy, more slowly"
    )
    yield Finding("Numba", "ok" if CAN_COMPILE else "warn", text, "" if CAN_COMPILE else "pip install 'gibson_sim[fast]'")


_DEVICES = """
import dataclasses, json
from gibson_sim.render.context import list_devices
print(json.dumps([dataclasses.asdict(d) for d in list_devices()]))
"""
_DRAW = "from gibson_sim.render.self_test import self_test; print(self_test({index}))"
_CUDA = """
import dataclasses, json
from gibson_sim.render.readback.cuda import CudaPython
print(json.dumps([dataclasses.asdict(d) for d in CudaPython().devices()]))
"""
_GRAPHICS_REMEDY = (
    "Debian/Ubuntu: apt install libegl1 libegl-mesa0 libgl1-mesa-dri; NVIDIA in a container: give it the graphics capability"
)


def _graphics() -> Iterator[Finding]:
    """Renders on each device in a separate process: a working device may coexist with a faulty one."""
    ok, text = _try(_DEVICES)
    if not ok:
        yield Finding("EGL", "FAIL", text, _GRAPHICS_REMEDY)
        return
    devices = json.loads(text)
    if not any(d["usable"] for d in devices):
        yield Finding("EGL", "FAIL", f"{len(devices)} devices, none can render", _GRAPHICS_REMEDY)
    for device in devices:
        yield _egl_device(device)
    nvidia = [d for d in devices if d["usable"] and "nvidia" in d["vendor"].lower()]
    if nvidia:
        yield _cuda(nvidia)


def _egl_device(device: dict[str, Any]) -> Finding:
    what = f"EGL device {device['index']}"
    identity = f", UUID {device['uuid']}" if device["uuid"] else ""
    if not device["usable"]:
        kind = "software, no GPU" if device["software"] else f"GPU {device['drm_node']}".strip()
        name = device["renderer"] or device["vendor"] or "nameless"
        return Finding(what, "warn", f"{name}, {kind}{identity}: {device['problem']}")
    ok, text = _try(_DRAW.format(index=device["index"]))
    if ok:
        return Finding(what, "ok", f"{text}{identity}")
    return Finding(what, "FAIL", f"{text}{identity}", "update its driver; until then choose another device with --egl-device")


def _cuda(nvidia: list[dict[str, Any]]) -> Finding:
    """Checks whether tensors can stay on the GPU: the rendering GPU must be visible to CUDA."""
    ok, text = _try(_CUDA)
    if not ok:
        return Finding(
            "CUDA", "warn", text, "only for tensors on the GPU: pip install 'gibson_sim[cuda]'; all else works without"
        )
    devices = json.loads(text)
    drawing = {d["uuid"]: d["index"] for d in nvidia}
    pairs = [f"cuda:{c['ordinal']} {c['name']} is EGL device {drawing[c['uuid']]}" for c in devices if c["uuid"] in drawing]
    if pairs:
        return Finding("CUDA", "ok", "; ".join(pairs))
    known = ", ".join(f"cuda:{c['ordinal']} {c['name']} {c['uuid']}" for c in devices) or "no device"
    remedy = "for tensors on the GPU, include the GPU that renders in CUDA_VISIBLE_DEVICES"
    return Finding("CUDA", "warn", f"{known}: none of them is a GPU that renders", remedy)


def _dds() -> Iterator[Finding]:
    try:
        environment = node_environment()
    except GibsonSimError as error:
        yield Finding("reach", "FAIL", str(error))
        return
    said = describe_reach(environment).removeprefix("reach: ")
    if is_local(environment) and (routed := _routed_localnet()):
        yield Finding(
            "reach", "warn", f"{said}; but packets from {routed} reach 127.0.0.1", "sysctl net.ipv4.conf.all.route_localnet=0"
        )
    else:
        yield Finding("reach", "ok", said)
    profile = environment[PROFILE_VARIABLE]
    if reach_of(os.environ) or profile == str(profile_of(SUBNET)):
        yield Finding("DDS profile", "ok", profile)
    else:
        remedy = f"if images arrive late or with gaps, copy the shared-memory transport of {profile_of(SUBNET)} into it"
        yield Finding("DDS profile", "warn", f"yours: {profile}", remedy)
    ok, text = _try("from gibson_sim.ros.wire.dds_check import main; main()")
    yield Finding(
        "large images",
        "ok" if ok else "FAIL",
        text,
        ""
        if ok
        else "check for a firewall or another DDS profile that blocks them; unset the variables of ROS and Fast DDS, and try again",
    )


def _routed_localnet(folder: Path = Path("/proc/sys/net/ipv4/conf")) -> str:
    """Returns the network interfaces whose packets the kernel routes to 127.0.0.1 (``route_localnet``), joined by commas."""
    interfaces = []
    for setting in sorted(folder.glob("*/route_localnet")):
        with suppress(OSError):
            if setting.read_text().strip() == "1" and setting.parent.name not in ("default", "lo"):
                interfaces.append(setting.parent.name)
    return ", ".join(interfaces)


def _free_mb(path: Path) -> float:
    return shutil.disk_usage(path).free / 1e6


def _shared_memory() -> Iterator[Finding]:
    folder = Path("/dev/shm")
    if not folder.is_dir():
        yield Finding("shared memory", "warn", "no /dev/shm: images go over the network stack", "")
        return
    free = _free_mb(folder)
    yield Finding(
        "shared memory",
        "ok" if free >= SHM_WANTED_MB else "warn",
        f"{free:.0f} MB free in {folder}",
        "" if free >= SHM_WANTED_MB else f"less than {SHM_WANTED_MB} MB: in Docker give --shm-size=512m or --ipc=host",
    )


def _disk() -> Iterator[Finding]:
    for name, path in (("disk here", Path.cwd()), ("temporary files", Path(tempfile.gettempdir()))):
        free = _free_mb(path)
        good = free >= DISK_WANTED_MB
        yield Finding(
            name,
            "ok" if good else "warn",
            f"{free / 1000:.1f} GB free in {path}",
            "" if good else "a minute of raw 640x480 RGB and depth takes 4 GB",
        )


def _scenes() -> Iterator[Finding]:
    names = ", ".join(known_scenes())
    remedy = (
        "" if names else "reinstall, or pip install 'gibson_sim[scenes]', or set GIBSON_SIM_PATH to a folder that holds scenes/"
    )
    yield Finding("scenes", "ok" if names else "warn", f"{names or 'none'} (by name; any folder or file works too)", remedy)


def _domain(requested: int | None) -> Iterator[Finding]:
    """Checks whether a simulation can start in the requested ROS domain; None = that of the environment."""
    try:
        domain_id = domain_of(os.environ if requested is None else {"ROS_DOMAIN_ID": str(requested)})
        DomainLock(domain_id).close()
    except AlreadyRunningError as error:
        yield Finding("domain", "warn", str(error))
    except GibsonSimError as error:
        yield Finding("domain", "FAIL", str(error), "unset ROS_DOMAIN_ID" if requested is None else "choose another one")
    else:
        yield Finding("domain", "ok", f"ROS_DOMAIN_ID {domain_id}, no Gibson Sim simulation runs in it")
