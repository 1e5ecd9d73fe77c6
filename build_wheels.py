#!/usr/bin/env python3
"""Builds the wheels of Gibson Sim: its Python packages, its scenes, and the message packages with their generated code.

`make wheels` calls this program with the Python of the environment that `make setup` made, where the message packages are built
already. A wheel of messages fits that version of CPython; all other wheels fit every supported one. Nothing is published. An error
is one line that begins with "error:".
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from email.message import Message
from pathlib import Path

from bootstrap import MANIFESTS, ROOT, SetupError, clean_environment, pinned
from wheel.wheelfile import WheelFile

VENV = Path(sys.prefix)
PROJECTS = (
    *(ROOT / "src" / name for name in ("gibson_sim", "gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench")),
    ROOT / "ros_ws" / "src" / "gibson_path_following",
)
COMPAT = ROOT / "ros_ws" / "src" / "compat"
MESSAGES = {
    "gibson_msgs": ROOT / "src" / "gibson_msgs",
    **{
        f"gibson_sim_{name}": COMPAT / name
        for name in ("control_msgs", "rosbag2_interfaces", "simulation_interfaces", "tf2_msgs")
    },
}
"""Distribution -> source folder of its message package. The names of ROS packages on an index belong to those who build ROS."""
SCENES = "gibson_sim_scenes"
"""Distribution of the scenes: fifty times as large as the code, and changed less often."""
MOST_BYTES = 100_000_000
"""Size limit of a wheel: that of PyPI."""
ROS_GLIBC = (2, 28)
"""glibc of the ROS wheels (manylinux_2_28), without which a wheel of messages does nothing."""
ROS_GLIBCXX = (3, 4, 24)
"""Newest symbols of libstdc++ that manylinux_2_28 allows."""
SHARED = re.compile(r"ament_index/.*|\w+/(package\.xml|(msg|srv|action)/.*)")
"""Files in the share folder that programs read; the CMake files beside them name folders of this machine."""
NOT_PACKED = re.compile(r"\.egg-info/|__pycache__/|\.(c|cpp|h|hpp)$")
"""Files in site-packages that no program reads: sources, and metadata in place of which the wheel has its own."""
CLASSIFIERS = (
    "Development Status :: 4 - Beta",
    "Intended Audience :: Developers",
    "Intended Audience :: Science/Research",
    "Operating System :: POSIX :: Linux",
    "Programming Language :: Python :: 3",
    "Topic :: Scientific/Engineering",
)
MESSAGES_TEXT = """{summary}

The message package `{package}` with its generated Python code, for the ROS 2 Jazzy packages of PyPI (`ros-jazzy-rclpy`), beside which pip
installs it. A ROS installation from other sources has, or builds, its own `{package}`.
"""
SCENES_TEXT = """The scenes of Gibson Sim: furnished homes and offices, a shop, and the objects of the catalogue.

Gibson Sim (`gibson_sim`) finds them by their names: `gibson-sim run --scene linden_flat`. They were made for it.
"""


def build(folder: Path) -> list[Path]:
    """Builds all wheels into ``folder`` and returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["SOURCE_DATE_EPOCH"] = "315532800"  # 1980: the same sources make the same bytes
    return [*_build_projects(folder), _build_scenes(folder), *(_build_messages(folder, name) for name in MESSAGES)]


def version() -> str:
    """Returns the version of Gibson Sim, which all wheels have."""
    return ElementTree.parse(PROJECTS[0] / "package.xml").findtext("version") or ""


def _build_projects(folder: Path) -> list[Path]:
    """Builds the wheels of our Python packages."""
    made = []
    with tempfile.TemporaryDirectory() as temporary:
        for project in PROJECTS:
            copy = Path(temporary) / project.name
            # A copy: setuptools builds in the source folder, and packs what an earlier build left there, too.
            shutil.copytree(project, copy, symlinks=True, ignore=shutil.ignore_patterns("build", "*.egg-info", "__pycache__"))
            shutil.copyfile(ROOT / "LICENSE", copy / "LICENSE")
            for link in [path for path in copy.iterdir() if path.is_symlink()]:
                link.unlink()
                if link.name != "scenes":
                    shutil.copytree(project / link.name, link)
            command = [sys.executable, "-m", "pip", "wheel", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
            done = subprocess.run(
                [*command, "--no-index", "--wheel-dir", str(folder), str(copy)],
                env=clean_environment(VENV),
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                print(done.stdout + done.stderr, file=sys.stderr)
                raise SetupError(f"pip cannot build {project.name}, see above")
            made.append(folder / f"{project.name}-{version()}-py3-none-any.whl")
    return made


def _build_scenes(folder: Path) -> Path:
    """Builds the wheel of the scenes, which pip unpacks into the share folder of ``gibson_sim``."""
    files = [path for path in (ROOT / "scenes").rglob("*") if path.is_file()]
    data = f"{SCENES}-{version()}.data/data/share/gibson_sim"
    places = {
        f"{data}/{path.relative_to(ROOT)}": path
        for path in files
        if not any(part.startswith(".") or part == "__pycache__" for part in path.relative_to(ROOT).parts)
    }
    text = _metadata(SCENES, "Scenes of Gibson Sim: furnished homes, offices and a shop", "Apache-2.0", (), SCENES_TEXT)
    return _write_wheel(folder, SCENES, "py3-none-any", text, places)


def _build_messages(folder: Path, name: str) -> Path:
    """Builds the wheel of a message package from what `make setup` has installed of it."""
    source = MESSAGES[name]
    manifest = VENV / MANIFESTS / f"{source.name}.txt"
    if not manifest.is_file():
        raise SetupError(f"{VENV} has no {source.name}: run `make setup` first")
    installed = [VENV / line for line in manifest.read_text().splitlines()]
    places = {}
    for path in installed:
        below = path.relative_to(VENV).as_posix()
        kind, _, rest = below.partition("/")
        _, site, module = below.partition("/site-packages/")
        if site and not NOT_PACKED.search(module):
            places[module] = path
        elif (kind == "share" and SHARED.fullmatch(rest)) or (kind == "lib" and not site):
            places[f"{name}-{version()}.data/data/{below}"] = path
    package = ElementTree.parse(source / "package.xml")
    depends = [element.text or "" for kind in ("depend", "exec_depend") for element in package.iterfind(kind)]
    summary = (package.findtext("description") or "").strip()
    text = _metadata(
        name,
        summary.partition(". ")[0].removesuffix("."),
        package.findtext("license") or "",
        ["numpy", "ros-wheels-bootstrapper", *map(_compatible, depends)],
        MESSAGES_TEXT.format(summary=summary, package=source.name),
    )
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    return _write_wheel(folder, name, f"{tag}-{tag}-{_platform(places.values())}", text, places)


def _compatible(package: str) -> str:
    """Returns the requirement of a ROS package: the minor version that our generated code was built with."""
    try:
        (pin,) = pinned(f"ros-{package.replace('_', '-')}")
    except ValueError:
        raise SetupError(f"constraints.txt has no version of the ROS package {package}, on which messages depend") from None
    return pin.replace("==", "~=")


def _platform(files: Iterable[Path]) -> str:
    """Returns the platform tag of compiled code, by the versions of the symbols that it needs of the C and C++ libraries."""
    libraries = [str(file) for file in files if file.suffix == ".so"]
    if shutil.which("readelf") is None:
        raise SetupError("this machine lacks readelf, which tells where compiled code runs; remedy: apt-get install binutils")
    text = subprocess.run(["readelf", "--version-info", "--wide", *libraries], capture_output=True, text=True, check=True).stdout
    newest = {
        library: max((tuple(map(int, found.split("."))) for found in re.findall(rf"Name: {library}_([0-9.]+)", text)), default=())
        for library in ("GLIBC", "GLIBCXX")
    }
    if newest["GLIBCXX"] > ROS_GLIBCXX:
        return f"linux_{platform.machine()}"
    major, minor = max(newest["GLIBC"], ROS_GLIBC)[:2]
    return f"manylinux_{major}_{minor}_{platform.machine()}"


def _metadata(name: str, summary: str, licence: str, requires: Iterable[str], description: str) -> str:
    """Returns the text of METADATA (https://packaging.python.org/specifications/core-metadata/)."""
    message = Message()
    message["Metadata-Version"] = "2.4"
    message["Name"], message["Version"], message["Summary"] = name, version(), summary
    message["Author"] = message["Maintainer"] = "Gibson Sim maintainers"
    message["Maintainer-Email"] = "maintainers@gibson-sim.example"
    message["License-Expression"], message["License-File"] = licence, "LICENSE"
    message["Requires-Python"] = ">=3.10"
    for key, values in (("Classifier", CLASSIFIERS), ("Requires-Dist", sorted(requires))):
        for value in values:
            message[key] = value
    message["Description-Content-Type"] = "text/markdown"
    message.set_payload(description)
    return message.as_string()


def _write_wheel(folder: Path, name: str, tag: str, metadata: str, files: Mapping[str, Path]) -> Path:
    """Writes a wheel.

    Args:
        folder: receives it.
        name: of the distribution, with underscores.
        tag: compatibility tag, such as ``py3-none-any``.
        metadata: text of METADATA.
        files: place in the wheel -> file.
    """
    made = folder / f"{name}-{version()}-{tag}.whl"
    info = f"{name}-{version()}.dist-info"
    pure = "true" if tag.endswith("-none-any") else "false"
    with WheelFile(made, "w") as wheel:
        for place, file in sorted(files.items()):
            wheel.writestr(place, file.read_bytes())
        wheel.writestr(f"{info}/licenses/LICENSE", (ROOT / "LICENSE").read_bytes())
        wheel.writestr(f"{info}/METADATA", metadata)
        wheel.writestr(f"{info}/WHEEL", f"Wheel-Version: 1.0\nGenerator: build_wheels.py\nRoot-Is-Purelib: {pure}\nTag: {tag}\n")
    return made


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description="Builds the wheels of Gibson Sim.")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "wheels", help="folder of the wheels (default: out/wheels)")
    try:
        for wheel in build(parser.parse_args().output):
            size = wheel.stat().st_size
            print(f"gibson-sim wheels: {wheel} {size / 1e6:.1f} MB", flush=True)
            if size > MOST_BYTES:
                raise SetupError(f"{wheel.name} has {size / 1e6:.0f} MB, and PyPI takes at most {MOST_BYTES / 1e6:.0f} MB")
    except SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
