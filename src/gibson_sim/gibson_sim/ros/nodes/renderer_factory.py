"""Creates a renderer from the settings of a node."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.config import RenderConfig
from gibson_sim.render.batching.scene_geometry import Progress
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.spec import DrawnScene


def device_of(config: RenderConfig) -> int | str | None:
    """Returns the requested EGL device, by UUID or by number; None = any usable one."""
    return config.egl_uuid or (None if config.egl_device < 0 else config.egl_device)


def open_renderer(scene: DrawnScene, config: RenderConfig, progress: Progress | None = None) -> Renderer:
    """Returns a renderer with the loaded scene, which the caller closes; see ``Renderer`` for errors.

    Cameras do not share targets: an image must not depend on which other topics have subscribers.
    """
    cache = None if config.cache == "none" else Path(config.cache) if config.cache else default_folder()
    options = RenderOptions(
        device=device_of(config),
        library=config.egl_library,
        detail_px=config.detail_px,
        compress_textures=config.compress_textures,
        share_targets=False,
    )
    return Renderer(scene, MeshFiles(cache=cache), options, progress=progress)
