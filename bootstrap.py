#!/usr/bin/env python3
"""Creates the virtual environment in which Gibson Sim runs: ROS 2 Jazzy, PyBullet, the message packages and Gibson Sim itself.

`make setup` calls this program, which uses the standard library alone. Each step leaves a stamp in the environment with a digest
of its inputs, so a second run finds nothing to do. What takes long is kept in the user's cache: packages (by uv), the message packages and
compiled loops, each by a digest of what it is made from, so a second clone needs seconds. An error is one line that begins with "error:".
"""

from __future__ import annotations

import argparse
import configparser
import contextlib
import fcntl
import functools
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
LAYOUT = "3"
"""Version of the environment's layout: one with another layout is made anew."""
EDITABLE = "editable_mode=compat"
"""Of setuptools: editable packages are found by folders in a .pth file. Its default, an import hook, loses against a folder with the name of a
package in the working directory, such as that of a clone: `import gibson_sim` would then import the empty folder."""
INTERFACES = (ROOT / "src" / "gibson_msgs", ROOT / "ros_ws" / "src" / "compat")
PYTHON_ONLY = ROOT / "ros_ws" / "src" / "compat" / "python_only"
"""Folder of the CMake package that limits message generation to Python."""

SHARED = ("config", "launch/*", "package.xml", "scenes")
"""Parts of a project that are linked into its share folder. `ros2 launch` searches there for files, but not in linked folders."""

SUPPORTED = ((3, 10), (3, 11), (3, 12), (3, 13))
BUILD_TOOLS = ("packaging", "setuptools", "wheel")
"""Packages that pip needs to build source packages, without build isolation."""
MESSAGE_TOOLS = ("numpy", "packaging", "python-dateutil", "pyyaml", "six", "typing-extensions")
"""Packages that the message packages are built with, besides those of ``MESSAGE_SECTIONS``."""
MESSAGE_SECTIONS = ("ROS 2 Jazzy", "Building the message packages")
"""Sections of constraints.txt with which the message packages are built."""
MESSAGE_FLAGS = ("-O1",)
"""Flags of the compiler for the message packages."""
PREFIX = "@prefix@"
"""Stands in kept builds for the folder into which they are installed."""
NAMING_PREFIX = (".cmake", ".sh", ".bash", ".zsh", ".py", ".dsv", ".pc")
"""Suffixes of installed files that may name that folder."""
BUILT = "gibson_setup/messages.txt"
"""File that a finished build has, below the folder where it is installed."""
PARENTS = "share/ament_index/resource_index/parent_prefix_path"
"""Folder, below the same, of entries that name the environment in which a message package was built; nothing reads them."""
MANIFESTS = "gibson_setup/messages"
"""Folder, below the same, with a list of installed files for each message package."""
PIP = ("--disable-pip-version-check", "--no-compile")
"""Options of pip. Python compiles a module when it is first imported, which few of them are; ``NODES`` imports these."""
KEPT_BUILDS = 4
"""Builds of the message packages, and of the loops, that the user's cache keeps, the most recently used ones."""

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
NODES = """
import gibson_sim.cli.commands.run, gibson_sim.ros.nodes.drive_node, gibson_sim.ros.nodes.physics_node, gibson_sim.ros.nodes.record_node
import gibson_sim.ros.nodes.render_node, gibson_sim.ros.nodes.web_node
"""
"""Program that imports what nodes need."""


class SetupError(Exception):
    """A failure of the set-up, with its remedy, in one line.

    Args:
        message: the line.
        log: output of the program that failed; its end is printed before the line if the failure ends the set-up.
    """

    def __init__(self, message: str, log: Path | None = None) -> None:
        super().__init__(message)
        self.log = log


_running: dict[str, float] = {}
"""The steps under way -> when they began, in seconds of the monotonic clock."""
_output = threading.Lock()
CLEAR_LINE = "\r\x1b[K"
"""Returns to the start of the line of a terminal and clears it."""


def say(text: str) -> None:
    """Prints a line unbuffered, in order with the output of other programs."""
    with _output:
        print(f"{CLEAR_LINE if sys.stdout.isatty() else ''}gibson-sim setup: {text}", flush=True)


@contextlib.contextmanager
def counted_steps() -> Iterator[None]:
    """Counts the seconds of the steps under way in the last line of a terminal; elsewhere does nothing."""
    done = threading.Event()

    def count() -> None:
        while not done.wait(1.0):
            with _output:
                now = time.monotonic()
                texts = [f"{text} ... {now - began:.0f} s" for text, began in list(_running.items())]
                line = f"gibson-sim setup: {'; '.join(texts)}"[: shutil.get_terminal_size().columns - 1]
                print(f"{CLEAR_LINE}{line if texts else ''}", end="", flush=True)

    counter = threading.Thread(target=count, daemon=True)
    if sys.stdout.isatty():
        counter.start()
    try:
        yield
    finally:
        done.set()
        if counter.ident:
            counter.join()
            print(CLEAR_LINE, end="", flush=True)


@contextlib.contextmanager
def step(text: str) -> Iterator[None]:
    """Says what the block does and, if it succeeds, how long it took. Steps may run side by side."""
    began = _running[text] = time.monotonic()
    if not sys.stdout.isatty():
        say(f"{text} ...")
    try:
        yield
    finally:
        del _running[text]
    say(f"{text}: {time.monotonic() - began:.0f} s")


def clean_environment(venv: Path) -> dict[str, str]:
    """Returns the environment variables for programs of ``venv``, without those of another installation."""
    env = {k: v for k, v in os.environ.items() if k not in (*FOREIGN, BOOTSTRAPPED, "PYTHONDONTWRITEBYTECODE")}
    env["PATH"] = f"{venv / 'bin'}{os.pathsep}{env.get('PATH', os.defpath)}"
    env["PYTHONNOUSERSITE"] = "1"
    return env


def run(command: list[str], venv: Path, log: Path, extra: dict[str, str] | None = None) -> None:
    """Runs a program with its output in ``log``."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as out:
        code = subprocess.run(
            command, cwd=ROOT, env={**clean_environment(venv), **(extra or {})}, stdout=out, stderr=subprocess.STDOUT, check=False
        ).returncode
    if code:
        raise SetupError(
            f"{Path(command[0]).name} {' '.join(command[1:4])} ... ended with code {code}; its output is in {log}", log
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
    """Creates the environment, without pip; replaces one of another Python, folder or layout, or of an interrupted set-up."""
    stamp = Stamp(venv, "venv", digest([], str(venv), LAYOUT))
    if stamp.fresh() and (venv / "bin" / "python").exists():
        return
    if venv.exists() and any(venv.iterdir()):
        if not stamp.file.parent.is_dir():
            raise SetupError(f"{venv} was not made by this set-up; remove it, or choose another folder with VENV=<folder>")
        say(f"{venv} belongs to another Python or folder, or to an older or interrupted set-up: making it anew")
        shutil.rmtree(venv)
    with step(f"making {venv} with Python {platform.python_version()}"):
        stamp.file.parent.mkdir(parents=True)
        run([PYTHON, "-m", "venv", "--without-pip", str(venv)], venv, venv / "gibson_setup" / "venv.log")
    stamp.write()


def sections() -> dict[str, list[str]]:
    """Returns the packages of constraints.txt, each with its version, by the headings above them; the installer selects those for this Python."""
    found: dict[str, list[str]] = {}
    for line in CONSTRAINTS.read_text().splitlines():
        if line.startswith("# "):
            packages = found.setdefault(line[2:], [])
        elif line:
            packages.append(line)
    return {heading: packages for heading, packages in found.items() if packages}


def pins() -> list[str]:
    """Returns all packages of constraints.txt."""
    return [line for packages in sections().values() for line in packages]


def pinned(*names: str) -> list[str]:
    """Returns the lines of constraints.txt for these packages."""
    return [line for line in pins() if line.partition("==")[0] in names]


def user_cache() -> Path:
    """Returns the folder in the user's cache where builds are kept for other environments."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gibson-sim"


def pip_settings() -> dict[str, list[str]]:
    """Returns pip's settings about package indexes, from its files and variables: "index-url", "extra-index-url", "find-links"... -> values."""
    config = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    folders = [Path(folder) for folder in os.environ.get("XDG_CONFIG_DIRS", "/etc/xdg").split(":")]
    files = [*(folder / "pip" / "pip.conf" for folder in folders), Path("/etc/pip.conf")]
    files += [Path.home() / ".pip" / "pip.conf", config / "pip" / "pip.conf"]
    if "PIP_CONFIG_FILE" in os.environ:
        files.append(Path(os.environ["PIP_CONFIG_FILE"]))
    parser = configparser.RawConfigParser(strict=False)
    with contextlib.suppress(configparser.Error, UnicodeDecodeError):
        parser.read(files)
    values = {name: value for section in ("global", "install") if section in parser for name, value in parser[section].items()}
    values |= {name[4:].lower().replace("_", "-"): value for name, value in os.environ.items() if name.startswith("PIP_")}
    return {name: value.split() for name, value in values.items()}


def uv_arguments() -> list[str]:
    """Returns the options of uv that stand for pip's settings about package indexes: uv reads neither pip's files nor its variables."""
    settings, arguments = pip_settings(), []
    for name, option in (
        ("index-url", "--default-index"),
        ("extra-index-url", "--index"),
        ("find-links", "--find-links"),
        ("trusted-host", "--allow-insecure-host"),
    ):
        arguments += [part for value in settings.get(name, ()) for part in (option, value)]
    return [*arguments, "--no-index"] if settings.get("no-index", ["0"])[0].lower() in ("1", "true", "yes", "on") else arguments


def uv_environment() -> dict[str, str]:
    """Returns the environment variables of uv that stand for pip's settings about certificates and proxies."""
    settings = pip_settings()
    names = {"cert": ("SSL_CERT_FILE",), "proxy": ("HTTP_PROXY", "HTTPS_PROXY")}
    return {
        name: settings[key][0]
        for key, variables in names.items()
        if settings.get(key)
        for name in variables
        if name not in os.environ
    }


@functools.cache
def uv(venv: Path) -> Path | None:
    """Returns the program uv, which installs packages several times as fast as pip; fetches it unless an earlier set-up has."""
    (requirement,) = pinned("uv")
    tag = f"{platform.system().lower()}-{platform.machine()}-{'-'.join(platform.libc_ver()).strip('-')}"
    kept = user_cache() / requirement.replace("==", "-") / tag
    folders = [kept, venv / "gibson_setup" / "uv"]
    for folder in folders:
        if (folder / "bin" / "uv").is_file():
            return folder / "bin" / "uv"
    for folder in folders:
        partial = folder.with_name(f".{folder.name}.{os.getpid()}")
        try:
            partial.mkdir(parents=True)
            pip(venv, "uv", "--target", str(partial), requirement)
            with contextlib.suppress(OSError):  # another set-up was faster
                partial.replace(folder)
            return folder / "bin" / "uv"
        except OSError:
            continue  # the user's cache cannot be written
        except SetupError as error:
            say(f"uv cannot be had, so pip installs the packages, which takes longer: {error}")
            break
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    return None


def pip(venv: Path, log: str, *arguments: str) -> None:
    """Installs packages by pip: exact versions, no dependency resolution. An environment without pip gets that of Python."""
    python = str(venv / "bin" / "python")
    if not (venv / "bin" / "pip").exists():
        run([python, "-m", "ensurepip", "--default-pip"], venv, venv / "gibson_setup" / "ensurepip.log")
    run([python, "-m", "pip", "install", *PIP, "--no-deps", *arguments], venv, venv / "gibson_setup" / f"{log}.log")


def install(venv: Path, log: str, *packages: str) -> None:
    """Installs packages: exact versions, no dependency resolution, no build isolation. By uv, or by pip where uv fails.

    Args:
        venv: the environment.
        log: name of the log in the environment's folder gibson_setup.
        packages: requirements and options that uv and pip share.
    """
    if program := uv(venv):
        # Where the user's cache cannot be written, uv was put into the environment, and needs a cache there.
        cache = {"UV_CACHE_DIR": str(venv / "gibson_setup" / "uv_cache")} if program.is_relative_to(venv) else {}
        command = [str(program), "pip", "install", "--python", str(venv / "bin" / "python"), "--no-deps", "--no-build-isolation"]
        # pip takes the newest version of all indexes, uv by default that of the first index that has the package.
        command += ["--index-strategy", "unsafe-best-match", *uv_arguments()]
        try:
            run([*command, *packages], venv, venv / "gibson_setup" / f"{log}.log", {**uv_environment(), **cache})
            return
        except SetupError as error:
            say(f"pip installs what uv could not: {error}")
    pip(venv, log, "--no-build-isolation", *packages)


def message_packages() -> list[str]:
    """Returns the lines of constraints.txt with which the message packages are built."""
    found = sections()
    return [*pinned(*MESSAGE_TOOLS), *(line for heading in MESSAGE_SECTIONS for line in found[heading])]


def install_message_tools(venv: Path, key: str) -> bool:
    """Installs what the message packages are built with. Returns whether there was something to do."""
    stamp = Stamp(venv, "message_tools", key)
    if stamp.fresh():
        return False
    with step("installing ROS 2 Jazzy and the build tools"):
        install(venv, "build_tools", *pinned(*BUILD_TOOLS))
        install(venv, "ros", *message_packages())
        point_exports_here(venv)
    stamp.write()
    return True


def install_packages(venv: Path, key: str) -> bool:
    """Installs all other packages of constraints.txt. Returns whether there was something to do."""
    stamp = Stamp(venv, "packages", key)
    if stamp.fresh():
        return False
    before = set(message_packages())
    with step("installing the other packages of constraints.txt"):
        install(venv, "packages", *(line for line in pins() if line not in before))
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
            file.unlink()  # it may be a link to a file in uv's cache, which other environments share
            file.write_text(new)


def built_on(*texts: str) -> str:
    """Returns a hash of what the message packages are built with."""
    packages = (line for line in pins() if line.startswith(("numpy==", "ros-")))
    return digest([PYTHON_ONLY], LAYOUT, *MESSAGE_FLAGS, platform.machine(), *platform.libc_ver(), *packages, *texts)


def messages_key(*texts: str) -> str:
    """Returns a hash of all that the message packages are built from."""
    return digest(INTERFACES, built_on(), *texts)


def install_messages(venv: Path) -> bool:
    """Copies the message packages into the environment, built before or now. Returns whether there was something to do."""
    key = messages_key()
    stamp = Stamp(venv, "interfaces", messages_key(str(venv)))
    if stamp.fresh():
        return False
    stamp.file.unlink(missing_ok=True)
    # Those of an earlier set-up: colcon would take them for those of a ROS installation below.
    for manifest in (venv / MANIFESTS).glob("*.txt"):
        for line in manifest.read_text().splitlines():
            (venv / line).unlink(missing_ok=True)
    kept = user_cache() / "messages" / key
    if (kept / BUILT).is_file():
        say(f"messages: taking those that were built before, in {kept}")
        os.utime(kept)
    else:
        kept = keep_messages(build_messages(venv, key), kept)
    for source in sorted(path for path in kept.rglob("*") if not path.is_dir()):
        target = venv / source.relative_to(kept)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        if source.suffix in NAMING_PREFIX:
            target.write_text(source.read_text().replace(PREFIX, str(venv)))
        else:
            shutil.copy2(source, target, follow_symlinks=False)
    stamp.write()
    return True


def build_messages(venv: Path, key: str) -> Path:
    """Builds the message packages with colcon. Returns the folder where they are installed; its files name it by ``PREFIX``."""
    python, base = venv / "bin" / "python", venv / "ros_build"
    stamp = Stamp(venv, "built_on", built_on(str(venv)))
    if not stamp.fresh():
        shutil.rmtree(base, ignore_errors=True)
        stamp.write()  # an interrupted build goes on
    prefix = base / "install"
    shutil.rmtree(prefix, ignore_errors=True)
    command = [str(python), "-m", "colcon", "--log-base", str(base / "log"), "build", "--base-paths", *map(str, INTERFACES)]
    command += ["--merge-install", "--install-base", str(prefix), "--build-base", str(base / "build")]
    command += ["--cmake-args", "-G", "Ninja"]
    command += [f"-DPython3_EXECUTABLE={python}", "-DBUILD_TESTING=OFF", "-DCMAKE_BUILD_TYPE=Release", "--no-warn-unused-cli"]
    # no folder of this machine in the libraries, which become wheels
    flags = f'{" ".join(MESSAGE_FLAGS)} "-ffile-prefix-map={base / "build"}=."'
    command += [f"-Drosidl_default_generators_DIR={PYTHON_ONLY}"]
    command += [f"-DCMAKE_C_FLAGS_RELEASE={flags}", f"-DCMAKE_CXX_FLAGS_RELEASE={flags}"]
    # Both variables together start one compiler per core: on a busy machine colcon would start fewer.
    jobs = {"MAKEFLAGS": f"-j{os.cpu_count()}", "CMAKE_BUILD_PARALLEL_LEVEL": str(os.cpu_count())}
    extra = {"AMENT_PREFIX_PATH": str(venv), "CMAKE_PREFIX_PATH": str(venv), "COLCON_HOME": str(base / "home"), **jobs}
    with step("building the message packages (half a minute to a minute, once per machine)"):
        run(command, venv, venv / "gibson_setup" / "interfaces.log", extra)
    shutil.rmtree(prefix / PARENTS, ignore_errors=True)
    for package in (base / "build").glob("*/install_manifest.txt"):
        files = [Path(line).relative_to(prefix) for line in package.read_text().splitlines()]
        manifest = prefix / MANIFESTS / f"{package.parent.name}.txt"
        manifest.parent.mkdir(parents=True, exist_ok=True)
        manifest.write_text("".join(f"{file}\n" for file in sorted(files) if (prefix / file).exists()))
    for file in prefix.rglob("*"):
        if file.suffix in NAMING_PREFIX and file.is_file():
            file.write_text(file.read_text().replace(str(prefix), PREFIX).replace(str(venv), PREFIX))
    (prefix / BUILT).write_text(key + "\n")
    return prefix


def keep_messages(built: Path, kept: Path) -> Path:
    """Copies built message packages into the user's cache and removes old ones from it. Returns the copy, or the original if it cannot be kept."""
    partial = kept.with_name(f".{kept.name}.{os.getpid()}")
    try:
        shutil.copytree(built, partial, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        if not kept.exists():
            partial.replace(kept)
        forget_old_builds(kept)
    except OSError as error:
        say(f"the message packages are not kept for other environments: {error}")
        return built
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return kept


def forget_old_builds(used: Path) -> None:
    """Removes the builds beside ``used``, a build in the user's cache, but for the most recently used ones."""
    os.utime(used)
    builds = [path for path in used.parent.iterdir() if not path.name.startswith(".")]
    for old in sorted(builds, key=lambda path: path.stat().st_mtime, reverse=True)[KEPT_BUILDS:]:
        shutil.rmtree(old, ignore_errors=True)


def install_project(venv: Path) -> bool:
    """Installs Gibson Sim, path following and the examples from the source tree, editable. Returns whether there was something to do."""
    files = [project / name for project in PROJECTS for name in ("setup.py", "setup.cfg", "pyproject.toml")]
    shared = [str(path) for project in PROJECTS for path in shared_parts(project)]
    stamp = Stamp(venv, "project", digest(files, str(ROOT), str(venv), EDITABLE, *shared))
    if stamp.fresh():
        return False
    with step(f"installing {', '.join(project.name for project in PROJECTS)} from the source tree"):
        editable = [argument for project in PROJECTS for argument in ("--editable", str(project))]
        install(venv, "projects", "--config-settings", EDITABLE, *editable)
        for project in PROJECTS:
            put_into_ament_index(venv, project)
    stamp.write()
    return True


def draw_first_image(venv: Path) -> bool:
    """Steps and draws a scene once: it compiles the numeric loops, for which the first simulation would wait. Returns whether it did."""
    package = ROOT / "src" / "gibson_sim" / "gibson_sim"
    sources = [package / "geometry" / "compiling.py", *COMPILED]
    stamp = Stamp(venv, "first_image", digest(sources, str(venv)))
    if stamp.fresh():
        return False
    kept = user_cache() / "loops" / digest(sources, *pinned("llvmlite", "numba", "numpy"))
    compiled = copy_loops(kept, package)
    command = [str(venv / "bin" / "python"), "-c", FIRST_IMAGE]
    try:
        with step("drawing a first image" if compiled else "compiling numeric loops, and drawing a first image"):
            run(command, venv, venv / "gibson_setup" / "first_image.log")
    except SetupError as error:  # for example a driver that cannot draw: all else works
        say(f"no image could be drawn; `{venv / 'bin' / 'gibson-sim'} doctor` says what is missing: {error}")
        return False
    if copy_loops(package, kept) and kept.is_dir():
        forget_old_builds(kept)
    stamp.write()
    return True


def compile_nodes(venv: Path) -> None:
    """Imports the nodes, which compiles their modules. Otherwise, the first simulation would do so; or each one, if PYTHONDONTWRITEBYTECODE is
    set or another user owns the environment.
    """
    try:
        with step("compiling the modules of the nodes"):
            run([str(venv / "bin" / "python"), "-c", NODES], venv, venv / "gibson_setup" / "nodes.log")
    except SetupError as error:
        say(f"the nodes cannot be imported; `{venv / 'bin' / 'gibson-sim'} doctor` says what is missing: {error}")


def copy_loops(source: Path, target: Path) -> bool:
    """Copies compiled loops between our package and the user's cache. Numba looks for them beside a module, and checks a digest of its source
    and the processor. Returns whether there were any.
    """
    package = ROOT / "src" / "gibson_sim" / "gibson_sim"
    files = [
        file
        for module in COMPILED
        for file in (source / module.relative_to(package).parent / "__pycache__").glob(f"{module.stem}.*.nb[ci]")
    ]
    with contextlib.suppress(OSError):  # without them, the loops are compiled
        for file in files:
            copy = target / file.relative_to(source)
            copy.parent.mkdir(parents=True, exist_ok=True)
            partial = copy.with_name(f".{copy.name}.{os.getpid()}")
            shutil.copyfile(file, partial)
            partial.replace(copy)
    return bool(files)


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
    tools, packages = (digest([], str(venv), *lines) for lines in (message_packages(), pins()))
    if not (Stamp(venv, "packages", packages).fresh() and Stamp(venv, "interfaces", messages_key(str(venv))).fresh()):
        check_system()
    with counted_steps(), ThreadPoolExecutor() as pool:
        make_venv(venv)
        done = [install_message_tools(venv, tools)]
        messages = pool.submit(install_messages, venv)
        # Downloads, while compilers work
        done += [install_packages(venv, packages), install_project(venv), draw_first_image(venv)]
        done.append(messages.result())
        if any(done):
            compile_nodes(venv)
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
        if error.log is not None and error.log.is_file():
            print("\n".join(error.log.read_text(errors="replace").splitlines()[-30:]), file=sys.stderr)
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(
            f"error: {error.filename or venv}: {error.strerror or error}; the environment is {venv}: VENV=DIR chooses another folder",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print("error: interrupted; the next `make setup` continues", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
