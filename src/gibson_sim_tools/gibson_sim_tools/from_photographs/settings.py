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
        "The colours of every so many-th photograph are not used, but compared with the simulation; 0 = all are used",
        minimum=0,
        maximum=10_000,
    )
    hold_out_depth: bool = setting(
        False, "Fuse no depth of these photographs either: a strict comparison, but the scene lacks what they alone show"
    )
    voxel: float = setting(
        0.0, "Edge of a voxel of the fusion; 0 = as fine as the cameras resolve", unit="m", minimum=0.0, maximum=0.5
    )
    depth_max: float = setting(4.0, "Farther depths are not fused", unit="m", minimum=0.1, maximum=1000.0)
    snap: float = setting(
        0.02,
        "Largest displacement of vertices of walls, floors and ceilings onto their plane; 0 = all stay",
        unit="m",
        minimum=0.0,
        maximum=0.1,
    )
    triangles: int = setting(300_000, "Most triangles of the mesh; 0 = keep all", minimum=0, maximum=100_000_000)
    longest_side: int = setting(2000, "Longer photographs are reduced to this", unit="px", minimum=64, maximum=16384)
    fill: str = setting(
        "",
        "Compare the held-out photographs also with images whose holes are filled: push_pull, learned, or an ONNX file; empty = do not",
    )
    close_floor: bool = setting(True, "Close the floor where no image shows it, with grey boards, so that robots do not fall")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.hold_out == 1:
            raise ConfigError("setting 'hold_out' is 1, must be 0, or 2 or more, so that photographs are left")
        if self.fill and not self.hold_out:
            raise ConfigError(
                f"setting 'fill' is {quoted(self.fill)}, for the comparison with held-out photographs, and 'hold_out' is 0: none is; give "
                "'hold_out' 2 or more, or leave out 'fill'"
            )
        if self.hold_out_depth and not self.hold_out:
            raise ConfigError(
                "setting 'hold_out_depth' leaves out the depth of photographs that are kept aside, and 'hold_out' is 0: none is; "
                "give 'hold_out' 2 or more, or leave out 'hold_out_depth'"
            )
