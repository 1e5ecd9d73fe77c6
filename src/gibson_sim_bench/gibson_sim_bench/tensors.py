"""How fast images become tensors: the comparison of the paper, one view with every output, and 64 views at once.

On a machine without CUDA the same cases run, and the report says that the tensors are on the CPU.
"""

from __future__ import annotations

import ctypes
import importlib.util
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.transforms import Mat4, quat_from_matrix
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.target import Target
from gibson_sim.render.readback.frames import Shot
from gibson_sim.render.readback.pixel_buffers import Pending
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, Output, Pose
from gibson_sim_bench import timing
from gibson_sim_bench.ours import STILL
from gibson_sim_tools.generator.rooms import rooms_camera_path, rooms_mesh

RGB_DEPTH: tuple[Output, ...] = ("rgb", "depth")
PAPER_SIZES = (512, 1024)
VIEWS = 64
WARM_UP = 5


@dataclass(frozen=True, slots=True)
class Case:
    """One line of the report."""

    name: str
    size: int
    """Pixels a side."""
    views: int
    """Images a call."""
    outputs: tuple[Output, ...]
    median: float
    """Images a second; median over the blocks."""
    p5: float
    p95: float


@dataclass(frozen=True, slots=True)
class Report:
    """What was measured, where and when."""

    date: str
    machine: str
    renderer: str
    """Name of the GPU, or of the software that draws."""
    driver: str
    """OpenGL version with that of the driver."""
    tensors_on: str
    """``cuda:0``, or ``cpu`` where there is no CUDA."""
    torch: str
    """Version of PyTorch; empty = not installed."""
    triangles: int
    blocks: int
    calls_per_block: int
    cases: tuple[Case, ...]

    def as_json(self) -> dict[str, Any]:
        """Returns it as values for JSON."""
        return asdict(self)


def measure(
    triangles: int = 1_000_000,
    blocks: int = 20,
    calls: int = 50,
    device: int | str | None = None,
    progress: Callable[[Case], None] | None = None,
) -> Report:
    """Returns what was measured on a generated floor of twelve rooms.

    Args:
        triangles: of the scene.
        blocks: how often each case is timed.
        calls: calls in each block; the clock stops when the last image is there.
        device: EGL device; None = a GPU if there is one.
        progress: is told of each case.
    """
    mesh = rooms_mesh(triangles)
    visual = VisualSpec("rooms", "", Shape("mesh", mesh="/rooms"), semantic_class="building")
    scene = DrawnScene("bench", 1, "", (), (visual,), (), LightSpec())
    cases: list[Case] = []
    with Renderer(scene, device=device, loader=_loader(mesh)) as renderer:
        for name, size, views, outputs, call, finish in _cases(renderer):
            rates = _rates(call, finish, _cameras(size, views, outputs, blocks * calls), blocks, calls)
            found = timing.spread([rate * views for rate in rates])
            cases.append(Case(name, size, views, outputs, *(round(rate, 1) for rate in (found.median, found.p5, found.p95))))
            if progress is not None:
                progress(cases[-1])
        info = renderer.info
        tensors_on = renderer.tensors_on
    return Report(
        date=timing.now(),
        machine=timing.machine(),
        renderer=str(info["renderer"]),
        driver=str(info["version"]),
        tensors_on=tensors_on,
        torch=_torch_version(),
        triangles=int(info["triangles"]),
        blocks=blocks,
        calls_per_block=calls,
        cases=tuple(cases),
    )


def table(report: Report) -> str:
    """Returns the report as a Markdown table."""
    where = "on the GPU" if report.tensors_on.startswith("cuda") else "on the CPU: there is no CUDA here"
    lines = [
        f"{report.renderer}, {report.driver}; {report.machine}; {report.date[:10]}. {report.triangles:,} triangles. "
        f"Tensors {where} ({report.tensors_on}).",
        "",
        "| case | size | views | outputs | images/s | p5 | p95 |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {c.name} | {c.size} | {c.views} | {len(c.outputs)} | {c.median:,.0f} | {c.p5:,.0f} | {c.p95:,.0f} |"
        for c in report.cases
    ]
    return "\n".join(lines)


_Call = Callable[[list[CameraSpec]], Any]
_Finish = Callable[[Any], None]


def _cases(renderer: Renderer) -> list[tuple[str, int, int, tuple[Output, ...], _Call, _Finish]]:
    """Returns name, size, views, outputs, what is called for each set of cameras, and what makes its last result certain."""

    def nothing(_: Any) -> None:
        return None

    def tensors(cameras: list[CameraSpec]) -> Any:
        return renderer.render_tensors(STILL, cameras)

    def frames(cameras: list[CameraSpec]) -> Any:
        return renderer.render(STILL, cameras)

    cases: list[tuple[str, int, int, tuple[Output, ...], _Call, _Finish]] = []
    for size in PAPER_SIZES:
        ahead = _Ahead(renderer)
        cases += [
            ("(a) float RGBA, synchronous", size, 1, ("rgb",), FloatRgba(renderer), nothing),
            ("(b) 8 bit, asynchronous", size, 1, ("rgb",), ahead, ahead.finish),
            ("(c) tensors", size, 1, ("rgb",), tensors, synchronize),
        ]
    cases.append(("host arrays", 256, 1, OUTPUTS, frames, nothing))
    cases.append(("tensors", 256, 1, OUTPUTS, tensors, synchronize))
    for outputs in (RGB_DEPTH, OUTPUTS):
        cases.append(("host arrays", 128, VIEWS, outputs, frames, nothing))
        cases.append(("tensors", 128, VIEWS, outputs, tensors, synchronize))
    return cases


class _Ahead:
    """Draws image k + 1 while image k is on its way."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._pending: Pending | None = None

    def __call__(self, cameras: list[CameraSpec]) -> list[Frame]:
        """Returns the frames of the call before."""
        before, self._pending = self._pending, self._renderer.start(STILL, cameras)
        return [] if before is None else before.result()

    def finish(self, _: Any) -> None:
        """Takes the last one."""
        if self._pending is not None:
            self._pending.result()
            self._pending = None


class FloatRgba:
    """Reads colours as four floats each and waits for them, as the original simulator did."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def __call__(self, cameras: list[CameraSpec]) -> list[NDArray[np.float32]]:
        """Returns (H, W, 4) float32 of each camera."""
        return [image for target, shots, _ in self._renderer.drawn(STILL, cameras) for image in self.read(target, shots)]

    def read(self, target: Target, shots: Sequence[Shot]) -> list[NDArray[np.float32]]:
        """Returns (H, W, 4) float32 of each image."""
        gl = GL.Gl(self._context)
        gl.glBindFramebuffer(GL.FRAMEBUFFER, target.framebuffer)
        gl.glReadBuffer(GL.COLOR_ATTACHMENT0)
        gl.glPixelStorei(GL.PACK_ALIGNMENT, 1)
        images = []
        for shot in shots:
            image = np.empty((shot.camera.height, shot.camera.width, 4), dtype=np.float32)
            size = (shot.camera.width, shot.camera.height)
            gl.glReadPixels(shot.x, shot.y, *size, GL.RGBA, GL.FLOAT, image.ctypes.data_as(ctypes.c_void_p))
            images.append(image)
        return images

    @property
    def _context(self) -> GlContext:
        return self._renderer.context


def _rates(call: _Call, finish: _Finish, cameras: list[list[CameraSpec]], blocks: int, calls: int) -> list[float]:
    """Returns calls a second in each block."""
    for k in range(WARM_UP):
        last = call(cameras[k % len(cameras)])
    finish(last)
    rates = []
    for block in range(blocks):
        started = time.perf_counter()
        for k in range(calls):
            last = call(cameras[block * calls + k])
        finish(last)
        rates.append(calls / (time.perf_counter() - started))
    return rates


def synchronize(frames: Any) -> None:
    """Waits until the tensors hold their values; those that are not PyTorch's do so from the start."""
    tensor = frames[0].rgb
    if getattr(tensor, "is_cuda", False):
        # Bringing one number to the host waits for all that was asked before, and needs nothing of PyTorch here.
        tensor[0, 0, 0].item()


def _cameras(size: int, views: int, outputs: tuple[Output, ...], calls: int) -> list[list[CameraSpec]]:
    """Returns the cameras of each call: they go along one path, all views evenly apart."""
    steps = max(calls, views)
    path = [_pose(T) for T in rooms_camera_path(steps)]
    base = CameraSpec("eye", "", Pose(), size, size, math.radians(90.0), outputs=outputs)
    return [[replace(base, pose=path[(k + v * steps // views) % steps]) for v in range(views)] for k in range(calls)]


def _pose(T_world_camera: Mat4) -> Pose:
    x, y, z = (float(c) for c in T_world_camera[:3, 3])
    return Pose((x, y, z), quat_from_matrix(T_world_camera[:3, :3]))


def _loader(mesh: Mesh) -> Callable[[Shape], Mesh]:
    return lambda shape: mesh


def _torch_version() -> str:
    if importlib.util.find_spec("torch") is None:
        return ""
    from importlib.metadata import version

    return version("torch")
