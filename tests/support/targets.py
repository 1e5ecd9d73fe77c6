"""Targets that hold known numbers, so that what comes back can be compared with what was put in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.frames import RAW_FORMATS

Images = dict[str, NDArray[Any]]


def blank_images(width: int, height: int) -> Images:
    """Returns what a target holds where nothing was drawn."""
    return {
        name: np.zeros((height, width) if raw.channels == 1 else (height, width, raw.channels), dtype=raw.dtype)
        for name, raw in RAW_FORMATS.items()
    }


def random_images(width: int, height: int, seed: int = 0) -> Images:
    """Returns images of every value: zeros among depths, normals with and without a surface, with its back, and of the sky, one NaN of flow."""
    rng = np.random.default_rng(seed)
    images = blank_images(width, height)
    for name in ("color", "LABELS", "NORMALS"):
        images[name][...] = rng.integers(0, np.iinfo(images[name].dtype).max, images[name].shape, endpoint=True)
    images["depth"][...] = np.where(rng.random((height, width)) < 0.2, 0.0, rng.random((height, width)))
    images["NORMALS"][..., 3] = rng.choice([0, 32768, 65535], (height, width), p=[0.3, 0.2, 0.5])
    images["NORMALS"][..., 0] *= images["NORMALS"][..., 3] != 0
    images["NORMALS"][0, -1] = 65535, 65535, 65535, 0
    images["FLOW"][...] = rng.normal(size=images["FLOW"].shape)
    images["FLOW"][0, 0] = np.nan
    return images


def fill(context: GlContext, target: RenderTarget, images: Images) -> None:
    """Puts images into the textures of a target."""
    gl = GL.Gl(context)
    gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
    for name, texture in target.textures.items():
        image, raw = np.ascontiguousarray(images[name]), RAW_FORMATS[name]
        gl.glTextureSubImage2D(texture, 0, 0, 0, target.width, target.height, raw.gl_format, raw.gl_type, image.ctypes.data)
