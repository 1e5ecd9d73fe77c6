"""Off-screen OpenGL contexts: lists EGL devices and opens one."""

from gibson_sim.render.context.devices import EglDevice, GlContext, device_number, list_devices, open_context
from gibson_sim.render.context.egl import LIBRARY, format_uuid

__all__ = ["LIBRARY", "EglDevice", "GlContext", "device_number", "format_uuid", "list_devices", "open_context"]
