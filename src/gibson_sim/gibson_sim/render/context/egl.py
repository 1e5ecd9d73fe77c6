"""ctypes bindings of the part of libEGL that off-screen rendering needs.

ModernGL can open such a context, but it also needs libGL, does not check whether the device has a configuration, and does not list
devices. This module needs only ``libEGL.so.1`` and reports every failure in one line.
References: EGL 1.5, EGL_EXT_device_enumeration, EGL_EXT_device_query, EGL_EXT_platform_device, EGL_KHR_surfaceless_context,
EGL_EXT_device_persistent_id, EGL_NV_device_cuda; GL_EXT_memory_object for the UUID of an open context.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from types import TracebackType
from typing import Any

from gibson_sim.errors import GraphicsUnavailableError

LIBRARY = "libEGL.so.1"
REMEDY = (
    "install libegl1 libegl-mesa0 libgl1-mesa-dri (Debian, Ubuntu); in a container with an NVIDIA GPU also enable the "
    "graphics capability (NVIDIA_DRIVER_CAPABILITIES=all)"
)

_FILTER = ("GALLIVM_PERF", "brilinear")
"""Environment variable that makes Mesa's software renderer blend two mip levels only near their transition, as GPUs do: faster, with
invisible differences. The driver reads it when it is loaded. A value set by the user, even an empty one, is kept."""

_NONE = 0x3038
_EXTENSIONS = 0x3055
_VENDOR = 0x3053
_RENDERER = 0x335F
_DRM_DEVICE_FILE = 0x3233
_DRM_RENDER_NODE_FILE = 0x3377
_PLATFORM_DEVICE = 0x313F
_OPENGL_API = 0x30A2
_DEVICE_UUID = 0x335C
_CUDA_DEVICE = 0x323A
_GL_EXTENSIONS, _GL_NUM_EXTENSIONS, _GL_DEVICE_UUID = 0x1F03, 0x821D, 0x9597
_UUID_BYTES = 16
_ERRORS = {
    0x3001: "EGL_NOT_INITIALIZED", 0x3002: "EGL_BAD_ACCESS", 0x3003: "EGL_BAD_ALLOC", 0x3004: "EGL_BAD_ATTRIBUTE",
    0x3005: "EGL_BAD_CONFIG", 0x3006: "EGL_BAD_CONTEXT", 0x3008: "EGL_BAD_DISPLAY", 0x3009: "EGL_BAD_MATCH", 0x300C: "EGL_BAD_PARAMETER",
}  # fmt: skip

_Handle = ctypes.c_void_p
_Int = ctypes.c_int
_Ints = ctypes.POINTER(ctypes.c_int)
_PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "eglGetError": (_Int,),
    "eglQueryString": (ctypes.c_char_p, _Handle, _Int),
    "eglInitialize": (ctypes.c_uint, _Handle, _Ints, _Ints),
    "eglBindAPI": (ctypes.c_uint, ctypes.c_uint),
    "eglChooseConfig": (ctypes.c_uint, _Handle, _Ints, ctypes.POINTER(_Handle), _Int, _Ints),
    "eglCreateContext": (_Handle, _Handle, _Handle, _Handle, _Ints),
    "eglDestroyContext": (ctypes.c_uint, _Handle, _Handle),
    "eglMakeCurrent": (ctypes.c_uint, _Handle, _Handle, _Handle, _Handle),
    "eglGetCurrentContext": (_Handle,),
    "eglGetProcAddress": (_Handle, ctypes.c_char_p),
}
_EXTENSION_PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "eglQueryDevicesEXT": (ctypes.c_uint, _Int, ctypes.POINTER(_Handle), _Ints),
    "eglQueryDeviceStringEXT": (ctypes.c_char_p, _Handle, _Int),
    "eglGetPlatformDisplayEXT": (_Handle, ctypes.c_uint, _Handle, _Ints),
}


class Egl:
    """The functions of an EGL library.

    Args:
        library: name or path of the library.

    Raises:
        GraphicsUnavailableError: the library is missing, or it cannot list devices.
    """

    def __init__(self, library: str = LIBRARY) -> None:
        os.environ.setdefault(*_FILTER)
        try:
            self._library = ctypes.CDLL(library)
        except OSError as e:
            raise GraphicsUnavailableError(f"cannot draw: {library} cannot be loaded ({e}): {REMEDY}") from e
        self._functions: dict[str, Callable[..., Any]] = {}
        try:
            for name, (result, *arguments) in _PROTOTYPES.items():
                self._functions[name] = ctypes.CFUNCTYPE(result, *arguments)((name, self._library))
        except AttributeError as e:
            raise GraphicsUnavailableError(f"cannot draw: {library} is not a complete EGL library ({e}): {REMEDY}") from e
        client = self._text(self.call("eglQueryString", None, _EXTENSIONS)).split()
        if "EGL_EXT_platform_device" not in client or not {"EGL_EXT_device_enumeration", "EGL_EXT_device_base"} & set(client):
            raise GraphicsUnavailableError(
                f"cannot draw: {library} has no EGL_EXT_device_enumeration and EGL_EXT_platform_device: {REMEDY}"
            )
        for name, (result, *arguments) in _EXTENSION_PROTOTYPES.items():
            self._functions[name] = ctypes.CFUNCTYPE(result, *arguments)(self.address(name))

    def call(self, name: str, *arguments: Any) -> Any:
        """Calls the EGL function ``name``."""
        return self._functions[name](*arguments)

    def address(self, name: str) -> int:
        """Returns the address of a function of an EGL extension or of OpenGL, 0 if there is none."""
        return int(self._functions["eglGetProcAddress"](name.encode()) or 0)

    def devices(self) -> list[int]:
        """Returns the handles of all devices, in the order of device numbers."""
        count = _Int(0)
        self.call("eglQueryDevicesEXT", 0, None, ctypes.byref(count))
        handles = (_Handle * max(count.value, 1))()
        self.call("eglQueryDevicesEXT", count.value, handles, ctypes.byref(count))
        return [int(handles[k] or 0) for k in range(count.value)]

    def describe(self, device: int) -> tuple[str, str, str, bool]:
        """Returns vendor, renderer, DRM node (each empty if unknown) and whether the device is a software renderer, without opening it."""
        extensions = self._device_text(device, _EXTENSIONS).split()
        vendor = renderer = node = ""
        if "EGL_EXT_device_query_name" in extensions:
            vendor, renderer = self._device_text(device, _VENDOR), self._device_text(device, _RENDERER)
        if "EGL_EXT_device_drm_render_node" in extensions:
            node = self._device_text(device, _DRM_RENDER_NODE_FILE)
        if not node and "EGL_EXT_device_drm" in extensions:
            node = self._device_text(device, _DRM_DEVICE_FILE)
        return vendor, renderer, node, "EGL_MESA_device_software" in extensions

    def uuid(self, device: int) -> str:
        """Returns the UUID of a device in the format of ``format_uuid``, without opening it; empty if the driver does not report it."""
        address = self.address("eglQueryDeviceBinaryEXT")
        if "EGL_EXT_device_persistent_id" not in self._device_text(device, _EXTENSIONS).split() or not address:
            return ""
        query = ctypes.CFUNCTYPE(ctypes.c_uint, _Handle, _Int, _Int, _Handle, _Ints)(address)
        raw, size = (ctypes.c_ubyte * _UUID_BYTES)(), _Int(0)
        good = query(device, _DEVICE_UUID, _UUID_BYTES, ctypes.cast(raw, _Handle), ctypes.byref(size))
        return format_uuid(bytes(raw)) if good and size.value == _UUID_BYTES else ""

    def cuda_ordinal(self, device: int) -> int:
        """Returns the CUDA ordinal of a device, -1 if it is not an NVIDIA GPU, without opening it."""
        address = self.address("eglQueryDeviceAttribEXT")
        if "EGL_NV_device_cuda" not in self._device_text(device, _EXTENSIONS).split() or not address:
            return -1
        value = ctypes.c_ssize_t(-1)
        query = ctypes.CFUNCTYPE(ctypes.c_uint, _Handle, _Int, _Handle)(address)
        return value.value if query(device, _CUDA_DEVICE, ctypes.addressof(value)) else -1

    def error(self) -> str:
        """Returns the name of the last error."""
        code = int(self.call("eglGetError"))
        return _ERRORS.get(code, f"error 0x{code:x}")

    def _device_text(self, device: int, name: int) -> str:
        return self._text(self.call("eglQueryDeviceStringEXT", device, name))

    @staticmethod
    def _text(value: bytes | None) -> str:
        return (value or b"").decode(errors="replace")


class EglContext:
    """A surfaceless OpenGL core context on one device, with the methods that ModernGL expects of a context.

    All contexts on the device share the display, which is never terminated: that would terminate it for all of them.

    Raises:
        GraphicsUnavailableError: the device does not support such a context.
    """

    def __init__(self, egl: Egl, device: int) -> None:
        self._egl = egl
        self._context: int | None = None
        self._display = egl.call("eglGetPlatformDisplayEXT", _PLATFORM_DEVICE, device, None)
        if not self._display or not egl.call("eglInitialize", self._display, None, None):
            raise GraphicsUnavailableError(
                f"eglInitialize failed ({egl.error()}); it has no driver, or this user may not open it"
            )
        extensions = egl._text(egl.call("eglQueryString", self._display, _EXTENSIONS)).split()
        if "EGL_KHR_surfaceless_context" not in extensions:
            raise GraphicsUnavailableError("the driver lacks EGL_KHR_surfaceless_context")
        if not egl.call("eglBindAPI", _OPENGL_API):
            raise GraphicsUnavailableError(f"the driver has no desktop OpenGL ({egl.error()})")
        # The version is requested explicitly: some drivers return the requested one, not their highest.
        config = None if "EGL_KHR_no_config_context" in extensions else self._config()
        self._context = egl.call("eglCreateContext", self._display, config, None, _ints(0x3098, 4, 0x30FB, 5, 0x30FD, 1, _NONE))
        if not self._context:
            raise GraphicsUnavailableError(f"the driver offers no OpenGL 4.5 core context ({egl.error()}); update it")
        self.make_current()

    def _config(self) -> Any:
        config, count = _Handle(), _Int(0)
        attributes = _ints(0x3033, 0x0001, 0x3040, 0x0008, _NONE)  # EGL_SURFACE_TYPE pbuffer, EGL_RENDERABLE_TYPE OpenGL
        self._egl.call("eglChooseConfig", self._display, attributes, ctypes.byref(config), 1, ctypes.byref(count))
        if not count.value:
            raise GraphicsUnavailableError("the device has no configuration for OpenGL")
        return config

    def make_current(self) -> None:
        """Makes this the current context of the calling thread."""
        if self._egl.call("eglGetCurrentContext") == self._context:
            return
        if not self._egl.call("eglMakeCurrent", self._display, None, None, self._context):
            raise GraphicsUnavailableError(
                f"the context cannot be made current ({self._egl.error()}); is it in use in another thread?"
            )

    def load_opengl_function(self, name: str) -> int:
        """Returns the address of an OpenGL function, 0 if there is none."""
        return self._egl.address(name)

    load = load_opengl_function

    def function(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        """Returns an OpenGL function with the given ctypes result and argument types."""
        address = self._egl.address(name)
        if not address:
            raise GraphicsUnavailableError(f"the driver lacks {name}; it is too old, OpenGL 4.5 is required")
        function: Callable[..., Any] = ctypes.CFUNCTYPE(result, *arguments)(address)
        return function

    def uuid(self) -> str:
        """Returns the UUID of the device of the current context; empty if the driver does not report it."""
        address = self._egl.address("glGetUnsignedBytei_vEXT")
        if "GL_EXT_memory_object" not in self._opengl_extensions() or not address:
            return ""
        raw = (ctypes.c_ubyte * _UUID_BYTES)()
        ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint, _Handle)(address)(_GL_DEVICE_UUID, 0, ctypes.cast(raw, _Handle))
        return format_uuid(bytes(raw)) if any(raw) else ""

    def _opengl_extensions(self) -> set[str]:
        count = _Int(0)
        self.function("glGetIntegerv", None, ctypes.c_uint, _Handle)(_GL_NUM_EXTENSIONS, ctypes.addressof(count))
        name = self.function("glGetStringi", ctypes.c_char_p, ctypes.c_uint, ctypes.c_uint)
        return {Egl._text(name(_GL_EXTENSIONS, i)) for i in range(count.value)}

    def release(self) -> None:
        """Destroys the context; a second call does nothing."""
        context, self._context = self._context, None
        if context:
            if self._egl.call("eglGetCurrentContext") == context:
                self._egl.call("eglMakeCurrent", self._display, None, None, None)
            self._egl.call("eglDestroyContext", self._display, context)

    def __enter__(self) -> EglContext:
        self.make_current()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        return None


def format_uuid(raw: bytes) -> str:
    """Returns 16 bytes as ``01234567-89ab-cdef-0123-456789abcdef``, the format of ``nvidia-smi -L`` after ``GPU-``."""
    text = raw.hex()
    return "-".join((text[:8], text[8:12], text[12:16], text[16:20], text[20:]))


def _ints(*values: int) -> Any:
    return (_Int * len(values))(*values)
