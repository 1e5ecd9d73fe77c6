"""What is fuzzed, by name: each target writes a mutant to a folder, and tries one that lies in a folder."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz import archives, bodies, flips, meshes, recordings, scans, scenes
from fuzz.grammar import SECRET, Mutator
from fuzz.trial import Trial

_PIPE = "pipe"
FILES = "files"
"""Folder of a mutant in its folder; what lies beside it may not be read."""


@dataclass(frozen=True, slots=True)
class Target:
    """One kind of input."""

    make: Callable[[Mutator, Path], None]
    """Writes a mutant into an empty folder."""
    run: Callable[[Path, Trial], None]
    """Tries the mutant in a folder."""


TARGETS: dict[str, Target] = {
    "mesh": Target(meshes.make, meshes.run),
    "body": Target(bodies.make, bodies.run),
    "robot": Target(bodies.make_robot, bodies.run_robot),
    "scene": Target(scenes.make, scenes.run),
    "world": Target(scenes.make_world, scenes.run),
    "archive": Target(archives.make, archives.run),
    "bag": Target(recordings.make, recordings.run),
    "flip": Target(flips.make, flips.run),
    "scan": Target(scans.make, scans.run),
}


def write_mutant(target: Target, mutator: Mutator, folder: Path) -> None:
    """Writes a mutant with what surrounds it: a file that it may not read, a pipe, a folder, a link that leads out."""
    files = folder / FILES
    files.mkdir(parents=True)
    for name in (f"{SECRET}.txt", f"{SECRET}.obj"):
        (folder / name).write_text(f"{SECRET} outside\n")
    (files / "folder").mkdir()
    _make_pipe(files)
    (files / "link.txt").symlink_to(folder / f"{SECRET}.txt")
    target.make(mutator, files)


def copy_mutant(source: Path, folder: Path, *, pipe: bool = True) -> None:
    """Copies a mutant in place of what is there; ``pipe`` = with the pipe, which hangs whoever reads it."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder, symlinks=True, ignore=lambda _, names: [name for name in names if name == _PIPE])
    if pipe and (folder / FILES).is_dir():
        _make_pipe(folder / FILES)


def _make_pipe(files: Path) -> None:
    with contextlib.suppress(OSError):
        os.mkfifo(files / _PIPE)
