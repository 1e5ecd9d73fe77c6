"""Finds and decodes the images that meshes reference, each once, and only in allowed folders."""

from __future__ import annotations

import copy
import io
import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar
from urllib.parse import unquote

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import Omission, OmissionKind
from gibson_sim.errors import MeshError
from gibson_sim.formats.file_roots import find_ignoring_case, is_inside
from gibson_sim.formats.image_header import MAX_IMAGE_BYTES, MAX_PIXELS, ImageHeader, image_size
from gibson_sim.formats.mesh import LightMapSource, Sampling, TextureSource
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, is_folder, read_file

_Depth = TypeVar("_Depth", np.uint8, np.uint16)
Warn = Callable[[str], None]
Decode = bool | Literal["sizes"]
"""Whether images are decoded; "sizes" = replaced by black images of the same size."""
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".webp", ".gif", ".ppm")
_LEVELS_UP = 3
"""Maximum number of folders above that of a mesh whose texture folders are searched."""


def local_path(uri: str, folder: Path) -> Path:
    r"""Returns the path of a reference in a mesh file: percent-decoded, with ``/`` for ``\``, without ``file://``."""
    text = unquote(uri.strip()).replace("\\", "/")
    if text.lower().startswith("file://"):
        text = text[7:]
    return folder / text


class TextureStore:
    """Decodes images and caches them for its lifetime.

    Args:
        roots: folders that images may lie in.
        decode: False = images are only checked for existence, for users of geometry alone; "sizes" = black images of the sizes in their
            headers, without memory for their pixels.
    """

    def __init__(self, roots: Sequence[Path], decode: Decode = True) -> None:
        self.roots = tuple(roots)
        self.decode = decode
        self._by_file: dict[Path, TextureSource | None] = {}
        self._inside: dict[tuple[Path, tuple[Path, ...]], bool] = {}
        """(Image, roots) -> whether it lies in them; cached, since many meshes reference one image."""
        self._light_maps: dict[Path, LightMapSource | None] = {}
        self._encoded: dict[int, tuple[TextureSource | LightMapSource, bytes]] = {}
        self._sampled: dict[tuple[int, Sampling], tuple[TextureSource, TextureSource]] = {}
        """(``id()`` of a texture, sampling) -> the texture, and the same image with that sampling."""

    def within(self, roots: Sequence[Path]) -> TextureStore:
        """Returns a store with other roots that shares the decoded images."""
        other = copy.copy(self)
        other.roots = tuple(roots)
        return other

    def from_uri(self, uri: str, mesh: Path, files: list[Path], warn: Warn, *, search: bool = True) -> TextureSource | None:
        """Returns the image that ``mesh`` references, or None with a warning; always None if ``decode`` is False.

        Args:
            uri: the reference, relative to the mesh.
            mesh: the mesh file.
            files: list to which the path of the image is appended.
            warn: called with one line about the image if it cannot be used.
            search: whether to search for a missing image in the usual folders near the mesh.

        Raises:
            MeshError: the image has more than ``MAX_PIXELS``.
        """
        path = self._find(uri, mesh, files, warn, search)
        if path is None or not self.decode:
            return None
        if path not in self._by_file:
            pixels = self._file_pixels(path, self._pixels)
            self._by_file[path] = None if pixels is None else TextureSource(str(path), pixels)
        if self._by_file[path] is None:
            _warn_of_file(mesh, path, "texture", warn)
        return self._by_file[path]

    def light_map_from_uri(self, uri: str, mesh: Path, files: list[Path], warn: Warn) -> LightMapSource | None:
        """Returns the light map that ``mesh`` references, as ``from_uri``.

        Raises:
            MeshError: the image has more than ``MAX_PIXELS``.
        """
        path = self._find(uri, mesh, files, warn, True)
        if path is None or not self.decode:
            return None
        if path not in self._light_maps:
            pixels = self._file_pixels(path, self._light_map_pixels)
            self._light_maps[path] = None if pixels is None else LightMapSource(str(path), pixels)
        if self._light_maps[path] is None:
            _warn_of_file(mesh, path, "light map", warn)
        return self._light_maps[path]

    def light_map_from_bytes(self, name: str, data: bytes, warn: Warn) -> LightMapSource | None:
        """Returns the light map in ``data``, as ``from_bytes``.

        Raises:
            MeshError: the image has more than ``MAX_PIXELS``.
        """
        if not self.decode:
            return None
        pixels = self._light_map_pixels(name, data)
        if pixels is None:
            warn(f"{name} cannot be decoded ({len(data)} bytes); the surface is drawn without its light")
            return None
        source = LightMapSource(name, pixels)
        if self.decode == "sizes":
            self._encoded[id(source)] = (source, data)
        return source

    def _find(self, uri: str, mesh: Path, files: list[Path], warn: Warn, search: bool) -> Path | None:
        """Returns the resolved path of an image, which is appended to ``files``, or None with a warning."""
        named = local_path(uri, mesh.parent)
        path = named if is_file(named) else (self._nearby(named, mesh) if search else None)
        key = (path or named, self.roots)
        if key not in self._inside:
            self._inside[key] = is_inside(*key)
        if not self._inside[key]:
            text = (
                f"{mesh}: texture {quoted(uri)} lies outside the folder of the mesh and of its model; it is not read, "
                "put it beside the mesh"
            )
            warn(Omission(text, OmissionKind.UNSUPPORTED_ASSET))
            return None
        if path is None:
            text = f"{mesh}: texture {named.name} is missing (searched {named}); the surface is drawn without it"
            warn(Omission(text, OmissionKind.MISSING_ASSET))
            return None
        if path != named and path.name.lower() != named.name.lower():
            warn(f"{mesh}: texture {named.name} is missing; used {path.name}, the only image beside the mesh")
        path = Path(os.path.realpath(path))
        if path not in files:
            files.append(path)
        return path

    def _file_pixels(self, path: Path, pixels: Callable[[str, bytes], NDArray[_Depth] | None]) -> NDArray[_Depth] | None:
        """Returns the pixels of an image file by ``pixels``; None if it cannot be read or decoded."""
        try:
            return pixels(str(path), read_file(path, MAX_IMAGE_BYTES))
        except OSError:
            return None

    def from_bytes(self, name: str, data: bytes, warn: Warn) -> TextureSource | None:
        """Returns the image in ``data``, the bytes of an image file, or None with a warning.

        Args:
            name: name of the image, for messages.
            data: the bytes.
            warn: called with one line about the image if it cannot be decoded.

        Raises:
            MeshError: the image has more than ``MAX_PIXELS``.
        """
        if not self.decode:
            return None
        pixels = self._pixels(name, data)
        if pixels is None:
            warn(f"{name} cannot be decoded ({len(data)} bytes); the surface is drawn without it")
            return None
        source = TextureSource(name, pixels)
        if self.decode == "sizes":
            self._encoded[id(source)] = (source, data)
        return source

    def with_sampling(self, texture: TextureSource, sampling: Sampling) -> TextureSource:
        """Returns the image of a texture of this store with another sampling; one object for equal arguments."""
        if sampling == texture.sampling:
            return texture
        key = (id(texture), sampling)
        if key not in self._sampled:
            other = TextureSource(texture.name, texture.pixels, sampling)
            self._sampled[key] = (texture, other)
            if id(texture) in self._encoded:
                self._encoded[id(other)] = (other, self._encoded[id(texture)][1])
        return self._sampled[key][1]

    def encoded(self, texture: TextureSource | LightMapSource) -> bytes:
        """Returns the encoded image of a texture of this store, whose ``decode`` is "sizes".

        Raises:
            OSError: the file cannot be read.
        """
        return self._encoded[id(texture)][1] if id(texture) in self._encoded else Path(texture.name).read_bytes()

    def _pixels(self, name: str, data: bytes) -> NDArray[np.uint8] | None:
        """Returns the pixels (H, W, C) uint8 of an image file, black if ``decode`` is "sizes"; None if it cannot be decoded."""
        size = image_size(data)
        if self.decode == "sizes":
            black = np.zeros((1, 1, 1), dtype=np.uint8)
            return None if size is None else np.broadcast_to(black, (size.height, size.width, size.channels))
        return None if size is None else decode_image(_within_limit(name, size, data))

    def _light_map_pixels(self, name: str, data: bytes) -> NDArray[np.uint16] | None:
        """Returns the pixels (H, W, 3) uint16 of a light map, black if ``decode`` is "sizes"; None if it cannot be decoded."""
        size = image_size(data)
        if self.decode == "sizes":
            black = np.zeros((1, 1, 1), dtype=np.uint16)
            return None if size is None else np.broadcast_to(black, (size.height, size.width, 3))
        return None if size is None else decode_light_map(_within_limit(name, size, data))

    def _nearby(self, named: Path, mesh: Path) -> Path | None:
        """Returns the image of that name in the usual folders near the mesh, else the only image beside an OBJ mesh, else None."""
        mesh_folder = mesh.parent
        # Gazebo models have `meshes/` beside `materials/textures/`; meshes may also lie in sub-folders of `meshes/`.
        above = [folder for folder in mesh_folder.parents[:_LEVELS_UP] if is_inside(folder, self.roots)]
        texture_folders = [folder for folder in above for folder in (folder / "textures", folder / "materials" / "textures")]
        for folder in map(find_ignoring_case, (named.parent, mesh_folder, mesh_folder / "textures", *texture_folders)):
            if not (is_folder(folder) and is_inside(folder, self.roots)):
                continue
            for entry in sorted(folder.iterdir()):
                if entry.name.lower() == named.name.lower() and is_file(entry):
                    return entry
        images = [p for p in sorted(mesh_folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES and is_file(p)]
        # Scans are often one mesh and one image, which users rename.
        return images[0] if len(images) == 1 and mesh.suffix.lower() == ".obj" else None


def _warn_of_file(mesh: Path, path: Path, what: str, warn: Warn) -> None:
    """Warns of an image file that cannot be decoded."""
    text = f"{mesh}: {what} {path.name} cannot be decoded ({path}); the surface is drawn without it"
    warn(Omission(text, OmissionKind.UNSUPPORTED_ASSET))


def _within_limit(name: str, size: ImageHeader, data: bytes) -> bytes:
    """Returns the bytes of an image file of this size.

    Raises:
        MeshError: it has more than ``MAX_PIXELS``.
    """
    if size.pixels > MAX_PIXELS:
        raise MeshError(
            f"{name}: has {size.width} x {size.height} pixels, {size.decoded_bytes / 2**20:.0f} MB in memory; "
            f"at most {MAX_PIXELS // 2**20} million pixels are read. Scale it down: gibson-sim scene check SCENE --fix --output FOLDER"
        )
    return data


def decode_pixels(data: bytes, flags: int) -> NDArray[Any] | None:
    """Returns an image decoded by OpenCV, or None if it cannot be decoded or has more than ``MAX_PIXELS``.

    The header is checked first, because a PNG of a few KB can decode to gigabytes.

    Args:
        data: bytes of an image file or message.
        flags: ``cv2.IMREAD_...``.
    """
    size = image_size(data)
    if size is None or size.pixels > MAX_PIXELS:
        return None
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image)


def decode_image(data: bytes) -> NDArray[np.uint8] | None:
    """Returns the pixels of an encoded image, (H, W, 3) RGB or (H, W, 4) RGBA uint8, or None if it cannot be decoded."""
    size = image_size(data)
    if size is not None and size.kind and size.pixels <= MAX_PIXELS:
        image = _decode_by_pillow(data, size)
        if image is not None:
            return image
    image = decode_pixels(data, cv2.IMREAD_UNCHANGED)
    if image is None or size is None:
        return None
    opacity: NDArray[np.uint8] | None = None
    if size.transparent_grey is not None and image.ndim == 2:
        opacity = np.where(image == size.transparent_grey, 0, 255).astype(np.uint8)
    if size.white not in (0, np.iinfo(image.dtype).max if image.dtype.kind == "u" else 0):
        image = np.rint(np.minimum(image / size.white, 1.0) * 255.0).astype(np.uint8)
    elif image.dtype == np.uint16:
        image = (image // 257).astype(np.uint8)
    elif image.dtype != np.uint8:
        image = np.clip(image * 255.0, 0, 255).astype(np.uint8)
    if image.ndim == 2 or image.shape[2] == 1:
        grey = np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2)
        return grey if opacity is None else np.dstack([grey, opacity])
    if image.shape[2] == 2:
        return np.concatenate([np.repeat(image[:, :, :1], 3, axis=2), image[:, :, 1:]], axis=2)
    code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), dtype=np.uint8)


def decode_light_map(data: bytes) -> NDArray[np.uint16] | None:
    """Returns the pixels of an encoded light map, (H, W, 3) uint16, of 16 or 8 bits in the file; None if it cannot be decoded."""
    image = decode_pixels(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        return None
    rgb = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)).astype(np.uint16)
    return rgb if image.dtype == np.uint16 else rgb * np.uint16(257)


def _decode_by_pillow(data: bytes, size: ImageHeader) -> NDArray[np.uint8] | None:
    """Returns the pixels of an image of a kind that OpenCV cannot decode, or not its alpha: (H, W, 3) RGB or (H, W, 4) RGBA uint8.

    None if Pillow cannot decode it either, or not to 8 bits.
    """
    # Here, since few scenes have such an image and Pillow takes as long to import as a small scene to load.
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=[size.kind]) as image:
            if image.mode in ("F", "I", "I;16", "I;16B"):
                return None
            if size.kind == "TGA" and size.channels == 3:
                # Pillow takes the unused bit of 16 for opacity.
                return np.array(image.convert("RGBA"))[:, :, :3].copy()
            pixels = np.array(image.convert("RGBA" if image.has_transparency_data else "RGB"))
            if size.kind == "TGA" and data[7 if data[2] in (1, 9) else 16] == 16 and image.mode != "LA" and pixels.shape[2] == 4:
                # 1 = opaque in most programs, but not in Pillow.
                pixels[:, :, 3] = 255 - pixels[:, :, 3]
            return pixels
    except (OSError, ValueError, SyntaxError, IndexError, struct.error, Image.DecompressionBombError):
        return None
