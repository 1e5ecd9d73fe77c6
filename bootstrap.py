#!/usr/bin/env python3
"""Creates the virtual environment in which Gibson Sim runs: ROS 2 Jazzy, PyBullet, the message packages and Gibson Sim itself.

`make setup` calls this program, which uses the standard library alone. Each step leaves a stamp in the environment with a digest
of its inputs, so a second run finds nothing to do. An error is one line that begins with "error:".
"""

from __future__ import annotations

import argparse
import configparser
import contextlib
import fcntl
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent
CONSTRAINTS = ROOT / "constraints.txt"
PROJECTS = (
    ROOT / "src" / "gibson_sim",
    ROOT / "src" / "gibson_sim_tools",
    ROOT / "ros_ws" / "src" / "gibson_path_following",
    ROOT / "src" / "gibson_sim_learn",
    ROOT / "src" / "gibson_sim_bench",
    ROOT / "ros_ws" / "src" / "gibson_examples",
)
EDITABLE = "editable_mode=compat"
"""Of setuptools: editable packages are found by folders in a .pth file. Its default, an import hook, loses against a folder with the name of a
package in the working directory, such as that of a clone: `import gibson_sim` would then import the empty folder."""
INTERFACES = (ROOT / "src" / "gibson_msgs", ROOT / "ros_ws" / "src" / "compat")
PYTHON_ONLY = ROOT / "ros_ws" / "src" / "compat" / "python_only"
"""Folder of the CMake package that limits message generation to Python."""

SHARED = ("config", "launch/*", "package.xml", "scenes")
"""Parts of a project that are linked into its share folder. `ros2 launch` searches there for files, but not in linked folders."""

SUPPORTED = ((3, 10), (3, 11), (3, 12))
BUILD_TOOLS = ("numpy", "packaging", "setuptools", "wheel")
"""Packages that pip needs to build source packages. PyBullet is built with NumPy support because NumPy is among them."""
COMPILED_PYBULLET = (3, 12)
"""First Python without a PyBullet wheel."""

FOREIGN = (
    "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV",
)  # fmt: skip
"""Variables of another ROS installation or environment, which must not leak into ours."""
PYTHON = getattr(sys, "_base_executable", None) or sys.executable
"""Interpreter of the new environment; inside a virtual environment, the base interpreter."""
BOOTSTRAPPED = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Variable that another environment of this kind sets for its programs: with it, ours would not find its libraries."""

DEBIAN_PACKAGES = {
    "the Python module venv": "python3-venv",
    "the headers of Python": "python3-dev",
    "a C++ compiler": "g++",
    "the library libEGL.so.1": "libegl1",
    "a driver for EGL": "libegl-mesa0 libgl1-mesa-dri",
}
"""System dependencies, and the Debian and Ubuntu packages that provide them."""

EGL_PROBE = r"""
import ctypes, sys
try:
    egl = ctypes.CDLL("libEGL.so.1")
except OSError:
    sys.exit(2)
egl.eglGetProcAddress.restype = ctypes.c_void_p
def function(name, result, *arguments):
    address = egl.eglGetProcAddress(name)
    return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None
display = function(b"eglGetPlatformDisplayEXT", ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)
devices = function(b"eglQueryDevicesEXT", ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
initialize = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)(("eglInitialize", egl))
candidates = [(0x31DD, None)]
if devices:
    found, count = (ctypes.c_void_p * 64)(), ctypes.c_int()
    devices(64, found, ctypes.byref(count))
    candidates += [(0x313F, found[i]) for i in range(count.value)]
sys.exit(0 if display and any(initialize(display(kind, native, None), None, None) for kind, native in candidates) else 3)
"""
"""Opens an EGL display without a screen, as the renderer does. Exit code 2: no libEGL; 3: no driver for it."""

COMPILED = tuple(
    ROOT / "src" / "gibson_sim" / "gibson_sim" / file
    for file in (
        "filling/inputs.py",
        "physics/frames.py",
        "render/lod/lod_selection.py",
        "render/culling/occlusion_culling.py",
        "render/draw/splat_raster.py",
        "render/readback/frames.py",
    )
)
"""Modules with numeric loops that Numba compiles."""
FIRST_IMAGE = """
import gibson_sim as gs
with gs.Simulation("linden_flat") as sim:
    sim.step(seconds=0.1)
    sim.render("camera", outputs=["rgb", "depth", "hole"])
import numpy as np
from gibson_sim.filling.inputs import packed
from gibson_sim.geometry.compiling import fixed
packed(np.zeros((1, 1, 3), np.uint8), np.ones((1, 1), np.float32), np.zeros((1, 1, 3), np.float32), np.zeros((1, 1), np.uint8))
from gibson_sim.render.draw.splat_raster import COLUMNS, blend_tiles, place_in_tiles
tiled = place_in_tiles(fixed(np.ones((1, COLUMNS), np.float32)), 16, 16)
blend_tiles(*tiled, fixed(np.zeros((16, 16), np.float32)), np.zeros((16, 16, 4), np.float32), 0, 1)
"""
"""Program that runs all of these loops."""


class SetupError(Exception):
    """A failure of the set-up, with its remedy, in one line."""


def say(text: str) -> None:
    """Prints a line unbuffered, in order with the output of other programs."""
    print(f"gibson-sim setup: {text}", flush=True)


@contextlib.contextmanager
def step(text: str) -> Iterator[None]:
    """Says what the block does and how long it took; on a terminal, its seconds are counted while it runs."""
    began, live, done = time.monotonic(), sys.stdout.isatty(), threading.Event()

    def count() -> None:
        while not done.wait(1.0):
            print(f"\rgibson-sim setup: {text} ... {time.monotonic() - began:.0f} s", end="", flush=True)

    counter = threading.Thread(target=count, daemon=True)
    if live:
        print(f"gibson-sim setup: {text} ...", end="", flush=True)
        counter.start()
    else:
        say(f"{text} ...")
    try:
        yield
    finally:
        done.set()
        if live:
            counter.join()
            print("\r\x1b[K", end="")
    say(f"{text}: {time.monotonic() - began:.0f} s")


def clean_environment(venv: Path) -> dict[str, str]:
    """Returns the environment variables for programs of ``venv``, without those of another installation."""
    env = {k: v for k, v in os.environ.items() if k not in FOREIGN and k != BOOTSTRAPPED}
    env["PATH"] = f"{venv / 'bin'}{os.pathsep}{env.get('PATH', os.defpath)}"
    env["PYTHONNOUSERSITE"] = "1"
    return env


def run(command: list[str], venv: Path, log: Path, extra: dict[str, str] | None = None) -> None:
    """Runs a program with its output in ``log``; on failure prints the end of the log."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as out:
        code = subprocess.run(
            command, cwd=ROOT, env={**clean_environment(venv), **(extra or {})}, stdout=out, stderr=subprocess.STDOUT, check=False
        ).returncode
    if code:
        tail = log.read_text(errors="replace").splitlines()[-30:]
        print("\n".join(tail), file=sys.stderr)
        raise SetupError(
            f"{Path(command[0]).name} {' '.join(command[1:4])} ... ended with code {code}; its whole output is in {log}"
        )


def missing_system_parts() -> list[str]:
    """Returns the keys of ``DEBIAN_PACKAGES`` that the machine lacks."""
    venv, headers, compiler, egl, driver = DEBIAN_PACKAGES
    missing = []
    if subprocess.run([PYTHON, "-c", "import venv, ensurepip"], capture_output=True, check=False).returncode:
        missing.append(venv)
    if not (Path(sysconfig.get_path("include")) / "Python.h").is_file():
        missing.append(headers)
    if not (shutil.which("cc") and shutil.which("c++")):
        missing.append(compiler)
    probe = subprocess.run([PYTHON, "-c", EGL_PROBE], capture_output=True, check=False).returncode
    if probe:
        missing += [egl, driver] if probe == 2 else [driver]
    return missing


def distribution_python() -> bool:
    """Returns whether the interpreter is a package of the distribution."""
    return Path(PYTHON).resolve().is_relative_to("/usr/bin")


def debian_packages(parts: Iterable[str]) -> list[str]:
    """Returns the Debian and Ubuntu packages that provide ``parts``; no Python package for an interpreter from elsewhere."""
    names = [name for part in parts for name in DEBIAN_PACKAGES[part].split()]
    if not distribution_python():
        return [name for name in names if not name.startswith("python3")]
    return [name.replace("python3", f"python{sys.version_info.major}.{sys.version_info.minor}") for name in names]


def check_system() -> None:
    """Checks for compiler, headers and OpenGL; as root, installs the missing ones."""
    missing = missing_system_parts()
    packages = debian_packages(missing)
    if packages and os.geteuid() == 0 and shutil.which("apt-get"):
        say(f"installing system packages with apt-get: {' '.join(packages)}")
        env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for command in (["update"], ["install", "-y", "--no-install-recommends", *packages]):
            if subprocess.run(["apt-get", "-qq", *command], env=env, check=False).returncode:
                say("apt-get failed, see above")
                break
        missing = missing_system_parts()
        packages = debian_packages(missing)
    if missing:
        remedies = [f"sudo apt-get install {' '.join(packages)} (Debian, Ubuntu)"] if packages else []
        if not distribution_python() and any("python3" in DEBIAN_PACKAGES[part] for part in missing):
            remedies.append(f"another interpreter than {PYTHON}, with PYTHON=...")
        raise SetupError(f"this machine lacks {', '.join(missing)}; remedy: {', and '.join(remedies)}")


def digest(paths: Iterable[Path], *texts: str) -> str:
    """Returns a hash of names and content of all files in ``paths`` (folders: recursively) and of ``texts``."""
    h = hashlib.sha256(sys.version.encode())
    for text in texts:
        h.update(text.encode() + b"\0")
    for path in paths:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            h.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes() + b"\0")
    return h.hexdigest()


class Stamp:
    """A file in the environment that holds the digest of the inputs of a finished step."""

    def __init__(self, venv: Path, name: str, key: str) -> None:
        self.file = venv / "gibson_setup" / f"{name}.stamp"
        self.key = key

    def fresh(self) -> bool:
        """Returns whether the step was done with the same inputs."""
        return self.file.is_file() and self.file.read_text() == self.key

    def write(self) -> None:
        """Marks the step as done."""
        self.file.write_text(self.key)


def make_venv(venv: Path) -> None:
    """Creates the environment; replaces one of another Python, another folder or an interrupted set-up."""
    stamp = Stamp(venv, "venv", digest([], str(venv)))
    if stamp.fresh() and (venv / "bin" / "python").exists():
        return
    if venv.exists() and any(venv.iterdir()):
        if not stamp.file.parent.is_dir():
            raise SetupError(f"{venv} was not made by this set-up; remove it, or choose another folder with VENV=<folder>")
        say(f"{venv} belongs to another Python, another folder or an interrupted set-up: making it anew")
        shutil.rmtree(venv)
    with step(f"making {venv} with Python {platform.python_version()}"):
        stamp.file.parent.mkdir(parents=True)
        run([PYTHON, "-m", "venv", str(venv)], venv, venv / "gibson_setup" / "venv.log")
    stamp.write()


def pins() -> list[str]:
    """Returns all packages of constraints.txt; pip selects those for this Python."""
    return [line for line in CONSTRAINTS.read_text().splitlines() if line and not line.startswith("#")]


def pinned(*names: str) -> list[str]:
    """Returns the lines of constraints.txt for these packages."""
    return [line for line in pins() if line.partition("==")[0] in names]


def pip(venv: Path, log: str, action: str, *arguments: str) -> None:
    """Runs a pip command in the environment: exact versions, no dependency resolution, no build isolation."""
    command = [str(venv / "bin" / "python"), "-m", "pip", action]
    command += ["--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
    run([*command, *arguments], venv, venv / "gibson_setup" / f"{log}.log")


def pybullet_wheels(venv: Path) -> Path:
    """Returns a folder with a PyBullet wheel for this Python; compiles one unless an earlier set-up has."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gibson-sim" / "wheels"
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    (requirement,) = pinned("pybullet")
    if list(cache.glob(f"{requirement.replace('==', '-')}-{tag}-{tag}-*{platform.machine()}.whl")):
        say(f"PyBullet: using the wheel of an earlier set-up, in {cache}")
        return cache
    folder = venv / "gibson_setup" / "wheels"
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    with step(f"compiling PyBullet, which has no wheel for Python {version} (3 to 5 minutes, once per machine)"):
        pip(venv, "pybullet", "wheel", "--wheel-dir", str(folder), requirement)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        for wheel in folder.glob("*.whl"):
            partial = cache / f".{wheel.name}.{os.getpid()}"
            shutil.copyfile(wheel, partial)
            partial.replace(cache / wheel.name)
    except OSError as error:
        say(f"PyBullet: the wheel is not kept for other environments: {error}")
    return folder


def install_packages(venv: Path, key: str) -> bool:
    """Installs all packages of constraints.txt. Returns whether there was something to do."""
    stamp = Stamp(venv, "packages", key)
    if stamp.fresh():
        return False
    find = []
    with step("installing the build tools"):
        pip(venv, "build_tools", "install", *pinned(*BUILD_TOOLS))
    if sys.version_info[:2] >= COMPILED_PYBULLET:
        find = ["--find-links", str(pybullet_wheels(venv))]
    ros = [line for line in pins() if line.startswith("ros-")]
    others = [line for line in pins() if line not in ros]
    # Neither group shares a file with the other or depends on it: both install in parallel.
    with step("installing the packages of constraints.txt (about a minute)"), ThreadPoolExecutor() as pool:
        both = [("ros", "install", *ros), ("packages", "install", *find, *others)]
        for installed in [pool.submit(pip, venv, *arguments) for arguments in both]:
            installed.result()
        point_exports_here(venv)
    stamp.write()
    return True


def point_exports_here(venv: Path) -> None:
    """Replaces the folders of the build machine in the CMake files of the ROS packages by this environment's."""
    code = "import numpy, sysconfig; print(sysconfig.get_path('include')); print(numpy.get_include())"
    result = subprocess.run(
        [str(venv / "bin" / "python"), "-c", code], env=clean_environment(venv), capture_output=True, text=True, check=True
    )
    python_include, numpy_include = result.stdout.split("\n")[:2]
    for file in venv.glob("share/*/cmake/*.cmake"):
        old = file.read_text()
        new = re.sub(r"/opt/python/[^/;\"]+/include/python3\.\d+", python_include, old)
        new = re.sub(r"/opt/python/[^;\"]+/numpy/_core/include", numpy_include, new)
        if new != old:
            file.write_text(new)


def built_on(venv: Path) -> str:
    """Returns a hash of the build dependencies of the message packages: a change rebuilds all of them."""
    return digest([PYTHON_ONLY], str(venv), *(line for line in pins() if line.startswith(("numpy==", "ros-"))))


def build_interfaces(venv: Path, key: str) -> bool:
    """Builds the message packages with colcon, into the environment itself. Returns whether there was something to do."""
    stamp, below = Stamp(venv, "interfaces", key), Stamp(venv, "built_on", built_on(venv))
    if stamp.fresh():
        return False
    if not below.fresh():
        shutil.rmtree(venv / "ros_build", ignore_errors=True)
        below.write()
    python, base = venv / "bin" / "python", venv / "ros_build"
    command = [str(python), "-m", "colcon", "--log-base", str(base / "log"), "build", "--base-paths", *map(str, INTERFACES)]
    command += ["--merge-install", "--install-base", str(venv), "--build-base", str(base / "build")]
    command += ["--cmake-args", "-G", "Ninja"]
    command += [f"-DPython3_EXECUTABLE={python}", "-DBUILD_TESTING=OFF", "-DCMAKE_BUILD_TYPE=Release", "--no-warn-unused-cli"]
    flags = f'-O1 "-ffile-prefix-map={base / "build"}=."'  # no folder of this machine in the libraries, which become wheels
    command += [f"-Drosidl_default_generators_DIR={PYTHON_ONLY}"]
    command += [f"-DCMAKE_C_FLAGS_RELEASE={flags}", f"-DCMAKE_CXX_FLAGS_RELEASE={flags}"]
    # Both variables together start one compiler per core: on a busy machine colcon would start fewer.
    jobs = {"MAKEFLAGS": f"-j{os.cpu_count()}", "CMAKE_BUILD_PARALLEL_LEVEL": str(os.cpu_count())}
    extra = {"AMENT_PREFIX_PATH": str(venv), "CMAKE_PREFIX_PATH": str(venv), "COLCON_HOME": str(base / "home"), **jobs}
    with step("building the message packages with colcon (a minute or two the first time)"):
        run(command, venv, venv / "gibson_setup" / "interfaces.log", extra)
    stamp.write()
    return True


def install_project(venv: Path) -> bool:
    """Installs Gibson Sim, path following and the examples from the source tree, editable. Returns whether there was something to do."""
    files = [project / name for project in PROJECTS for name in ("setup.py", "setup.cfg", "pyproject.toml")]
    shared = [str(path) for project in PROJECTS for path in shared_parts(project)]
    stamp = Stamp(venv, "project", digest(files, str(ROOT), str(venv), EDITABLE, *shared))
    if stamp.fresh():
        return False
    with step(f"installing {', '.join(project.name for project in PROJECTS)} from the source tree"):
        for project in PROJECTS:
            pip(venv, project.name, "install", "--config-settings", EDITABLE, "--editable", str(project))
            put_into_ament_index(venv, project)
    stamp.write()
    return True


def draw_first_image(venv: Path) -> bool:
    """Steps and draws a scene once: it compiles the numeric loops, for which the first simulation would wait. Returns whether it did."""
    package = ROOT / "src" / "gibson_sim" / "gibson_sim"
    stamp = Stamp(venv, "first_image", digest([package / "geometry" / "compiling.py", *COMPILED], str(venv)))
    if stamp.fresh():
        return False
    command = [str(venv / "bin" / "python"), "-c", FIRST_IMAGE]
    try:
        with step("compiling numeric loops, and drawing a first image"):
            run(command, venv, venv / "gibson_setup" / "first_image.log")
    except SetupError:  # for example a driver that cannot draw: all else works
        say(f"no image could be drawn, see above; `{venv / 'bin' / 'gibson-sim'} doctor` says what is missing")
        return False
    stamp.write()
    return True


def shared_parts(project: Path) -> list[Path]:
    """Returns the folders and files of a project that ``SHARED`` names and that exist."""
    return sorted(path for part in SHARED for path in project.glob(part) if path.exists() and path.name != "__pycache__")


def put_into_ament_index(venv: Path, project: Path) -> None:
    """Creates the links through which launch and `ros2 run` find an editable installation of pip."""
    name, share = project.name, venv / "share"
    links = {share / "ament_index" / "resource_index" / "packages" / name: project / "resource" / name}
    links |= {share / name / path.relative_to(project): path for path in shared_parts(project)}
    scripts = configparser.ConfigParser()
    scripts.read(venv.glob(f"lib/python3.*/site-packages/{name}-*.dist-info/entry_points.txt"))
    programs = scripts["console_scripts"] if scripts.has_section("console_scripts") else ()
    links |= {venv / "lib" / name / script: venv / "bin" / script for script in programs}
    shutil.rmtree(share / name, ignore_errors=True)
    for link, target in links.items():
        link.parent.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(target)


@contextlib.contextmanager
def exclusive_set_up(venv: Path) -> Iterator[None]:
    """Holds a lock that excludes other set-ups in the same folder."""
    venv.parent.mkdir(parents=True, exist_ok=True)
    folder = os.open(venv.parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def set_up(venv: Path) -> None:
    """Brings the environment up to date."""
    if sys.version_info[:2] not in SUPPORTED or platform.python_implementation() != "CPython":
        names = ", ".join(f"{major}.{minor}" for major, minor in SUPPORTED)
        raise SetupError(
            f"Python is {platform.python_implementation()} {platform.python_version()}, must be CPython {names}; "
            "choose one with PYTHON=python3.12 make setup"
        )
    packages = digest([CONSTRAINTS], str(venv))
    interfaces = digest(INTERFACES, built_on(venv))
    if not (Stamp(venv, "packages", packages).fresh() and Stamp(venv, "interfaces", interfaces).fresh()):
        check_system()
    make_venv(venv)
    done = [install_packages(venv, packages), build_interfaces(venv, interfaces), install_project(venv), draw_first_image(venv)]
    say(f"{venv} is ready" if any(done) else f"{venv} is up to date")


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description="Creates the environment in which Gibson Sim runs.")
    parser.add_argument(
        "--venv", type=Path, default=ROOT / ".venv", help="folder of the environment (default: .venv beside this file)"
    )
    venv = Path(os.path.abspath(parser.parse_args().venv))
    try:
        with exclusive_set_up(venv):
            set_up(venv)
    except SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: interrupted; the next `make setup` continues", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
