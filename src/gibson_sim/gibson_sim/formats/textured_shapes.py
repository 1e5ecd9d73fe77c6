"""Gives shapes of a URDF the textures of their materials, by GLB files in the cache: primitives and meshes with texture coordinates."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from gibson_sim.description.omissions import Omission, OmissionKind
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf_model import UrdfModel, UrdfVisual
from gibson_sim.errors import MeshError, WriteError
from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.formats.image_header import MAX_IMAGE_BYTES
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.textures import decode_image
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, read_file
from gibson_sim.resources import cache_folder
from gibson_sim.writing import write_file


def with_textures(model: UrdfModel) -> UrdfModel:
    """Returns the model with shapes that have the textures of their visuals; what cannot be textured keeps its colour, with a warning.

    A texture covers each side of a box, and goes once around other primitives; a mesh has texture coordinates of its own.
    """
    if not any(visual.texture for link in model.links for visual in link.visuals):
        return model
    loader = MeshLoader(None, textures=False)
    warnings: list[str] = []

    def textured(visual: UrdfVisual) -> UrdfVisual:
        if not visual.texture:
            return visual
        try:
            return replace(visual, shape=_textured(visual.shape, Path(visual.texture), loader), color=None, texture="")
        except (MeshError, WriteError, OSError) as error:
            text = f"{model.path.name}: texture {visual.texture} is left out: {error}"
            warnings.append(Omission(text, OmissionKind.UNSUPPORTED_ASSET))
            return replace(visual, texture="")

    links = tuple(replace(link, visuals=tuple(map(textured, link.visuals))) for link in model.links)
    return replace(model, links=links, warnings=(*model.warnings, *dict.fromkeys(warnings)))


def _textured(shape: Shape, image: Path, loader: MeshLoader) -> Shape:
    """Returns a mesh with the surface of a shape and a texture.

    Raises:
        MeshError: the image or the mesh cannot be read, or the mesh has no texture coordinates.
        OSError: a file cannot be read or written.
    """
    data = read_file(image, MAX_IMAGE_BYTES)
    if decode_image(data) is None:
        raise MeshError("it is not a readable image")
    builder = GlbBuilder()
    surface = {"baseColorTexture": {"index": builder.texture_data(data)}, "metallicFactor": 0.0, "roughnessFactor": 1.0}
    material = builder.material({"name": image.stem, "pbrMetallicRoughness": surface, "doubleSided": True})
    for part in loader.shape(shape).parts:
        if part.uvs is None:
            raise MeshError(f"mesh {quoted(Path(shape.mesh).name)} has no texture coordinates")
        attributes = {
            "POSITION": builder.attribute(part.vertices, bounds=True), "NORMAL": builder.attribute(part.normals),
            "TEXCOORD_0": builder.attribute(part.uvs),
        }  # fmt: skip
        builder.primitive(attributes, builder.indices(part.triangles), material)
    content = builder.to_bytes(image.stem, Z_UP_TO_Y_UP)
    file = cache_folder("textured") / f"{hashlib.sha256(content).hexdigest()[:24]}.glb"
    if not is_file(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, content)
    return Shape("mesh", (1.0, 1.0, 1.0), str(file))
