"""Plan of a table: cases, domains, methods, seeds. Equal plans give equal runs."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gibson_path_following.types import CameraKind
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest
from gibson_sim_learn.path_following.cases import LENGTHS, PathCase, draw_cases, path_ground
from gibson_sim_learn.path_following.domains import MEASURED, domain_of
from gibson_sim_learn.path_following.split import HELD_OUT

METHODS = {
    "oracle": "pure pursuit by the true pose and the true map",
    "learned": "the network of gibson-sim learn path-following, images alone",
    "teach_repeat": "no learning: images are compared with those of the path",
    "blind": "the recorded commands again, without looking",
    "random": "random commands for as long as the recording took",
}
"""Method name -> description."""
GOGGLES = {
    "goggles": "the network of gibson-sim learn goggles",
    "histogram": "the levels of the path's images",
    "grey_world": "grey on average, as bright as the path's images",
}
"""Name after the + of a method, as in ``learned+goggles`` -> description of the Goggles that adapt its images."""
IMAGE_METHODS = ("learned", "teach_repeat")
"""Methods that use images, which ``GOGGLES`` may adapt."""
PATHS = 10
"""Number of paths of a case, over all scenes."""


@dataclass(frozen=True, slots=True)
class Table2Plan:
    """Runs of a table.

    Raises:
        ConfigError: a value is impossible.
    """

    runs: int = 100
    """Runs of each case, domain and method."""
    lengths: tuple[float, ...] = LENGTHS
    """Lengths of the cases, metres."""
    domains: tuple[str, ...] = MEASURED
    methods: tuple[str, ...] = tuple(METHODS)
    scenes: tuple[str, ...] = HELD_OUT
    paths: int = PATHS
    """Paths of each case, spread over the scenes."""
    camera: CameraKind = "pinhole"
    seed: int = 0
    model: str = ""
    """ONNX file of ``learned``; empty = the one that is shipped."""
    goggles: str = ""
    """ONNX file of ``+goggles``; empty = the one that is shipped."""

    def __post_init__(self) -> None:
        if self.runs < 1:
            raise ConfigError(f"runs is {self.runs}, must be 1 or more")
        if not 1 <= self.paths <= 1000:
            raise ConfigError(f"paths is {self.paths}, must be 1 to 1000")
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}, must be 0 or more")
        for length in self.lengths:
            if not 1.0 <= length <= 100.0:
                raise ConfigError(
                    f"a case is {length:g} m, must be 1 to 100 m; the paper's are {', '.join(f'{x:g}' for x in LENGTHS)}"
                )
        for what, values in (
            ("cases", self.lengths),
            ("domains", self.domains),
            ("methods", self.methods),
            ("scenes", self.scenes),
        ):
            if not values:
                raise ConfigError(f"{what} is empty; name one, or leave it out")
        for name in self.domains:
            domain_of(name)
        for name in self.methods:
            method_text(name)

    def identity(self) -> dict[str, Any]:
        """Returns the settings that all runs in one folder must share, to be comparable."""
        return {"scenes": list(self.scenes), "paths": self.paths, "camera": self.camera, "seed": self.seed}

    def as_json(self) -> dict[str, Any]:
        """Returns the plan as JSON types."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def parts_of(method: str) -> tuple[str, str]:
    """Splits a method into its base method and its Goggles: ``learned+goggles`` into learned, goggles; without Goggles the second is empty."""
    base, _, goggles = method.partition("+")
    return base, goggles


def method_text(method: str) -> str:
    """Returns the description of a method.

    Raises:
        ConfigError: there is no such method.
    """
    base, goggles = parts_of(method)
    if method in METHODS:
        return METHODS[method]
    if base in IMAGE_METHODS and goggles in GOGGLES:
        return f"{base}, whose images first get the simulator's look: {GOGGLES[goggles]}"
    known = (*METHODS, *(f"{one}+{kind}" for one in IMAGE_METHODS for kind in GOGGLES))
    hint = nearest(method, known)
    raise ConfigError(f"there is no method {quoted(method)}; {f'{hint} ' if hint else ''}known: {', '.join(known)}")


@dataclass(frozen=True, slots=True)
class RunKey:
    """One run of a table."""

    scene: str
    length: float
    path: int
    """Number of the path among those of this length in the scene."""
    repeat: int
    domain: str
    method: str
    policy: str = ""
    """Digests of the networks, of ``learned`` and of the Goggles, joined by +: other weights make another method."""

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"{Path(self.scene).name}_{self.length:g}m_{self.path}_{self.domain}_{self.method}_{self.repeat}"


def seeds_of(plan_seed: int, key: RunKey) -> list[int]:
    """Returns the entropy of a run. It is independent of domain and method: runs that differ in these alone are pairs."""
    return [plan_seed, zlib.crc32(Path(key.scene).name.encode()), round(1000 * key.length), key.path, key.repeat]


def cases_of(plan: Table2Plan) -> tuple[PathCase, ...]:
    """Returns the paths of all cases, scene by scene.

    Raises:
        GibsonSimError: a scene cannot be loaded, or has no room.
    """
    found: list[PathCase] = []
    for k, scene in enumerate(plan.scenes):
        ground = path_ground(scene)
        count = plan.paths * (k + 1) // len(plan.scenes) - plan.paths * k // len(plan.scenes)
        for length in plan.lengths:
            if count:
                found += draw_cases(ground, scene, length, count, plan.seed)
    return tuple(found)


def keys_of(plan: Table2Plan, cases: Sequence[PathCase], policy: str, goggles: str = "") -> dict[PathCase, list[RunKey]]:
    """Returns the runs of each path: ``plan.runs`` of each case, spread over its paths as evenly as possible.

    Args:
        plan: the plan.
        cases: its paths.
        policy: digest of the network of ``learned``.
        goggles: digest of the network of ``+goggles``.
    """
    digests = {name: _digests(name, policy, goggles) for name in plan.methods}
    out: dict[PathCase, list[RunKey]] = {case: [] for case in cases}
    for length in plan.lengths:
        of_length = [case for case in cases if case.length == length]
        for k, case in enumerate(of_length):
            repeats = (plan.runs + len(of_length) - 1 - k) // len(of_length)
            out[case] = [
                RunKey(case.scene, length, case.number, repeat, domain, method, digests[method])
                for repeat in range(repeats)
                for domain in plan.domains
                for method in plan.methods
            ]
    return out


def _digests(method: str, policy: str, goggles: str) -> str:
    base, kind = parts_of(method)
    return "+".join(digest for digest, is_used in ((policy, base == "learned"), (goggles, kind == "goggles")) if is_used)
