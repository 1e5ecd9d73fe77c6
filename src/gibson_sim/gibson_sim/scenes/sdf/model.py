"""Reads SDF models (1.4 to 1.12): their scopes, with all nested and included models, and their shapes as static shapes of the scene.

``sdf.body`` reads models as bodies for physics, with joints and masses.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.errors import SceneError
from gibson_sim.formats.uris import UriResolver
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, parse_xml
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder, class_from_model
from gibson_sim.scenes.sdf.elements import (
    F64,
    Element,
    Warn,
    is_true,
    name_of,
    numbers,
    pose_matrix,
    read_sdf,
    sdf_files,
    sdf_version,
    text_of,
)  # fmt: skip
from gibson_sim.scenes.sdf.geometry import PlacedShape, SdfShapes
from gibson_sim.scenes.sdf.left_out import LeftOut, listed
from gibson_sim.scenes.sdf.materials import is_visible, material_of
from gibson_sim.scenes.sdf.scopes import WORLD, Frame, Scope, reference_of
from gibson_sim.types import Rgba

_PLAIN_GREY: Rgba = (0.7, 0.7, 0.7, 1.0)
"""Colour of collision shapes that are drawn in place of missing visuals, sRGB and alpha."""
_NEWEST = (1, 12)
"""Newest version of SDF that is read."""
_MAX_NESTING = 16
"""Maximum nesting depth of models."""
_MAX_MODELS = 10_000
"""Maximum number of models of a scene, including nested and included models."""
_INCLUDABLE = ("model", "actor", "light")
"""Elements that a file for an <include> may hold, in the order in which they are looked for."""
_LEVEL = 0.999
"""Minimum cosine of the angle between the normal of a plane and the vertical at which the plane is the ground."""


class SdfModels:
    """Reads the models of one scene, and adds them to its builder."""

    def __init__(self, builder: SceneBuilder, uris: UriResolver) -> None:
        self.builder = builder
        self.uris = uris
        self.shapes = SdfShapes(builder, uris)
        self._documents: dict[Path, tuple[Element, tuple[int, ...]]] = {}
        self._count = 0
        self.left_out = LeftOut()
        """Elements that have no effect, of all models so far."""
        self.without_collision: dict[str, None] = {}
        """Names of the models that collide as they are drawn, since they have no <collision>."""
        self.lights: list[tuple[Element, F64]] = []
        """Lights of the links of placed models, each with T_world_light, (4, 4)."""

    # Scopes

    def scope(self, element: Element, name: str, base: Path, version: tuple[int, ...], file: Path | None = None) -> Scope:
        """Returns the scope of a <world> or <model>, with those of all nested and included models.

        Args:
            element: the <world> or <model>.
            name: its name, for warnings.
            base: folder of relative file names.
            version: version of SDF, such as (1, 7).
            file: its file, which it must not include; None = not a file.

        Raises:
            SceneError: models are nested too deeply, there are too many, or a chain of frames is too long.
        """
        self._check_version(version, f"model {name}" if file is None else str(file))
        files = () if file is None else (Path(os.path.realpath(file)),)
        scope = Scope(element, name, base, version, self.builder.warn, files, is_static=is_true(element.findtext("static")))
        self._fill(scope, 0)
        try:
            scope.check()
        except RecursionError as e:
            raise SceneError(f"{scope.where}: a chain of frames that are relative to each other is too long; shorten it") from e
        return scope

    def scope_of_file(self, file: Path, name: str) -> Scope | None:
        """Returns the scope of the model in a file, or None after a warning.

        Raises:
            SceneError: the file cannot be read.
        """
        top = self._document(file)
        if top is None or top[0].tag != "model":
            return None
        return self.scope(top[0], name, file.parent, top[1], file)

    def _fill(self, scope: Scope, depth: int) -> None:
        """Adds the frames and nested models of a scope."""
        if scope.element.tag == "model":
            self._count_model(scope.where, depth)
            self.left_out.visit(scope.element, scope.where)
        for child in scope.element:
            if child.tag in ("link", "frame", "joint") and not (child.tag == "link" and scope.element.tag == WORLD):
                scope.add(name_of(child), Frame(child, scope))
            elif child.tag == "model":
                name = name_of(child) or "model"
                inner = Scope(child, _joined(scope, name), scope.base, scope.version, scope.warn, scope.files)
                inner.is_static = scope.is_static or is_true(child.findtext("static"))
                self._add_model(
                    scope, child, Frame(child, scope, inner, placement=child.get("placement_frame", "").strip()), name
                )
                self._fill(inner, depth + 1)
            elif child.tag == "include":
                self._include(scope, child, depth)

    def _add_model(self, scope: Scope, child: Element, frame: Frame, name: str) -> None:
        scope.add(name, frame)
        scope.nested[child] = frame

    def _include(self, scope: Scope, element: Element, depth: int) -> None:
        """Adds the model or light that an <include> names, or warns."""
        uri = text_of(element, "uri")
        builtin = builtin_model(uri) if scope.element.tag == WORLD else ""
        if builtin and self.uris.find(uri, scope.base) is None:
            # Gazebo's sun is the default light.
            if builtin == "ground_plane":
                name = text_of(element, "name") or builtin
                inner = Scope(GROUND_PLANE, name, scope.base, scope.version, scope.warn, scope.files, is_static=True)
                self._add_model(scope, element, Frame(GROUND_PLANE, scope, inner, element), name)
                self._fill(inner, depth + 1)
            return
        try:
            path = self.find_model(uri, scope.base)
            top = None if path is None else self._document(path)
        except SceneError as e:
            self.builder.warn(f"{e}; left out", OmissionKind.UNSUPPORTED_ASSET)
            return
        if path is None or top is None:
            return
        model, version = top
        pose = element if element.find("pose") is not None else model
        if model.tag == "light":
            scope.lights.append((model, pose))
            return
        name = text_of(element, "name") or model.get("name", "") or path.parent.name
        if model.tag == "actor":
            self.builder.warn(f"<actor> {quoted(name)} is not supported; left out", OmissionKind.UNSUPPORTED_ELEMENT)
            return
        real = Path(os.path.realpath(path))
        if real in scope.files:
            self.builder.warn(f"model {name}: {path} includes itself; the inner one is left out", OmissionKind.INVALID)
            return
        placement = text_of(element, "placement_frame")
        if placement and element.find("pose") is None:
            self.builder.warn(f"model {name}: <placement_frame> needs a <pose>; it has no effect", OmissionKind.INVALID)
            placement = ""
        if element.find("{*}params") is not None or any(child.tag.endswith(":params") for child in element):
            text = f"model {name}: parameters of its <include> are not applied; it is that of the file"
            self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
        inner = Scope(
            model, _joined(scope, name), path.parent, version, scope.warn, (*scope.files, real), _model_name(uri, model)
        )
        static = element.findtext("static")
        inner.is_static = scope.is_static or is_true(model.findtext("static") if static is None else static)
        placement = placement or model.get("placement_frame", "").strip()
        frame = Frame(model, scope, inner, pose, placement)
        if is_true(element.get("merge")):
            # Its elements become those of this model, and its frame a frame of this model.
            inner.model_frame = name = f"_merged__{name}__model__"
            inner.frames = scope.frames
        self._add_model(scope, element, frame, name)
        self._fill(inner, depth + 1)

    def _count_model(self, where: str, depth: int) -> None:
        """Counts a model of the scene.

        Raises:
            SceneError: the model is nested too deeply, or the scene has too many models.
        """
        self._count += 1
        if depth > _MAX_NESTING:
            raise SceneError(f"{where}: models are nested deeper than {_MAX_NESTING}; nest fewer")
        if self._count > _MAX_MODELS:
            raise SceneError(f"{where}: the scene has more than {_MAX_MODELS} models; do models include each other?")

    def _document(self, path: Path) -> tuple[Element, tuple[int, ...]] | None:
        """Returns the model, light or actor of an SDF file, and its version, or None after a warning; each file is parsed once."""
        if path not in self._documents:
            if not self.builder.admits(path):
                self.builder.warn(f"{path}: lies outside the scene's folder; left out", OmissionKind.UNSUPPORTED_ASSET)
                return None
            root = read_sdf(self.builder, path)
            tops = (
                [root]
                if root.tag == "model"
                else [e for e in root if e.tag in _INCLUDABLE]
                if root.tag in ("sdf", "gazebo")
                else []
            )
            if not tops:
                self.builder.warn(f"{path}: holds no <model>; left out", OmissionKind.UNSUPPORTED_ASSET)
                return None
            tops.sort(key=lambda top: _INCLUDABLE.index(top.tag))
            if len(tops) > 1:
                kind = tops[0].tag
                self.builder.warn(f"{path}: holds more than one <{kind}>; the first <{kind}> is used", OmissionKind.OTHER)
            self._documents[path] = tops[0], sdf_version(root)
            self._check_version(sdf_version(root), str(path))
        return self._documents[path]

    def _check_version(self, version: tuple[int, ...], where: str) -> None:
        """Warns about a version of SDF that is newer than the newest one that is read."""
        if version[:2] > _NEWEST:
            newest, given = (".".join(map(str, parts)) for parts in (_NEWEST, version))
            self.builder.warn(f"{where}: is SDF {given}, and is read as {newest}, the newest version known here")

    def find_model(self, uri: str, base: Path) -> Path | None:
        """Returns the SDF file of the model at a URI, or None with a warning; ``base``: folder of relative URIs."""
        location = self.uris.find(uri, base) if uri else None
        if location is None:
            reason = self.uris.reason_missing(uri) if uri else "does not exist"
            self.builder.warn(f"model {uri or '(without a uri)'} {reason}; left out", OmissionKind.MISSING_ASSET)
            return None
        if is_file(location):
            return location
        for candidate in sdf_files(location):
            if is_file(candidate):
                return candidate
        self.builder.warn(f"model {uri}: {location} holds no model.sdf; left out", OmissionKind.MISSING_ASSET)
        return None

    # Static models

    def place(self, scope: Scope, T_world_scope: F64, top: str) -> None:
        """Adds the shapes of a model, and of all models in it, to the scene.

        Args:
            scope: that of the model.
            T_world_scope: (4, 4), with the model's own <pose>.
            top: name of the outermost model, which becomes the name of the shapes.
        """
        where = f"model {top}"
        if not np.isfinite(T_world_scope).all() or np.abs(T_world_scope[:3, 3]).max() > FAR_AWAY:
            at = ", ".join(f"{c:g}" for c in T_world_scope[:3, 3])
            self.builder.warn(
                f"{where}: is at ({at}) m, more than {FAR_AWAY:g} m from the origin; left out", OmissionKind.INVALID
            )
            return
        for nested in scope.nested.values():
            if nested.inner is not None:
                self.place(nested.inner, T_world_scope @ scope.origin(nested), top)
        kind = class_from_model(scope.kind or scope.element.get("name", ""))
        links = [(link, T_world_scope @ scope.placed(link)) for link in scope.element.iterfind("link")]
        has_collision = any(link.find("collision") is not None for link, _ in links)
        visual_count, collision_count = 0, 0
        for link, T_world_link in links:
            visuals = [
                self._visual(scope, element, T_world_scope, T_world_link, top, kind, not has_collision)
                for element in link.iterfind("visual")
            ]
            visual_count += sum(visuals)
            for light in link.iterfind("light"):
                reference = reference_of(light)
                parent = T_world_scope @ scope.pose(reference) if reference else T_world_link
                self.lights.append((light, parent @ pose_matrix(light, where, self.builder.warn)))
            # If all visuals are missing, the collision shapes are drawn, so that the link is not an invisible obstacle.
            visuals_missing = bool(visuals) and not any(visuals)
            for element in link.iterfind("collision"):
                friction = world_friction(element, where, self.builder.warn)
                for item in self.shapes.read(scope, element, T_world_scope, T_world_link, where):
                    if self._is_ground(item, friction, where):
                        continue
                    collision_count += 1
                    self.builder.add_collision(top, item.shape, item.matrix, friction)
                    if visuals_missing:
                        visual_count += 1
                        self.builder.add_visual(top, item.shape, item.matrix, _PLAIN_GREY, kind)
                        self.builder.warn(
                            f"{where}: is drawn as its collision shapes, in plain grey: its visuals cannot be drawn"
                        )
        if visual_count and not has_collision:
            self.without_collision[top] = None
        if collision_count and not visual_count:
            self.builder.warn(f"{where}: is invisible: it has collision shapes, but no visual")

    def report(self) -> None:
        """Warns about what has no effect, and about models that collide as they are drawn, of all models so far."""
        self.left_out.report(self.builder.warn)
        if self.without_collision:
            self.builder.warn(f"{listed(list(self.without_collision))}: without a <collision>: collides as it is drawn")
            self.without_collision.clear()

    def _visual(
        self, scope: Scope, element: Element, T_world_scope: F64, T_world_link: F64, top: str, kind: str, collides: bool
    ) -> bool:
        """Adds a <visual>; returns whether it is drawn, or invisible on purpose."""
        where, visible = f"model {top}", is_visible(element)
        geometry = element.find("geometry")
        handled = not visible or geometry is None or geometry.find("empty") is not None
        for item in self.shapes.read(scope, element, T_world_scope, T_world_link, where):
            handled = True
            if visible:
                material = material_of(element, self.builder.has_textures(item.shape), where, self.builder.warn)
                self.builder.add_visual(top, item.shape, item.matrix, material.color, kind, material.appearance)
            if collides:
                self.builder.add_collision(top, item.shape, item.matrix)
        return handled

    def _is_ground(self, item: PlacedShape, friction: float, where: str) -> bool:
        """Returns whether a collision shape is a level plane, which becomes the ground of the scene; warns about other planes."""
        if item.T_plane is None:
            return False
        if item.T_plane[2, 2] < _LEVEL:
            x, y = item.shape.size[:2]
            self.builder.warn(
                f"{where}: a plane that is not level collides as a plate of its <size>, {x:g} x {y:g} m, not as an infinite plane"
            )
            return False
        height = float(item.T_plane[2, 3])
        if self.builder.ground_z is None or height >= self.builder.ground_z:
            self.builder.ground_z, self.builder.ground_friction = height, friction
        return True


def friction_of(collision: Element, where: str, warn: Warn) -> float | None:
    """Returns the friction coefficient of a <collision>, None if it is not given or, with a warning, invalid."""
    for path in ("ode/mu", "bullet/friction"):
        text = text_of(collision, f"surface/friction/{path}")
        if text:
            value = numbers(text, (1,))
            if value is not None:
                return value[0]
            tag = path.rpartition("/")[2]
            warn(f"{where}: friction: <{tag}> is {quoted(text)}, must be a finite number", OmissionKind.INVALID)
    return None


def world_friction(collision: Element, where: str, warn: Warn) -> float:
    """Returns the friction coefficient of a fixed shape, 0 to 1.

    In Gazebo the smaller coefficient of two surfaces counts, here their product, which is the same if that of the world is 1.
    """
    friction = friction_of(collision, where, warn)
    return 1.0 if friction is None else min(max(friction, 0.0), 1.0)


def builtin_model(uri: str) -> str:
    """Returns which of the models that Gazebo's installation contains a URI names: "sun", "ground_plane" or "" (neither)."""
    name = uri.rstrip("/").rpartition("/")[2].lower().replace(" ", "_")
    return name if name in ("sun", "ground_plane") else ""


GROUND_PLANE = parse_xml(
    b'<model name="ground_plane"><static>true</static><link name="link"><collision name="collision"><geometry><plane/></geometry>'
    b"</collision></link></model>"
)
"""The ground plane of Gazebo."""


def _joined(scope: Scope, name: str) -> str:
    """Returns the full name of a nested model, for warnings."""
    return name if scope.element.tag == WORLD else f"{scope.name}::{name}"


def _model_name(uri: str, model: Element) -> str:
    """Returns the name from which the semantic class of an included model is derived: that of its folder, else that of the model."""
    parts = [p for p in uri.partition("://")[2].split("/") if p and p != "models"]
    return parts[0] if parts and uri.startswith(("model://", "file://")) else model.get("name", "")
