"""Denoises pictures with Open Image Denoise, which is part of Blender."""

from __future__ import annotations

import ctypes
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
_CPU, _FLOAT3 = 1, 3
_NAMES = ("libOpenImageDenoise.so*", "libOpenImageDenoise*.dylib", "OpenImageDenoise.dll")
_NOISE_WINDOW_PX = 9
"""Edge of the window in which the noise is estimated, pixels."""
_ACCEPTED_SIGMAS = 5.0
"""Largest change by the denoiser, in standard deviations of the noise."""
_OUTLIER = 3.0
"""Distance from the median of its neighbours at which a pixel stands out, relative to that of the denoised pixel."""


def denoise(image: F32, **features: F32) -> F32:
    """Denoises an image of linear light, (H, W, 3); returns it unchanged if the library is missing or fails.

    ``features``: ``albedo`` and ``normal`` of the first surfaces, (H, W, 3), whose edges the result keeps.
    See https://www.openimagedenoise.org/documentation.html (C99 API).
    """
    library = _library()
    if library is None:
        return image
    source = np.ascontiguousarray(image, dtype=np.float32)
    result = np.empty_like(source)
    device = library.oidnNewDevice(_CPU)
    library.oidnCommitDevice(device)
    denoiser = library.oidnNewFilter(device, b"RT")
    arrays = {"color": source, "output": result} | {k: np.ascontiguousarray(v, dtype=np.float32) for k, v in features.items()}
    for name, array in arrays.items():
        height, width = array.shape[:2]
        library.oidnSetSharedFilterImage(denoiser, name.encode(), array.ctypes.data, _FLOAT3, width, height, 0, 0, 0)
    library.oidnSetFilterBool(denoiser, b"hdr", True)
    library.oidnCommitFilter(denoiser)
    library.oidnExecuteFilter(denoiser)
    has_failed = library.oidnGetDeviceError(device, None) != 0
    library.oidnReleaseFilter(denoiser)
    library.oidnReleaseDevice(device)
    return source if has_failed else result


def is_noise(mean: F32, smooth: F32, spread: F32) -> NDArray[np.bool_]:
    """Returns where the denoiser removed only noise, (H, W).

    Its change is below the local noise, or it removes a single pixel that stands out from its neighbours: paths that are far too bright can be
    in both halves.

    Args:
        mean: mean of two pictures with half of the samples each, (H, W, 3), linear.
        smooth: its denoised version.
        spread: half of the difference of the two.
    """
    own = (spread**2).mean(axis=2)
    local = np.mean(_neighbours(own, _NOISE_WINDOW_PX), axis=0)
    below = ((smooth - mean) ** 2).mean(axis=2) <= _ACCEPTED_SIGMAS**2 * np.maximum(own, local)
    gray, smooth_gray = mean.mean(axis=2), smooth.mean(axis=2)
    median = np.median(_neighbours(gray, 3), axis=0)
    single = np.abs(gray - median) > _OUTLIER * np.abs(smooth_gray - median)
    return np.asarray(below | single)


def _neighbours(values: NDArray[np.floating[Any]], window: int) -> NDArray[np.floating[Any]]:
    """Returns the values in a square window about each pixel, (window^2, H, W)."""
    padded = np.pad(values, window // 2, mode="reflect")
    height, width = values.shape
    return np.stack([padded[j : j + height, i : i + width] for j in range(window) for i in range(window)])


def _library() -> ctypes.CDLL | None:
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).parent
    files = [f for name in _NAMES for place in (folder / "lib", folder) for f in sorted(place.glob(name))]
    if not files:
        return None
    library = ctypes.CDLL(str(files[0]))
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    library.oidnNewDevice.restype = pointer
    library.oidnNewFilter.restype = pointer
    library.oidnNewFilter.argtypes = [pointer, ctypes.c_char_p]
    library.oidnSetSharedFilterImage.argtypes = [pointer, ctypes.c_char_p, pointer, ctypes.c_int, size, size, size, size, size]
    library.oidnSetFilterBool.argtypes = [pointer, ctypes.c_char_p, ctypes.c_bool]
    library.oidnGetDeviceError.argtypes = [pointer, pointer]
    for name in ("oidnCommitDevice", "oidnCommitFilter", "oidnExecuteFilter", "oidnReleaseFilter", "oidnReleaseDevice"):
        getattr(library, name).argtypes = [pointer]
    return library
