"""Settings of an import from photographs."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import check_settings, setting


@dataclass(frozen=True, slots=True)
class PhotographSettings:
    """Settings of an import from photographs."""

    hold_out: int = setting(
        10,
        "Hold out every N-th photograph: its colours are not used, but compared with the re-rendered scene; 0 = use all",
        minimum=0,
        maximum=10_000,
    )
    hold_out_depth: bool = setting(
        False, "Hold out their depth, too: a strict comparison, but the scene lacks what only these photographs show"
    )
    voxel: float = setting(
        0.0, "Voxel size of the fusion; 0 = as fine as the cameras resolve", unit="m", minimum=0.0, maximum=0.5
    )
    depth_max: float = setting(4.0, "Largest depth that is fused", unit="m", minimum=0.1, maximum=1000.0)
    snap: float = setting(
        0.02,
        "Largest displacement of vertices snapped to the planes of walls, floors and ceilings; 0 = no snapping",
        unit="m",
        minimum=0.0,
        maximum=0.1,
    )
    triangles: int = setting(300_000, "Largest number of triangles of the mesh; 0 = keep all", minimum=0, maximum=100_000_000)
    longest_side: int = setting(
        2000, "Longest side of a photograph; larger ones are scaled down", unit="px", minimum=64, maximum=16384
    )
    fill: str = setting(
        "",
        "Compare the held-out photographs also with hole-filled images: push_pull, learned, or an ONNX file; empty = do not",
    )
    close_floor: bool = setting(True, "Fill unobserved floor with grey boards, so that robots do not fall through it")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.hold_out == 1:
            raise ConfigError("setting 'hold_out' is 1, must be 0, or 2 or more, so that some photographs are used")
        if self.fill and not self.hold_out:
            raise ConfigError(
                f"setting 'fill' is {quoted(self.fill)}, for the comparison with held-out photographs, but 'hold_out' is 0; give "
                "'hold_out' 2 or more, or leave out 'fill'"
            )
        if self.hold_out_depth and not self.hold_out:
            raise ConfigError(
                "setting 'hold_out_depth' holds out the depth of held-out photographs, but 'hold_out' is 0; "
                "give 'hold_out' 2 or more, or leave out 'hold_out_depth'"
            )
