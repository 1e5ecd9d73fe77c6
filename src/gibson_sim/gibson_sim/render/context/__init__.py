"""OpenGL contexts without a window: which devices there are, and opening one of them."""

from gibson_sim.render.context.devices import EglDevice, GlContext, list_devices, open_context
from gibson_sim.render.context.egl import LIBRARY

__all__ = ["LIBRARY", "EglDevice", "GlContext", "list_devices", "open_context"]
