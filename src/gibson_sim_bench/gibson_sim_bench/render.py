"""Images per second along a fixed camera path through scenes: Gibson Sim, and third-party renderers on the same mesh.

Every renderer (``contestant`` in the JSON report) has its own process. The measurements are interleaved in rounds, so that any other load on the
machine affects all renderers alike. An image is complete when all its outputs are in host memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.config import DETAIL_PX
from gibson_sim.errors import GibsonSimError, RenderError
from gibson_sim.picture_files import write_picture
from gibson_sim.types import Output
from gibson_sim_bench import timing
from gibson_sim_bench.scenes.bench_scenes import BenchScene, bench_scene, camera_path, export_for_peers, one_line
from gibson_sim_bench.timing import FIVE, rates_of
from gibson_sim_bench.workers import Worker, WorkerError

SCENES = ("rooms:100k", "rooms:500k", "rooms:1m")
SIZES = ((256, 256), (640, 480), (1024, 1024))
OUTPUT_SETS: tuple[tuple[Output, ...], ...] = (("rgb",), ("rgb", "depth"), FIVE)
FOV_Y = math.radians(60.0)
"""Vertical field of view of every camera, radians."""
ROUNDS = 6
"""Rounds of the interleaved measurement, after one of warm-up."""
GIBSON_SIM = "Gibson Sim"


@dataclass(frozen=True, slots=True)
class Peer:
    """A third-party renderer, and the sets of outputs that it renders."""

    name: str
    outputs: tuple[tuple[str, ...], ...]
    how: str
    """How it renders them, for the report."""


PEERS = (
    Peer("MuJoCo", (("rgb",), ("rgb", "depth")), "RGB + depth are two renders"),
    Peer("pyrender", (("rgb", "depth"),), "FLAT; 4 samples per pixel, which cannot be turned off"),
    Peer("PyBullet TinyRenderer", (("rgb", "depth", "semantic"),), "RGB, depth and segmentation in one call"),
    Peer(
        "PyBullet EGL", (("rgb", "depth", "semantic"),), "RGB, depth and segmentation in one call; its light cannot be turned off"
    ),
    Peer(
        "iGibson",
        (("rgb",), ("rgb", "depth")),
        "all outputs in one pass, each read back as four floats per pixel; default lighting, without its data sets",
    ),
)
ABSENT = (
    (
        "Habitat-sim",
        "no package on PyPI; 753 and 688 frames/s in the two scenes of the paper, rendering only (its Table 1, GTX 1080 Ti)",
    ),
    ("Isaac Sim", "needs an RTX GPU"),
    ("Gazebo", "its cameras work only in a running simulation, not as a library; docs/comparison.md"),
)
"""Renderers that cannot be measured here, and why."""


@dataclass(frozen=True, slots=True)
class RenderPlan:
    """What to measure."""

    scenes: tuple[str, ...] = SCENES
    sizes: tuple[tuple[int, int], ...] = SIZES
    """(width, height), pixels."""
    outputs: tuple[tuple[Output, ...], ...] = OUTPUT_SETS
    frames: int = 60
    """Images of each case; a sixth of them as warm-up, and one at the start of each block, are additional and do not count."""
    detail_px: tuple[float, ...] = (DETAIL_PX,)
    """Tolerances of the level-of-detail selection, pixels; each value is a contestant of its own."""
    device: int | str | None = None
    peers: bool = False
    """Whether third-party renderers are measured too."""
    peer_pythons: tuple[str, ...] = ("",)
    """Interpreters that may have third-party renderers installed, tried in this order; empty = this one."""
    images: Path | None = None
    """Folder for the first image of every renderer; None = not written."""


@dataclass(frozen=True, slots=True)
class RenderRow:
    """One row of the report: one renderer in one case."""

    scene: str
    triangles: int
    """Triangles of the scene."""
    width: int
    height: int
    outputs: tuple[str, ...]
    contestant: str
    fps: float
    """Images per second: 1 / median time of an image."""
    p5: float
    p95: float
    drawn: int
    """Triangles drawn for an image, median; 0 = unknown."""

    @property
    def size(self) -> str:
        """Width and height."""
        return f"{self.width}x{self.height}"


@dataclass(frozen=True, slots=True)
class RenderReport:
    """The measurements, with machine and date."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    """Load average over the last minute before the measurement."""
    contestants: dict[str, dict[str, str]]
    """Library, version and device, by contestant."""
    fov_y_deg: float
    frames: int
    rows: tuple[RenderRow, ...]
    left_out: tuple[str, ...] = field(default=())
    """What could not be measured, and why."""

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types, with the ratios."""
        figures = [
            {
                "name": f"{r.contestant}: {'+'.join(r.outputs)}, {r.scene}, {r.size}",
                "value": r.fps,
                "unit": "frames/s",
                "better": "more",
            }
            for r in self.rows
            if r.contestant.startswith(GIBSON_SIM)
        ]
        against = [asdict(ratio) for ratio in peer_ratios(self.rows)]
        return {"kind": "render", **asdict(self), "against_peers": against, "figures": figures}


@dataclass(frozen=True, slots=True)
class PeerRatio:
    """Speed of Gibson Sim with five outputs relative to the fastest peer with RGB and depth."""

    scene: str
    width: int
    height: int
    contestant: str
    peer: str
    ratio: float


@dataclass(frozen=True, slots=True)
class RenderCase:
    """One renderer with one set of outputs."""

    contestant: str
    worker: Worker
    outputs: tuple[str, ...]


def measure(plan: RenderPlan, progress: Callable[[str], None] = lambda line: None) -> RenderReport:
    """Returns the measurements.

    Args:
        plan: what to measure.
        progress: called with one line of progress.

    Raises:
        GibsonSimError: a scene cannot be loaded, or Gibson Sim cannot render it. A peer that fails is left out.
    """
    date, version, load = timing.now(), timing.version(), timing.load()
    rows: list[RenderRow] = []
    infos: dict[str, dict[str, str]] = {}
    left_out: list[str] = []
    for scene in [bench_scene(name) for name in plan.scenes]:
        with ExitStack() as stack:
            progress(f"{scene.name}: loading")
            renderers, lines = _open_renderers(scene, plan, stack, infos)
            left_out += [line for line in lines if line not in left_out]
            triangles = int(renderers[0][1]["triangles"])
            poses = [pose.ravel().tolist() for pose in camera_path(scene, plan.frames)]
            for width, height in plan.sizes:
                cases = [RenderCase(name, worker, outputs) for name, _, worker, sets in renderers for outputs in sets]
                _write_images(plan, scene, width, height, renderers, poses[0])
                measured, lines = _measured(cases, width, height, poses)
                left_out += [line for line in lines if line not in left_out]
                for case, seconds, drawn in measured:
                    rates = rates_of(seconds)
                    fps, p5, p95 = (round(rate, 2) for rate in (rates.median, rates.p5, rates.p95))
                    typical = int(np.median(drawn))
                    rows.append(
                        RenderRow(scene.name, triangles, width, height, case.outputs, case.contestant, fps, p5, p95, typical)
                    )
                    progress(f"{scene.name} {width}x{height} {case.contestant} {'+'.join(case.outputs)}: {fps:.1f} fps")
    return RenderReport(
        date=date,
        version=version,
        machine=timing.machine(),
        cores=timing.cores(),
        load=load,
        contestants=infos,
        fov_y_deg=round(math.degrees(FOV_Y), 3),
        frames=plan.frames,
        rows=tuple(rows),
        left_out=tuple(left_out),
    )


_OpenRenderer = tuple[str, dict[str, str], Worker, tuple[tuple[str, ...], ...]]


def _open_renderers(
    scene: BenchScene, plan: RenderPlan, stack: ExitStack, infos: dict[str, dict[str, str]]
) -> tuple[list[_OpenRenderer], list[str]]:
    """Returns (name, info, worker, output sets) of all renderers that loaded the scene, Gibson Sim first, and the errors of all others."""
    found: list[_OpenRenderer] = []
    for detail_px in plan.detail_px:
        name = GIBSON_SIM if detail_px == plan.detail_px[0] else f"{GIBSON_SIM}, detail {detail_px:g} px"
        worker = stack.enter_context(Worker("gibson_sim_bench.own_renderer"))
        try:
            info = worker.request("open", renderer=GIBSON_SIM, scene=str(scene.path), detail_px=detail_px, device=plan.device)
        except WorkerError as error:
            raise RenderError(f"{scene.name}: {name} cannot render it: {one_line(error)}") from error
        infos[name] = {key: value for key, value in info.items() if key not in ("triangles", "textures")}
        infos[name]["detail_px"] = f"{detail_px:g}"
        found.append((name, info, worker, plan.outputs))
    lines: list[str] = []
    if plan.peers:
        try:
            folder = export_for_peers(scene)
        except GibsonSimError as error:
            return found, [f"peers: {one_line(error)}"]
        for peer in PEERS:
            opened = _opened(peer, plan, str(folder), stack)
            if isinstance(opened, str):
                lines.append(f"{peer.name}: {opened}")
                continue
            worker, info = opened
            infos[peer.name] = {**info, "how": peer.how}
            found.append((peer.name, info, worker, peer.outputs))
    return found, lines


def _opened(peer: Peer, plan: RenderPlan, folder: str, stack: ExitStack) -> tuple[Worker, dict[str, str]] | str:
    """Returns the worker of a peer that loaded the scene, in the first interpreter that has it, with its info; else the error."""
    first_error = ""
    for python in plan.peer_pythons:
        with ExitStack() as attempt:
            try:
                worker = attempt.enter_context(Worker("gibson_sim_bench.peers", python))
                info = worker.request("open", renderer=peer.name, folder=folder, sizes=plan.sizes)
            except WorkerError as error:
                first_error = first_error or one_line(error)
                continue
            stack.enter_context(attempt.pop_all())
            return worker, info
    return first_error


def _measured(
    cases: Sequence[RenderCase], width: int, height: int, poses: list[list[float]]
) -> tuple[list[tuple[RenderCase, list[float], list[int]]], list[str]]:
    """Returns the seconds and drawn triangles of each image for every case that succeeded, and the errors of all others."""
    seconds: dict[int, list[float]] = {k: [] for k in range(len(cases))}
    drawn: dict[int, list[int]] = {k: [] for k in range(len(cases))}
    lines: list[str] = []
    for number, part in enumerate(rounds(poses)):
        for k, case in enumerate(cases):
            if k not in seconds:
                continue
            try:
                times, triangles = case.worker.request(
                    "frames", width=width, height=height, fov_y=FOV_Y, outputs=case.outputs, poses=part
                )
            except WorkerError as error:
                if case.contestant.startswith(GIBSON_SIM):
                    raise RenderError(f"{case.contestant} at {width}x{height}: {one_line(error)}") from error
                lines.append(f"{case.contestant} at {width}x{height}: {one_line(error)}")
                del seconds[k]
                continue
            if number > 0:
                seconds[k] += times
                drawn[k] += triangles
    return [(case, seconds[k], drawn[k]) for k, case in enumerate(cases) if k in seconds], lines


def rounds(poses: list[list[float]]) -> Iterator[list[list[float]]]:
    """Yields the poses of each round; the first is the warm-up, whose images are rendered again later."""
    parts = [list(part) for part in np.array_split(np.arange(len(poses)), min(ROUNDS, len(poses)))]
    for part in (parts[-1], *parts):
        yield [poses[k] for k in part]


def _write_images(
    plan: RenderPlan, scene: BenchScene, width: int, height: int, renderers: Sequence[_OpenRenderer], pose: list[float]
) -> None:
    """Writes the first image of each renderer."""
    if plan.images is None:
        return
    plan.images.mkdir(parents=True, exist_ok=True)
    for name, _, worker, sets in renderers:
        try:
            options = {"width": width, "height": height, "fov_y": FOV_Y, "outputs": sets[-1], "poses": [pose]}
            pixels, rows, columns = worker.request("image", **options)
        except WorkerError:
            continue  # reported when it is measured
        image = np.frombuffer(pixels, dtype=np.uint8).reshape(rows, columns, 3)
        file = f"{scene.name}_{width}x{height}_{name}.png".replace(" ", "_").replace(":", "_").replace(",", "")
        write_picture(plan.images / file, image[:, :, ::-1])


def peer_ratios(rows: Sequence[RenderRow]) -> list[PeerRatio]:
    """Returns, for each scene and size, the speed with five outputs relative to the fastest peer with RGB and depth."""
    found = []
    for own in rows:
        if own.outputs != FIVE or not own.contestant.startswith(GIBSON_SIM):
            continue
        peers = [
            row
            for row in rows
            if not row.contestant.startswith(GIBSON_SIM)
            and {"rgb", "depth"} <= set(row.outputs)
            and (row.scene, row.size) == (own.scene, own.size)
        ]
        if peers:
            best = max(peers, key=lambda row: row.fps)
            ratio = round(timing.ratio(own.fps, best.fps), 2)
            found.append(PeerRatio(own.scene, own.width, own.height, own.contestant, best.contestant, ratio))
    return found


def growth(rows: Sequence[RenderRow]) -> list[tuple[RenderRow, float]]:
    """Returns, for each case of the largest rooms, the time of an image relative to that of the smallest rooms."""
    sizes = sorted({(row.triangles, row.scene) for row in rows if row.scene.startswith("rooms:")})
    if len(sizes) < 2:
        return []
    small, large = sizes[0][1], sizes[-1][1]
    before = {(row.size, row.outputs, row.contestant): row.fps for row in rows if row.scene == small}
    return [
        (row, round(timing.ratio(before[row.size, row.outputs, row.contestant], row.fps), 2))
        for row in rows
        if row.scene == large and (row.size, row.outputs, row.contestant) in before
    ]
