"""Reads Drake's model directives (``*.dmd.yaml``): add_model, add_weld and add_frame; ignores other directives with a warning."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.errors import MeshError, SceneError, TextError
from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.formats.uris import UriResolver
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.reading import YAML_LOADER, parse_yaml
from gibson_sim.scenes.builder import SceneBuilder, class_from_model
from gibson_sim.scenes.sdf.model import SdfModels
from gibson_sim.scenes.sdf.scopes import Scope

F64 = NDArray[np.float64]


class _Loader(YAML_LOADER):  # type: ignore[misc]
    """YAML loader that reads Drake's tags ``!Rpy`` and ``!AngleAxis`` as mappings with these keys."""


def _tagged(loader: _Loader, suffix: str, node: yaml.Node) -> dict[str, Any]:
    content = loader.construct_mapping(node, deep=True) if isinstance(node, yaml.MappingNode) else {}
    return {suffix: content}


_Loader.add_multi_constructor("!", _tagged)


def parse_directives(text: bytes) -> Any:
    """Returns the document of a model directives file, with Drake's tags as mappings.

    Raises:
        TextError: as ``parse_yaml``.
    """
    return parse_yaml(text, _Loader)


def read_drake_directives(builder: SceneBuilder, path: Path) -> None:
    """Adds all models of a directives file to the builder.

    Raises:
        SceneError: the file is not a model directives file.
    """
    try:
        document = parse_directives(builder.read_bytes(path))
    except TextError as e:
        raise SceneError(f"{path}: {e}").with_public(e.public) from e
    directives = document.get("directives") if isinstance(document, dict) else None
    if not isinstance(directives, list):
        raise SceneError(f"{path}: has no list `directives`; is it a Drake model directives file?")
    reader = _DirectivesReader(builder, path)
    for directive in directives:
        if not isinstance(directive, dict) or len(directive) != 1:
            builder.warn(f"{path}: directive {quoted(directive)} is not a mapping with one key; left out", OmissionKind.INVALID)
            continue
        ((name, content),) = directive.items()
        reader.directive(str(name), content if isinstance(content, dict) else {})
    reader.place_models()


class _DirectivesReader:
    """Collects models, welds and frames in the order of the file, then places the models."""

    def __init__(self, builder: SceneBuilder, path: Path) -> None:
        self.builder = builder
        self.path = path
        self.uris = UriResolver(builder.root, path.parent)
        self.models = SdfModels(builder, self.uris)
        self._models: dict[str, Scope | None] = {}
        """Name -> scope of an SDF model; None for a mesh."""
        self._files: dict[str, Path] = {}
        self._poses: dict[str, F64] = {}
        self._frames: dict[str, F64] = {"world": np.eye(4)}

    def directive(self, name: str, content: dict[str, Any]) -> None:
        """Handles one directive."""
        if name == "add_model":
            self._add_model(content)
        elif name == "add_weld":
            self._add_weld(content)
        elif name == "add_frame":
            transform = content.get("X_PF") or {}
            base = self._frame(str(transform.get("base_frame", "world")))
            if base is not None:
                self._frames[str(content.get("name", ""))] = base @ self._transform(transform)
        else:
            text = f"{self.path}: directive {name} is not supported; left out"
            self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)

    def place_models(self) -> None:
        """Adds every model at the pose of its weld, or at the origin of the world."""
        for name, scope in self._models.items():
            if name not in self._poses:
                self.builder.warn(f"{self.path}: model {quoted(name)} has no weld; it is placed at the origin")
            matrix = self._poses.get(name, np.eye(4))
            if scope is not None:
                self.models.place(scope, matrix, name)
                continue
            try:
                shape, T_world_shape = self.builder.mesh_shape(self._files[name], matrix, (1.0, 1.0, 1.0))
            except MeshError as e:
                self.builder.warn(f"model {name}: {e}; left out", OmissionKind.UNSUPPORTED_ASSET)
                continue
            self.builder.add_visual(name, shape, T_world_shape, None, class_from_model(name))
            self.builder.add_collision(name, shape, T_world_shape)
        self.models.report()

    def _add_model(self, content: dict[str, Any]) -> None:
        name, uri = str(content.get("name", "")), str(content.get("file", ""))
        file = self.uris.find(uri, self.path.parent) if uri else None
        if file is None:
            self.builder.warn(f"model {quoted(name)}: file {quoted(uri)} does not exist; left out", OmissionKind.MISSING_ASSET)
            return
        if file.suffix.lower() in MESH_SUFFIXES:
            self._models[name], self._files[name] = None, file
            return
        try:
            scope = self.models.scope_of_file(file, name)
        except SceneError as e:
            self.builder.warn(f"{e}; left out", OmissionKind.UNSUPPORTED_ASSET)
            return
        if scope is not None:
            self._models[name] = scope

    def _add_weld(self, content: dict[str, Any]) -> None:
        parent, child = str(content.get("parent", "world")), str(content.get("child", ""))
        model, _, frame = child.partition("::")
        if model not in self._models:
            self.builder.warn(f"{self.path}: weld of {quoted(child)}: the model does not exist; left out")
            return
        base = self._frame(parent)
        if base is None:
            return
        T_world_child = base @ self._transform(content.get("X_PC") or {})
        scope = self._models[model]
        self._poses[model] = T_world_child if scope is None else T_world_child @ invert(scope.pose(frame))

    def _frame(self, name: str) -> F64 | None:
        """Returns T_world_frame (4, 4), or None after a warning."""
        if name in self._frames:
            return self._frames[name]
        model, _, frame = name.partition("::")
        if model in self._models:
            scope = self._models[model]
            within = np.eye(4) if scope is None else scope.pose(frame)
            return self._poses.get(model, np.eye(4)) @ within
        self.builder.warn(f"{self.path}: frame {quoted(name)} is unknown; models fixed to it are not moved")
        return None

    def _transform(self, content: dict[str, Any]) -> F64:
        """Returns the transform (4, 4) of a translation (metres) and a rotation (!Rpy or !AngleAxis, degrees)."""
        try:
            x, y, z = (float(c) for c in content.get("translation") or (0, 0, 0))
            rotation = content.get("rotation") or {}
            if "Rpy" in rotation:
                roll, pitch, yaw = (math.radians(float(c)) for c in rotation["Rpy"].get("deg", (0, 0, 0)))
                return matrix_from_pose(pose_from_xyz_rpy((x, y, z), (roll, pitch, yaw)))
            matrix = np.eye(4)
            matrix[:3, 3] = (x, y, z)
            if "AngleAxis" in rotation:
                matrix[:3, :3] = _axis_angle(rotation["AngleAxis"])
            elif rotation:
                text = f"{self.path}: rotation {quoted(rotation)} is not supported; zero is used"
                self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
            return matrix
        except (TypeError, ValueError, KeyError, AttributeError) as e:
            raise SceneError(f"{self.path}: transform {quoted(content)} cannot be read: {e}") from e


def _axis_angle(content: dict[str, Any]) -> F64:
    """Returns the rotation (3, 3) of an !AngleAxis, by Rodrigues' formula."""
    axis = np.asarray(content["axis"], dtype=np.float64)
    x, y, z = axis / np.linalg.norm(axis)
    angle = math.radians(float(content["angle_deg"]))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: F64 = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return rotation
