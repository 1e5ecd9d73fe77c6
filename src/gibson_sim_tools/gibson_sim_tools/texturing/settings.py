"""Settings of texturing."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim.settings import check_settings, setting
from gibson_sim_tools.scanning.settings import CAMERA_CONVENTIONS

LARGEST_PAGE = 8192
"""Longest side of a texture that every GPU supports, pixels."""

POSE_CONVENTIONS = {
    **CAMERA_CONVENTIONS,
    "y-up": "of a world with y up, while the mesh is z up",
    "before-applied-transform": "of nerfstudio's world, while the mesh is in the one before its applied_transform",
}
"""Pose conventions: name -> meaning."""
MOST_PHOTOGRAPHS = 600
"""Default of the largest number of photographs; it bounds memory and time."""


@dataclass(frozen=True, slots=True)
class TextureSettings:
    """Settings of texturing."""

    smoothness: float = setting(
        0.3, "Cost of a seam edge, relative to at most 1 for a triangle that does not get its best photograph; 0 = each gets its best",
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    poses: bool = setting(True, "Refine the camera poses")
    most_shift: float = setting(
        0.03, "Largest correction of a position; larger ones are rejected", unit="m", minimum=0.0, maximum=1.0
    )
    most_turn_deg: float = setting(
        2.0, "Largest correction of an orientation; larger ones are rejected", unit="deg", minimum=0.0, maximum=45.0
    )
    exposures: bool = setting(True, "Estimate exposure, white balance and vignette")
    outliers: bool = setting(True, "Reject outlier views, which show something else than most views of a triangle")
    longest_side: int = setting(
        2000, "Longest side of a photograph; larger ones are scaled down", unit="px", minimum=64, maximum=16384
    )
    levelling: str = setting(
        "both", "Seam levelling: none, global, or both (global, then local)", choices=("none", "global", "both")
    )
    largest_page: int = setting(4096, "Longest side of a texture", unit="px", minimum=64, maximum=LARGEST_PAGE)
    longest_edge: float = setting(
        0.25,
        "Longest triangle edge; longer ones are split, since one photograph textures a triangle",
        unit="m",
        minimum=0.01,
        maximum=100.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)
