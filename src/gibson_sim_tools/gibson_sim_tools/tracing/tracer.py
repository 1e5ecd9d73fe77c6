"""Runs Blender in a separate process on an exported scene, and caches its pictures by digest.

A picture depends on the scene, the poses of its links, the camera and the samples, but not on our renderer.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import matrices_from_poses
from gibson_sim.quoting import quoted
from gibson_sim.resources import cache_folder
from gibson_sim.types import CameraSpec, SceneState
from gibson_sim_tools import package_path
from gibson_sim_tools.making.baking import check_blender
from gibson_sim_tools.tracing.export import TracedScene, write_traced_scene

_MAX_LOG_LINES = 12
"""Number of last lines of Blender's log in an error message."""
_POSE_DIGITS = 9
"""Decimals of the poses in the key of a picture."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedPicture:
    """A traced picture, linear light. Row 0 is the top."""

    rgb: NDArray[np.float32]
    """Radiance, (H, W, 3); what is outside the scene is black."""
    spread: NDArray[np.float32]
    """Half the difference of two pictures with half of the samples each, (H, W, 3): the noise of ``rgb`` before denoising."""
    alpha: NDArray[np.float32]
    """Share of each pixel that the scene covers, (H, W)."""
    depth: NDArray[np.float32]
    """Depth of the first surface, glass included, (H, W), metres along the axis; +inf = nothing."""
    moving: NDArray[np.bool_]
    """Whether the surface belongs to a moving link, (H, W)."""
    material: NDArray[np.uint8]
    """Kind of the material, (H, W): 0 = matte, 1 = mirror, 2 = glass, 3 = metal or glossy."""


class CyclesTracer:
    """Traces pictures of one scene. Blender starts with the first picture that is not cached.

    Args:
        scene: the scene.
        python: Python interpreter with Blender.
        samples: paths per pixel, at least 2.
        cache: folder of the pictures; None = the user's cache folder.
        repeat: trace pictures again that are cached.
    """

    def __init__(self, scene: TracedScene, python: str, samples: int, *, cache: Path | None = None, repeat: bool = False) -> None:
        if samples < 2:
            raise ConfigError(f"samples is {samples}, must be 2 or more: the noise is measured between two halves")
        self._scene, self._python, self._samples, self._repeat = scene, python, samples, repeat
        self._cache = cache_folder("tracing") if cache is None else cache
        self._blender: _Blender | None = None

    def is_cached(self, camera: CameraSpec, T_world_camera: NDArray[np.float64], state: SceneState, seed: int = 0) -> bool:
        """Returns whether a picture is cached; the arguments are those of ``picture``."""
        return not self._repeat and self._path(self.request(camera, T_world_camera, state, seed)).is_file()

    def picture(self, camera: CameraSpec, T_world_camera: NDArray[np.float64], state: SceneState, seed: int = 0) -> TracedPicture:
        """Returns the picture of a camera, from the cache if it is there.

        Args:
            camera: a pinhole camera without distortion; its effects are not applied.
            T_world_camera: (4, 4), pose of its optical frame.
            state: poses of the links of the scene.
            seed: seed of the paths.

        Raises:
            ConfigError: the camera is no pinhole camera, or has distortion or skew.
            SceneError: Blender is missing or failed.
        """
        request = self.request(camera, T_world_camera, state, seed)
        path = self._path(request)
        if self._repeat or not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            if self._blender is None:
                check_blender(self._python)
                self._blender = _Blender(self._scene, self._python)
            self._blender.trace({**request, "output": str(path)})
        return _read(path)

    def request(self, camera: CameraSpec, T_world_camera: NDArray[np.float64], state: SceneState, seed: int) -> dict[str, Any]:
        """Returns what Blender needs to know of a picture; the arguments are those of ``picture``."""
        check_camera(camera)
        if state.links != self._scene.links:
            raise ConfigError(f"the state has other links than scene {quoted(self._scene.name)}; export the scene again")
        T = matrices_from_poses(state.positions, state.quats_xyzw)
        return {
            "matrix": np.round(T_world_camera, _POSE_DIGITS).ravel().tolist(),
            "k": camera.intrinsics().ravel().tolist(),
            "width": camera.width, "height": camera.height, "near": camera.near, "far": camera.far,
            "samples": self._samples, "seed": seed,
            "links": np.round(T, _POSE_DIGITS).reshape(-1, 16).tolist(),
        }  # fmt: skip

    def _path(self, request: dict[str, Any]) -> Path:
        return self._cache / picture_key(self._scene.digest, request)

    def close(self) -> None:
        """Ends Blender; a second call does nothing."""
        blender, self._blender = self._blender, None
        if blender is not None:
            blender.close()

    def __enter__(self) -> CyclesTracer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def check_camera(camera: CameraSpec) -> None:
    """Checks that Cycles can draw a camera.

    Raises:
        ConfigError: it is no pinhole camera, or has distortion or skew.
    """
    if camera.projection != "pinhole" or camera.distortion or camera.intrinsics()[0, 1]:
        raise ConfigError(
            f"camera {quoted(camera.name)}: Cycles draws pinhole cameras without distortion and skew, its projection is {camera.projection}"
            f"{' with distortion' if camera.distortion else ''}; choose another camera"
        )


def picture_key(scene_digest: str, request: dict[str, Any]) -> str:
    """Returns the file name of a picture in the cache: equal scenes, poses, cameras and samples have equal names."""
    text = json.dumps(request, sort_keys=True)
    return f"{scene_digest[:12]}/{hashlib.sha256(text.encode()).hexdigest()[:24]}.npz"


def _read(path: Path) -> TracedPicture:
    try:
        with path.open("rb") as stream, np.load(stream) as file:
            arrays = {name: file[name] for name in file.files}
        rgb, spread, alpha = (arrays[name].astype(np.float32) for name in ("rgb", "spread", "alpha"))
        depth = np.where(arrays["depth"] < 1e9, arrays["depth"], np.float32(np.inf)).astype(np.float32)
        return TracedPicture(rgb, spread, alpha, depth, arrays["moving"] > 0, arrays["material"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise SceneError(f"{path}: is no traced picture: {error}; delete it, and it is traced again") from error


class _Blender:
    """A process of Blender with a scene."""

    def __init__(self, scene: TracedScene, python: str) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="gibson_sim_trace_"))
        try:
            write_traced_scene(scene, self._folder)
            self._log = self._folder / "blender.log"
            with self._log.open("w") as errors:  # draft
                self._process = subprocess.Popen(
                    [python, "-m", "gibson_sim_tools.making.blender.trace", str(self._folder)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    text=True,
                    env={**os.environ, "PYTHONPATH": package_path(), "PYTHONWARNINGS": "ignore"},
                )
            self._answer("ready")
        except BaseException:
            self.close()
            raise

    def trace(self, request: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except OSError:
            pass  # the answer says why
        self._answer("done")

    def _answer(self, name: str) -> dict[str, Any]:
        """Returns the next answer, which has a value of this name."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            try:
                found = json.loads(line)
            except ValueError:
                continue
            if isinstance(found, dict) and name in found:
                return found
        code = self._process.wait()
        last_lines = " | ".join(self._log.read_text(errors="replace").splitlines()[-_MAX_LOG_LINES:])
        raise SceneError(f"Blender ended with exit code {code}: {last_lines or 'no output'}")

    def close(self) -> None:
        process = getattr(self, "_process", None)
        if process is not None:
            process.terminate()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                try:
                    pipe.close()
                except OSError:
                    pass
        shutil.rmtree(self._folder, ignore_errors=True)
