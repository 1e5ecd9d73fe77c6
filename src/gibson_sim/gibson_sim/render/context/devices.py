"""Lists the EGL devices of this machine and opens one: the first GPU that works, else a software renderer."""

from __future__ import annotations

import ctypes
import json
import logging
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from gibson_sim.errors import GraphicsUnavailableError
from gibson_sim.render.context.cores import spread_threads
from gibson_sim.render.context.egl import LIBRARY, REMEDY, Egl, EglContext

if TYPE_CHECKING:
    import moderngl

_log = logging.getLogger(__name__)
_SOFTWARE_NAMES = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software rasterizer")
_PROBE = "import sys; from gibson_sim.render.context.devices import _probe; _probe(sys.argv[1], int(sys.argv[2]))"
_PROBE_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True)
class EglDevice:
    """A GPU or a software renderer."""

    index: int
    """EGL device number."""
    vendor: str = ""
    renderer: str = ""
    """Name of the GPU or software renderer; empty if the driver reports it only for an open device."""
    version: str = ""
    """OpenGL version; empty if the device was not opened."""
    drm_node: str = ""
    """Device file, e.g. ``/dev/dri/renderD128``; empty if there is none."""
    software: bool = False
    """Whether the device draws on the CPU."""
    usable: bool = False
    """Whether the device was opened and meets the requirements."""
    problem: str = ""
    """Reason why the device is not usable; empty if it is usable or was not tried."""
    uuid: str = ""
    """UUID of a GPU, the same in all drivers, e.g. ``01234567-89ab-cdef-0123-456789abcdef``; empty if the driver does not report it."""
    cuda_ordinal: int = -1
    """CUDA device ordinal; -1 = not a CUDA device, or the driver does not report it."""


class GlContext:
    """An open OpenGL context, owned by one thread."""

    def __init__(self, device: EglDevice, egl_context: EglContext) -> None:
        self.device = device
        self.egl = egl_context
        self._gl: moderngl.Context | None = None

    @property
    def gl(self) -> moderngl.Context:
        """ModernGL context."""
        if self._gl is None:
            # Imported here so that listing devices works without ModernGL.
            import moderngl

            # ModernGL accepts any object with the methods of a context, although the parameter is typed as a dictionary.
            context: Any = self.egl
            self._gl = moderngl.create_context(require=450, standalone=True, context=context)
        return self._gl

    def make_current(self) -> None:
        """Makes this the current context of the calling thread."""
        self.egl.make_current()

    def close(self) -> None:
        """Frees the context and all its objects; a second call does nothing."""
        self._gl = None
        self.egl.release()


def open_context(device: int | str | None = None, *, library: str = LIBRARY) -> GlContext:
    """Opens a device; pins each thread of a software renderer to a core.

    Args:
        device: number in ``list_devices``, UUID or prefix of a UUID, with or without ``GPU-``; None = the first GPU that works, else
            software, with a warning.
        library: name of the EGL library.

    Raises:
        GraphicsUnavailableError: the device does not exist or does not work, or no device works.
    """
    egl = Egl(library)
    handles = egl.devices()
    if not handles:
        raise GraphicsUnavailableError(f"cannot draw: EGL finds no device, neither a GPU nor a software renderer: {REMEDY}")
    if isinstance(device, str):
        device = device_number(device, _uuids(egl, handles))
    if device is not None:
        if not 0 <= device < len(handles):
            raise GraphicsUnavailableError(
                f"EGL device {device} does not exist, the devices are 0 to {len(handles) - 1}; see `gibson-sim doctor`"
            )
        try:
            context = _open(egl, handles, device)
        except GraphicsUnavailableError as e:
            raise GraphicsUnavailableError(
                f"EGL device {device} cannot draw: {e}; choose another, see `gibson-sim doctor`"
            ) from e
    else:
        context = _open_best(egl, handles)
    if context.device.software:
        spread_threads()
    return context


def device_number(device: str, uuids: Sequence[str]) -> int:
    """Returns the number of a device given by number, UUID or prefix of a UUID.

    Args:
        device: e.g. ``"1"``, ``"GPU-0123abcd-..."``, ``"0123abcd"``.
        uuids: UUID of each device; empty if unknown.

    Raises:
        GraphicsUnavailableError: no device matches, or several do.
    """
    text = device.strip().lower()
    if re.fullmatch(r"\d{1,3}", text):
        return int(text)
    text = text.removeprefix("gpu-")
    known = ", ".join(f"{i}: {uuid or 'unknown'}" for i, uuid in enumerate(uuids))
    if not re.fullmatch(r"[0-9a-f][0-9a-f-]{3,35}", text):
        raise GraphicsUnavailableError(
            f"EGL device {device!r} is neither a number nor a UUID or at least its first four digits; the devices are {known}"
        )
    matches = [i for i, uuid in enumerate(uuids) if uuid.replace("-", "").startswith(text.replace("-", ""))]
    if len(matches) != 1:
        raise GraphicsUnavailableError(
            f"EGL device {device!r} matches {'none' if not matches else 'more than one'} of the UUIDs: {known}"
        )
    return matches[0]


def _uuids(egl: Egl, handles: list[int]) -> list[str]:
    """Returns the UUID of each device; opens devices whose driver reports it only for an open device."""
    uuids = []
    for index, handle in enumerate(handles):
        uuid = egl.uuid(handle)
        if not uuid:
            try:
                context = _open(egl, handles, index)
            except GraphicsUnavailableError as e:
                _log.debug("device %d has no UUID: %s", index, e)
            else:
                uuid = context.device.uuid
                context.close()
        uuids.append(uuid)
    return uuids


def list_devices(*, library: str = LIBRARY) -> list[EglDevice]:
    """Returns every device, after opening each once to test it.

    A child process opens them, since a broken driver may crash its process.

    Raises:
        GraphicsUnavailableError: the EGL library is missing or cannot list devices.
    """
    devices: dict[int, EglDevice] = {}
    start = 0
    while True:
        try:
            lines, code = _run_probe(library, start)
        except OSError as e:
            raise GraphicsUnavailableError(f"the EGL devices cannot be tested: {sys.executable} cannot be started: {e}") from e
        for line in lines:
            if "fatal" in line:
                raise GraphicsUnavailableError(line["fatal"])
            devices[line["index"]] = EglDevice(**line)
        tried = [d.index for d in devices.values() if d.usable or d.problem]
        pending = [i for i in sorted(devices) if i not in tried]
        if not pending:
            break
        devices[pending[0]] = replace(devices[pending[0]], problem=f"the driver crashed its process ({code})")
        start = pending[0] + 1
    if not devices and code != "exit code 0":
        raise GraphicsUnavailableError(f"cannot draw: the EGL library crashed its process ({code}): {REMEDY}")
    return [devices[i] for i in sorted(devices)]


def _open(egl: Egl, handles: list[int], index: int) -> GlContext:
    """Opens one device and checks that it meets the renderer's requirements."""
    vendor, renderer, node, software = egl.describe(handles[index])
    context = EglContext(egl, handles[index])
    try:
        get_string = context.function("glGetString", ctypes.c_char_p, ctypes.c_uint)
        vendor, renderer, version = ((get_string(name) or b"").decode(errors="replace") for name in (0x1F00, 0x1F01, 0x1F02))
        software = software or any(name in renderer.lower() for name in _SOFTWARE_NAMES)
        uuid = egl.uuid(handles[index]) or context.uuid()
        cuda_ordinal = egl.cuda_ordinal(handles[index])
        device = EglDevice(index, vendor, renderer, version, node, software, usable=True, uuid=uuid, cuda_ordinal=cuda_ordinal)
        return GlContext(device, context)
    except BaseException:
        context.release()
        raise


def _open_best(egl: Egl, handles: list[int]) -> GlContext:
    """Opens the first GPU that works, else a software renderer."""
    hardware_first = sorted(range(len(handles)), key=lambda i: egl.describe(handles[i])[3])
    fallback: GlContext | None = None
    problems = []
    for index in hardware_first:
        try:
            context = _open(egl, handles, index)
        except GraphicsUnavailableError as e:
            problems.append(f"device {index}: {e}")
            continue
        if not context.device.software:
            if fallback is not None:
                fallback.close()
                context.make_current()
            return context
        if fallback is None:
            fallback = context
        else:
            context.close()
    if fallback is None:
        raise GraphicsUnavailableError(f"cannot draw: no EGL device works ({'; '.join(problems)}): {REMEDY}")
    fallback.make_current()
    software = f"drawing in software, on EGL device {fallback.device.index}, {fallback.device.renderer}"
    if problems:
        _log_once(logging.WARNING, f"no GPU can draw ({'; '.join(problems)}): {software}")
    else:
        _log_once(logging.INFO, f"no GPU here: {software}")
    return fallback


@cache
def _log_once(level: int, text: str) -> None:
    _log.log(level, "%s", text)


def _run_probe(library: str, start: int) -> tuple[list[dict[str, Any]], str]:
    """Runs ``_probe`` in a child process; returns the JSON lines that it printed and its exit status as text."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", _PROBE, library, str(start)]
    try:
        child = subprocess.run(command, env=environment, capture_output=True, timeout=_PROBE_TIMEOUT_S, check=False)
        out, code = child.stdout, f"signal {-child.returncode}" if child.returncode < 0 else f"exit code {child.returncode}"
    except subprocess.TimeoutExpired as e:
        out, code = e.stdout or b"", f"no answer in {_PROBE_TIMEOUT_S:.0f} s"
    return [json.loads(line) for line in out.splitlines() if line.startswith(b"{")], code


def _probe(library: str, start: int) -> None:
    """Prints each device from ``start`` on as a line of JSON: first all of them untested, then each again after its test."""
    out = sys.__stdout__
    assert out is not None

    def report(line: dict[str, object]) -> None:
        out.write(json.dumps(line) + "\n")
        out.flush()

    try:
        egl = Egl(library)
        handles = egl.devices()
    except GraphicsUnavailableError as e:
        return report({"fatal": str(e)})
    untested = []
    for index in range(start, len(handles)):
        vendor, renderer, node, software = egl.describe(handles[index])
        untested.append(EglDevice(index, vendor, renderer, "", node, software))
        report(asdict(untested[-1]))
    for device in untested:
        try:
            context = _open(egl, handles, device.index)
        except GraphicsUnavailableError as e:
            report(asdict(replace(device, problem=str(e))))
        else:
            report(asdict(context.device))
            context.close()
    return None
