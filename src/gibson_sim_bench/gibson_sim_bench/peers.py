"""Third-party renderers in the renderer benchmark: ``python -m gibson_sim_bench.peers``, in any Python that has them.

Each renders the same triangles with the same unlit texture, without shadows and background, from the same camera. The module imports only
``workers`` of this package, and each third-party renderer when it is opened.
"""

from __future__ import annotations

import ctypes
import importlib.util
import math
import os
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from gibson_sim_bench.workers import Matrix, serve

NEAR, FAR = 0.05, 100.0
_GL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenGL's camera frame (y up, looking along -z) to the optical frame."""


def _triangles(folder: str) -> dict[str, Any]:
    """Returns vertices (V, 3), normals (V, 3), uvs (V, 2) with v = 0 at the top of the texture, triangles (F, 3)."""
    with np.load(os.path.join(folder, "mesh.npz")) as arrays:
        return dict(arrays)


def _camera(pose: Matrix) -> Any:
    """Returns T_world_camera, (4, 4), in OpenGL's camera frame."""
    return np.array(pose, dtype=np.float64).reshape(4, 4) @ _GL_FROM_OPTICAL


def _rgb(image: Any) -> tuple[bytes, int, int]:
    pixels = np.ascontiguousarray(image[:, :, :3], dtype=np.uint8)
    return pixels.tobytes(), pixels.shape[0], pixels.shape[1]


class _Peer:
    """Common part of the third-party renderers."""

    info: dict[str, str]

    def rgb_image(self, rendered: Any) -> tuple[bytes, int, int]:
        """Returns RGB bytes, height and width, pixels."""
        return _rgb(rendered[0])

    def triangles(self) -> int:
        """Returns 0: these renderers do not report it."""
        return 0


class MuJoCo(_Peer):
    """``mujoco.Renderer``: RGB; depth is a second render.

    Args:
        folder: written by ``scenes.bench_scenes.export_for_peers``.
        sizes: (width, height) of all images, pixels.
    """

    def __init__(self, folder: str, sizes: Sequence[tuple[int, int]]) -> None:
        os.environ.setdefault("MUJOCO_GL", "egl")
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
        from OpenGL import EGL

        if not hasattr(EGL, "EGLDeviceEXT"):
            # pyrender pins a PyOpenGL that is older than MuJoCo expects; the missing type is a pointer.
            EGL.EGLDeviceEXT = ctypes.c_void_p
        import mujoco

        self._mujoco = mujoco
        self._model = self._compiled(folder, sizes)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._renderers: dict[tuple[int, int], Any] = {}
        self._renderer: Any = None
        self._depth = False
        self.info = {"version": mujoco.__version__}

    def _compiled(self, folder: str, sizes: Sequence[tuple[int, int]]) -> Any:
        mujoco, arrays = self._mujoco, _triangles(folder)
        spec = mujoco.MjSpec()
        texture = spec.add_texture(name="atlas", type=mujoco.mjtTexture.mjTEXTURE_2D, file=os.path.join(folder, "atlas.png"))
        # Emission only, so that the texture is rendered unlit.
        material = spec.add_material(name="atlas", emission=1.0, specular=0.0, shininess=0.0, reflectance=0.0)
        names = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
        names[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = texture.name
        material.textures = names
        mesh = spec.add_mesh(name="mesh", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        mesh.uservert = arrays["vertices"].ravel()
        mesh.usernormal = arrays["normals"].ravel()
        mesh.usertexcoord = arrays["uvs"].ravel()
        faces = arrays["triangles"].ravel()
        mesh.userface = faces
        mesh.userfacenormal = faces
        mesh.userfacetexcoord = faces
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh", material="atlas", contype=0, conaffinity=0)
        self._fov_at = spec.worldbody.add_camera(name="eye").name
        spec.stat.extent = 1.0
        spec.visual.map.znear, spec.visual.map.zfar = NEAR, FAR
        # One sample per pixel, as Gibson Sim.
        spec.visual.quality.offsamples = 0
        spec.visual.quality.shadowsize = 0
        spec.visual.headlight.active = 0
        spec.visual.global_.offwidth = max(width for width, _ in sizes)
        spec.visual.global_.offheight = max(height for _, height in sizes)
        return spec.compile()

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians, with these outputs."""
        if (width, height) not in self._renderers:
            renderer = self._mujoco.Renderer(self._model, height, width)
            for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
                renderer.scene.flags[getattr(self._mujoco.mjtRndFlag, f"mjRND_{flag}")] = False
            self._renderers[width, height] = renderer
        self._renderer = self._renderers[width, height]
        self._model.cam_fovy[0] = math.degrees(fov_y)
        self._depth = "depth" in outputs

    def render(self, pose: Matrix) -> tuple[Any, ...]:
        """Renders colour, and depth if it is one of the outputs."""
        T = _camera(pose)
        self._data.cam_xpos[0] = T[:3, 3]
        self._data.cam_xmat[0] = T[:3, :3].ravel()
        renderer = self._renderer
        renderer.update_scene(self._data, camera=0)
        rgb = renderer.render()
        if not self._depth:
            return (rgb,)
        renderer.enable_depth_rendering()
        depth = renderer.render()
        renderer.disable_depth_rendering()
        return rgb, depth


class Pyrender(_Peer):
    """``pyrender.OffscreenRenderer``, FLAT: RGB and depth in one call. Arguments as ``MuJoCo``."""

    def __init__(self, folder: str, sizes: Sequence[tuple[int, int]]) -> None:
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
        # pyrender is older than NumPy 2.
        for name, value in (("infty", np.inf), ("float_", np.float64)):
            if not hasattr(np, name):
                setattr(np, name, value)
        import pyrender
        from PIL import Image

        Image.MAX_IMAGE_PIXELS = None
        arrays = _triangles(folder)
        texture = pyrender.Texture(source=Image.open(os.path.join(folder, "atlas.png")).convert("RGB"), source_channels="RGB")
        material = pyrender.MetallicRoughnessMaterial(baseColorTexture=texture, doubleSided=True)
        uvs = np.stack([arrays["uvs"][:, 0], 1.0 - arrays["uvs"][:, 1]], axis=1)
        part = pyrender.Primitive(
            positions=arrays["vertices"],
            normals=arrays["normals"],
            texcoord_0=uvs,
            indices=arrays["triangles"],
            material=material,
        )
        self._scene = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0))
        self._scene.add(pyrender.Mesh([part]))
        self._camera = pyrender.PerspectiveCamera(yfov=1.0, aspectRatio=1.0, znear=NEAR, zfar=FAR)
        self._eye = self._scene.add(self._camera)
        self._flags = pyrender.RenderFlags.FLAT
        self._renderer = pyrender.OffscreenRenderer(*sizes[0])
        self.info = {"version": version("pyrender")}

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians."""
        self._renderer.viewport_width, self._renderer.viewport_height = width, height
        self._camera.yfov, self._camera.aspectRatio = fov_y, width / height

    def render(self, pose: Matrix) -> tuple[Any, ...]:
        """Renders colour and depth."""
        self._scene.set_pose(self._eye, _camera(pose))
        rendered: tuple[Any, ...] = self._renderer.render(self._scene, flags=self._flags)
        return rendered


class PyBullet(_Peer):
    """``getCameraImage``: RGB, depth and segmentation in one call. Arguments as ``MuJoCo``; ``egl``: with its EGL plugin."""

    def __init__(self, folder: str, sizes: Sequence[tuple[int, int]], egl: bool = False) -> None:
        import pybullet

        self._bullet = bullet = pybullet
        bullet.connect(bullet.DIRECT)
        if egl:
            found = importlib.util.find_spec("eglRenderer")
            name = (found.origin, "_eglRendererPlugin") if found is not None and found.origin else ("eglRendererPlugin", "")
            if bullet.loadPlugin(*name) < 0:
                raise RuntimeError("its EGL plugin cannot be loaded")
        self._kind = bullet.ER_BULLET_HARDWARE_OPENGL if egl else bullet.ER_TINY_RENDERER
        shape = bullet.createVisualShape(
            bullet.GEOM_MESH, fileName=os.path.join(folder, "mesh.obj"), rgbaColor=(1, 1, 1, 1), specularColor=(0, 0, 0)
        )
        bullet.createMultiBody(0, -1, shape)
        self._size = (0, 0)
        self._projection: Any = ()
        self.info = {"version": version("pybullet")}

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians."""
        self._size = (width, height)
        self._projection = self._bullet.computeProjectionMatrixFOV(math.degrees(fov_y), width / height, NEAR, FAR)

    def render(self, pose: Matrix) -> tuple[Any, ...]:
        """Renders colour, depth and segmentation."""
        view = np.linalg.inv(_camera(pose)).T.ravel().tolist()
        _, _, rgb, depth, labels = self._bullet.getCameraImage(
            *self._size,
            viewMatrix=view,
            projectionMatrix=self._projection,
            renderer=self._kind,
            shadow=0,
            lightAmbientCoeff=1.0,
            lightDiffuseCoeff=0.0,
            lightSpecularCoeff=0.0,
        )
        return rgb, depth, labels


_IGIBSON_MODES = {"rgb": "rgb", "depth": "3d", "normal": "normal"}


class IGibson(_Peer):
    """iGibson 2's ``MeshRenderer`` without its data sets: RGB, normals, and positions, which include depth.

    Args:
        folder: as for ``MuJoCo``.
        sizes: as for ``MuJoCo``; one renderer at a time, since each assumes that the most recent OpenGL context is its own.
    """

    def __init__(self, folder: str, sizes: Sequence[tuple[int, int]]) -> None:
        from igibson.render.mesh_renderer.mesh_renderer_cpu import MeshRenderer
        from igibson.render.mesh_renderer.mesh_renderer_settings import MeshRendererSettings

        # Shaders for OpenGL 4.5, since software renderers have no 4.6; its lighting needs data that the package does not contain.
        settings = MeshRendererSettings(enable_pbr=False, enable_shadow=False, msaa=False, glsl_version_override=450)
        self._make = partial(MeshRenderer, rendering_settings=settings)
        self._mesh = os.path.join(folder, "mesh.obj")
        self._size = (0, 0)
        self._renderer: Any = None
        self._modes: tuple[str, ...] = ("rgb",)
        self.info = {"version": version("igibson")}

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians, with these outputs."""
        if self._size != (width, height):
            if self._renderer is not None:
                self._renderer.release()
            self._renderer, self._size = self._make(width=width, height=height), (width, height)
            self._renderer.load_object(self._mesh)
            self._renderer.add_instance_group([0])
            self._renderer.set_z_near_z_far(NEAR, FAR)
        self._renderer.set_fov(math.degrees(fov_y))
        self._modes = tuple(_IGIBSON_MODES[name] for name in outputs)

    def render(self, pose: Matrix) -> tuple[Any, ...]:
        """Renders the outputs; each is returned as four floats per pixel."""
        T = np.array(pose, dtype=np.float64).reshape(4, 4)
        self._renderer.set_camera(T[:3, 3], T[:3, 3] + T[:3, 2], -T[:3, 1])
        return tuple(self._renderer.render(modes=self._modes))

    def rgb_image(self, rendered: Any) -> tuple[bytes, int, int]:
        """Returns RGB bytes, height and width, pixels."""
        return _rgb(np.clip(rendered[0] * 255.0, 0.0, 255.0))


def _bullet_with_egl(folder: str, sizes: Sequence[tuple[int, int]]) -> PyBullet:
    return PyBullet(folder, sizes, egl=True)


if __name__ == "__main__":
    serve(
        {
            "MuJoCo": MuJoCo,
            "pyrender": Pyrender,
            "PyBullet TinyRenderer": PyBullet,
            "PyBullet EGL": _bullet_with_egl,
            "iGibson": IGibson,
        }
    )
