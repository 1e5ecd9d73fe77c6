"""Images per second as tensors: the comparison of the paper, one view with all outputs, and 64 views per call.

Without CUDA the same cases run, and the report says that the tensors are on the CPU.
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
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.frames import TargetImage
from gibson_sim.render.readback.pixel_buffers import PendingFrames
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, Output, Pose
from gibson_sim_bench import timing
from gibson_sim_bench.own_renderer import STILL
from gibson_sim_tools.generator.rooms import rooms_camera_path, rooms_mesh

RGB_DEPTH: tuple[Output, ...] = ("rgb", "depth")
PAPER_SIZES = (512, 1024)
"""Width and height of the images in the paper's comparison, pixels."""
VIEWS = 64
"""Images per call of the batched cases."""
WARM_UP = 5
"""Calls of the warm-up, which do not count."""


@dataclass(frozen=True, slots=True)
class TensorCase:
    """One row of the report."""

    name: str
    size: int
    """Width and height, pixels."""
    views: int
    """Images per call."""
    outputs: tuple[Output, ...]
    median: float
    """Images per second, median over the blocks."""
    p5: float
    p95: float


@dataclass(frozen=True, slots=True)
class TensorReport:
    """The measurements, with machine and date."""

    date: str
    machine: str
    renderer: str
    """Name of the GPU, or of the software renderer."""
    driver: str
    """Versions of OpenGL and of the driver."""
    tensors_on: str
    """``cuda:0``, or ``cpu`` where there is no CUDA."""
    torch: str
    """Version of PyTorch; empty = not installed."""
    triangles: int
    blocks: int
    calls_per_block: int
    cases: tuple[TensorCase, ...]

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types."""
        return asdict(self)


def measure(
    triangles: int = 1_000_000,
    blocks: int = 20,
    calls: int = 50,
    device: int | str | None = None,
    progress: Callable[[TensorCase], None] | None = None,
) -> TensorReport:
    """Returns the measurements on a generated floor of twelve rooms.

    Args:
        triangles: number of triangles of the scene.
        blocks: number of timed blocks of each case.
        calls: number of calls in each block, which ends when the last image is complete.
        device: EGL device; None = a GPU if there is one.
        progress: called with each case.
    """
    mesh = rooms_mesh(triangles)
    visual = VisualSpec("rooms", "", Shape("mesh", mesh="/rooms"), semantic_class="building")
    scene = DrawnScene("bench", 1, "", (), (visual,), (), LightSpec())
    cases: list[TensorCase] = []
    with Renderer(scene, meshes=_loader(mesh), options=RenderOptions(device=device)) as renderer:
        for name, size, views, outputs, call, finish in _cases(renderer):
            rates = _rates(call, finish, _cameras(size, views, outputs, blocks * calls), blocks, calls)
            found = timing.spread([rate * views for rate in rates])
            cases.append(
                TensorCase(name, size, views, outputs, *(round(rate, 1) for rate in (found.median, found.p5, found.p95)))
            )
            if progress is not None:
                progress(cases[-1])
        info = renderer.info
        tensors_on = renderer.tensors_on
    return TensorReport(
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


def table(report: TensorReport) -> str:
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
    """Returns, for each case, name, size, views, outputs, a function that renders a list of cameras, and one that waits for its last result."""

    def nothing(_: Any) -> None:
        return None

    def tensors(cameras: list[CameraSpec]) -> Any:
        return renderer.render_tensors(STILL, cameras)

    def frames(cameras: list[CameraSpec]) -> Any:
        return renderer.render(STILL, cameras)

    cases: list[tuple[str, int, int, tuple[Output, ...], _Call, _Finish]] = []
    for size in PAPER_SIZES:
        pipelined = _Pipelined(renderer)
        cases += [
            ("(a) float RGBA, synchronous", size, 1, ("rgb",), FloatRgba(renderer), nothing),
            ("(b) 8 bit, asynchronous", size, 1, ("rgb",), pipelined, pipelined.finish),
            ("(c) tensors", size, 1, ("rgb",), tensors, synchronize),
        ]
    cases.append(("host arrays", 256, 1, OUTPUTS, frames, nothing))
    cases.append(("tensors", 256, 1, OUTPUTS, tensors, synchronize))
    for outputs in (RGB_DEPTH, OUTPUTS):
        cases.append(("host arrays", 128, VIEWS, outputs, frames, nothing))
        cases.append(("tensors", 128, VIEWS, outputs, tensors, synchronize))
    return cases


class _Pipelined:
    """Renders image k + 1 while image k is read back."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._pending: PendingFrames | None = None

    def __call__(self, cameras: list[CameraSpec]) -> list[Frame]:
        """Returns the frames of the previous call."""
        previous, self._pending = self._pending, self._renderer.start(STILL, cameras)
        return [] if previous is None else previous.result()

    def finish(self, _: Any) -> None:
        """Waits for the last frames."""
        if self._pending is not None:
            self._pending.result()
            self._pending = None


class FloatRgba:
    """Reads RGBA back synchronously as four floats per pixel, as the original simulator did."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def __call__(self, cameras: list[CameraSpec]) -> list[NDArray[np.float32]]:
        """Returns the image of each camera, (H, W, 4) float32."""
        images: list[NDArray[np.float32]] = []
        self._renderer.draw(STILL, cameras, None, lambda target, shots, _: images.extend(self.read(target, shots)))
        return images

    def read(self, target: RenderTarget, shots: Sequence[TargetImage]) -> list[NDArray[np.float32]]:
        """Returns each image, (H, W, 4) float32."""
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
    """Returns calls per second in each block."""
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
    """Waits until the tensors on a GPU hold their values."""
    tensor = frames[0].rgb
    if getattr(tensor, "is_cuda", False):
        # Copying one element to the host waits for all earlier work, without importing PyTorch here.
        tensor[0, 0, 0].item()


def _cameras(size: int, views: int, outputs: tuple[Output, ...], calls: int) -> list[list[CameraSpec]]:
    """Returns the cameras of each call: all move along one path, evenly spaced."""
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
