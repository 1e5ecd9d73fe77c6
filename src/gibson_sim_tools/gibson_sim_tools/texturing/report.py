"""Report of texturing: corrections of the poses, outliers, patches, steps across seams."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.texturing.levelling import mean_color_step, mean_edge_color_step


@dataclass(slots=True)
class TextureReport:
    """Report of texturing. The names of the fields are keys of its JSON."""

    triangles: int = 0
    photographs: int = 0
    views: int = 0
    moved_mm: float = 0.0
    """Median correction of the positions, millimetres."""
    turned_deg: float = 0.0
    """Median correction of the orientations, degrees."""
    kept_poses: int = 0
    """Number of photographs whose correction exceeded the limits and was rejected."""
    outliers: int = 0
    """Number of rejected views."""
    unseen: int = 0
    """Number of triangles that no photograph shows."""
    patches: int = 0
    best_patches: int = 0
    """Number of patches if each triangle had its view of highest quality."""
    quality_loss: float = 0.0
    """Quality lost against the best views, as a fraction."""
    seam_edges: int = 0
    seam_steps: dict[str, float] = field(default_factory=dict)
    """Mean colour step across seams, 8-bit steps, by stage of levelling: ``before``, ``global``, ``local``."""
    edge_steps: dict[str, float] = field(default_factory=dict)
    """Mean step of the mean colours of each seam edge, without noise and fine detail, by the same stages."""
    page_sizes: tuple[tuple[int, int], ...] = ()
    """Width and height of each page, pixels."""

    def add_steps(self, name: str, colors: NDArray[np.float32]) -> None:
        """Records the colour steps after a stage of levelling, from the colours of both sides of the seams, (S, 2, T, 3)."""
        self.seam_steps[name], self.edge_steps[name] = mean_color_step(colors), mean_edge_color_step(colors)

    def lines(self) -> list[str]:
        """Returns the report as text, one line per stage."""
        share = 100.0 * self.unseen / max(self.triangles, 1)
        steps = ", ".join(f"{value:.2f} {name}" for name, value in self.seam_steps.items())
        edges = ", ".join(f"{value:.2f} {name}" for name, value in self.edge_steps.items())
        pages = ", ".join(f"{w}x{h}" for w, h in self.page_sizes)
        poses = (
            f"poses: median correction {self.moved_mm:.1f} mm, {self.turned_deg:.2f} degrees; {self.kept_poses} beyond the limits"
        )
        return [
            poses,
            f"{self.triangles} triangles in {self.photographs} photographs: {self.views} views, {self.outliers} of them outliers; "
            f"no photograph shows {share:.1f} % of the triangles",
            f"{self.patches} patches ({self.best_patches} if each triangle had its best photograph) for {100.0 * self.quality_loss:.1f} % of "
            f"the quality; textures {pages}",
            f"{self.seam_edges} seam edges; mean step over them, of 255: {steps}; of the means of edges: {edges}",
        ]

    def as_dict(self) -> dict[str, Any]:
        """Returns the report as plain values for JSON."""
        return asdict(self)
