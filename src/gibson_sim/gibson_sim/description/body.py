"""``BodySpec``, a body other than a robot: a bottle, a chair, a cabinet with doors. Pure values."""

from __future__ import annotations

from dataclasses import dataclass, field

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.types import Pose


@dataclass(frozen=True, slots=True)
class BodySpec:
    """A rigid or articulated body that physics moves; the root of a static body is fixed."""

    name: str
    """Name, unique in the scene: its links are ``<name>/<link>``."""
    model: UrdfModel
    """Shapes, masses and joints."""
    start: Pose = field(default_factory=Pose)
    """T_world_root at load and after a reset."""
    static: bool = False
    """Whether its root is fixed; ``set_state`` can still move it."""
    semantic_class: str = ""
    """Semantic class of all its visuals; empty = unlabelled."""
    joints: tuple[tuple[str, float], ...] = ()
    """(Joint name, position) at load and after a reset, radians or metres; missing joints are at 0."""

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links, the root first, without the body name."""
        return tuple(link.name for link in self.model.links)

    @property
    def visuals(self) -> tuple[VisualSpec, ...]:
        """Its visuals."""
        return model_visuals(self.model, self.name, self.semantic_class)


def model_visuals(model: UrdfModel, name: str, semantic_class: str = "") -> tuple[VisualSpec, ...]:
    """Returns the visuals of a model of a body named ``name``."""
    return tuple(
        VisualSpec(f"{name}/{link.name}/{i}", f"{name}/{link.name}", visual.shape, visual.pose, visual.color, semantic_class)
        for link in model.links
        for i, visual in enumerate(link.visuals)
    )
