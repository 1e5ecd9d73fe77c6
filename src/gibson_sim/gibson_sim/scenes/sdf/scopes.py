"""Scopes and frames of SDF: which element a name means, where it is, and to which link it is attached.

A world and each model have a scope. Names mean the links, models, frames and joints of their own scope, ``a::b`` those of a nested model, and
``__model__`` the model itself. Before SDF 1.7 poses could only be relative to the parent (or, in 1.5 and 1.6, to a ``frame``), a subset.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.geometry.transforms import invert
from gibson_sim.quoting import quoted
from gibson_sim.scenes.sdf.elements import F64, Element, Warn, name_of, pose_matrix, text_of

WORLD = "world"
"""Name of the world as a frame, and as the parent of joints."""
MODEL = "__model__"
"""Name of the frame of the model whose scope it is."""
_SEPARATOR = "::"
_RANKS = ("link", "model", "frame", "joint")
"""Tags of the elements that have a frame. Until SDF 1.6 elements of different kinds could have the same name: a name means the first of these."""


@dataclass(slots=True, eq=False)
class Frame:
    """An element with a name and a pose."""

    element: Element
    scope: Scope
    """Scope of the names that it refers to."""
    inner: Scope | None = None
    """Scope of a nested model."""
    pose: Element | None = None
    """Element with its <pose>: an <include> that overrides that of the included model; None = ``element``."""
    placement: str = ""
    """Frame of a nested model that its pose places; empty = the model's own frame."""
    T_scope: F64 | None = None
    """Pose in the scope, (4, 4); None = not yet computed."""
    is_open: bool = False
    """Whether its pose is being computed, to find cycles."""

    @property
    def reference(self) -> str:
        """Name of the frame that its pose is relative to; empty = the scope's."""
        given = reference_of(self.element if self.pose is None else self.pose)
        if given:
            return given
        if self.element.tag == "frame":
            return self.element.get("attached_to", "").strip()
        return text_of(self.element, "child") if self.element.tag == "joint" else ""


@dataclass(slots=True, eq=False)
class Scope:
    """The names in a <world> or a <model>. A model merged into another shares the names and the frame of that one."""

    element: Element
    """The <world> or <model>."""
    name: str
    """Full name for warnings, such as ``robot::arm``."""
    base: Path
    """Folder of relative file names."""
    version: tuple[int, ...]
    """Version of SDF, such as (1, 7)."""
    warn: Warn
    files: tuple[Path, ...] = ()
    """Resolved paths of the chain of including files, the outermost first, for the detection of cycles."""
    kind: str = ""
    """Name from which the semantic class is derived; empty = the name of the model."""
    is_static: bool = False
    """Whether it is <static>, or inside a model that is."""
    model_frame: str = ""
    """Of a merged model: the name of the frame at which the other model has it; empty = it is not merged."""
    frames: dict[str, Frame] = field(default_factory=dict)
    """Name -> frame."""
    own: dict[Element, Frame] = field(default_factory=dict)
    """Child -> its frame, even if another one has its name."""
    nested: dict[Element, Frame] = field(default_factory=dict)
    """<model> or <include> -> frame of the nested model; an <include> that could not be read is missing."""
    lights: list[tuple[Element, Element]] = field(default_factory=list)
    """Included lights, each with the element that holds its <pose>."""

    @property
    def where(self) -> str:
        """What it is, for warnings."""
        return f"model {self.name}" if self.element.tag == "model" else f"world {self.name}"

    def add(self, name: str, frame: Frame) -> None:
        """Adds a named frame; of several with the same name, that of the first kind in ``_RANKS`` counts."""
        self.own[frame.element] = frame
        known = self.frames.get(name)
        if known is None:
            self.frames[name] = frame
            return
        tags = {known.element.tag, frame.element.tag}
        # Two links of a body are refused by its reader; else both are read, and the first has the name.
        if self.version >= (1, 7) or len(tags) == 1:
            who = f"two <{frame.element.tag}>" if len(tags) == 1 else f"a <{known.element.tag}> and a <{frame.element.tag}>"
            self.warn(f"{self.where}: the name {quoted(name)} is used by {who}, must be unique", OmissionKind.OTHER)
        if _RANKS.index(frame.element.tag) < _RANKS.index(known.element.tag):
            self.frames[name] = frame

    def check(self) -> None:
        """Warns about all references of this scope and of the nested ones that mean nothing, even if nothing depends on them."""
        for child, frame in self.own.items():
            self.T_of(frame)
            if (
                child.tag == "frame"
                and self.element.tag == "model"
                and self.link_of(name_of(child)) is None
                and not self.is_static
            ):
                target = child.get("attached_to", "").strip() or MODEL
                self.warn(
                    f"{self.where}: frame {quoted(name_of(child))} is attached to {quoted(target)}, which leads to no link",
                    OmissionKind.INVALID,
                )
        if self.element.tag == "model" and self.element.get("canonical_link", "").strip() and self.canonical_link() is None:
            name = self.element.get("canonical_link", "").strip()
            self.warn(f"{self.where}: canonical link {quoted(name)} does not exist", OmissionKind.INVALID)
        for nested in self.nested.values():
            if nested.inner is not None:
                nested.inner.check()

    # Poses

    def pose(self, name: str) -> F64:
        """Returns T_scope_frame, (4, 4), of a frame by name; the identity, with a warning, if it is unknown."""
        if name in ("", MODEL):
            return self.T_of(self.frames[self.model_frame]) if self.model_frame else np.eye(4)
        frame = self.frames.get(name)
        if frame is not None:
            return self.T_of(frame)
        if name == WORLD and self.element.tag == "world":
            return np.eye(4)
        nested = self._nested(name)
        if nested is not None:
            head, inner, rest = nested
            return self.T_of(head) @ inner.pose(rest)
        self.warn(f"{self.where}: frame {quoted(name)} is unknown; that of the {self.element.tag} is used", OmissionKind.INVALID)
        return np.eye(4)

    def placed(self, element: Element, pose: Element | None = None) -> F64:
        """Returns T_scope_element, (4, 4), of a child of the scope's element.

        Args:
            element: the child.
            pose: the element that holds its <pose>; None = the child.
        """
        if element in self.own:
            return self.T_of(self.own[element])
        at = element if pose is None else pose
        reference = reference_of(at)
        local = pose_matrix(at, f"{self.where}: {element.tag} {name_of(element)}", self.warn)
        return self.pose(reference) @ local if reference or self.model_frame else local

    def origin(self, nested: Frame) -> F64:
        """Returns T_scope_inner, (4, 4): the pose of the frame in which a nested scope has its poses."""
        return np.eye(4) if nested.inner is not None and nested.inner.model_frame else self.T_of(nested)

    def T_of(self, frame: Frame) -> F64:
        """Returns T_scope_frame, (4, 4); that of the scope, with a warning, for a frame that is relative to itself."""
        if frame.T_scope is None:
            if frame.is_open:
                self.warn(
                    f"{self.where}: frame {quoted(name_of(frame.element))} is relative to itself; that of the {self.element.tag} is used",
                    OmissionKind.INVALID,
                )
                return np.eye(4)
            frame.is_open = True
            where = f"{self.where}: {frame.element.tag} {name_of(frame.element)}"
            local = pose_matrix(frame.element if frame.pose is None else frame.pose, where, self.warn)
            reference = frame.reference
            T_scope = frame.scope.pose(reference) @ local if reference or frame.scope.model_frame else local
            if frame.placement and frame.inner is not None:
                T_scope = T_scope @ invert(self._T_inner_placement(frame, frame.inner))
            frame.T_scope, frame.is_open = T_scope, False
        return frame.T_scope

    def _T_inner_placement(self, frame: Frame, inner: Scope) -> F64:
        """Returns the pose (4, 4) of the placement frame of a nested model in the frame of that model."""
        if not inner.model_frame:
            return inner.pose(frame.placement)
        # The frames of a merged model are relative to the frame that is sought: compute with that at the origin, then forget the results.
        unknown = [(each, each.is_open) for each in self.frames.values() if each.T_scope is None]
        for each, _ in unknown:
            each.is_open = False
        frame.T_scope = np.eye(4)
        T_inner_placement = inner.pose(frame.placement)
        for each, is_open in unknown:
            each.T_scope, each.is_open = None, is_open
        return T_inner_placement

    def _nested(self, name: str) -> tuple[Frame, Scope, str] | None:
        """Returns the frame and scope of the nested model that a name begins with, and the rest of the name."""
        parts = name.split(_SEPARATOR)
        # Until SDF 1.7 names of flattened models contain the separator.
        for count in range(len(parts) - 1, 0, -1):
            head = self.frames.get(_SEPARATOR.join(parts[:count]))
            if head is not None and head.inner is not None:
                return head, head.inner, _SEPARATOR.join(parts[count:])
        return None

    # Attachment

    def link_of(self, name: str, seen: frozenset[Frame | Scope] = frozenset()) -> tuple[Scope, Element] | None:
        """Returns the link that a frame is attached to, with its scope; None if there is none.

        Args:
            name: name of the frame.
            seen: frames and models that are attached to it, to find cycles.
        """
        if name in ("", MODEL):
            return self.link_of(self.model_frame, seen) if self.model_frame else self.canonical_link(seen)
        frame = self.frames.get(name)
        if frame is None:
            nested = self._nested(name)
            return None if nested is None else nested[1].link_of(nested[2], seen)
        if frame in seen:
            return None
        if frame.element.tag == "link":
            return frame.scope, frame.element
        if frame.inner is not None:
            return frame.inner.canonical_link(seen | {frame})
        after = text_of(frame.element, "child") if frame.element.tag == "joint" else frame.element.get("attached_to", "").strip()
        return frame.scope.link_of(after, seen | {frame})

    def canonical_link(self, seen: frozenset[Frame | Scope] = frozenset()) -> tuple[Scope, Element] | None:
        """Returns the link that the model's frame is attached to: the named one, else the first of its own, else that of the first nested model."""
        named = self.element.get("canonical_link", "").strip()
        if self in seen:
            return None
        if named:
            return self.link_of(named, seen | {self})
        link = self.element.find("link")
        if link is not None:
            return self, link
        for frame in self.nested.values():
            found = None if frame.inner is None else frame.inner.canonical_link(seen | {self})
            if found is not None:
                return found
        return None


def reference_of(element: Element) -> str:
    """Returns the name of the frame that an element's <pose> is relative to, empty = the default one."""
    pose = element.find("pose")
    # The attribute was ``frame`` in SDF 1.5 and 1.6.
    return "" if pose is None else (pose.get("relative_to") or pose.get("frame") or "").strip()
