"""Links whose meshes are missing: their remaining shapes are drawn."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.description.urdf import parse_urdf

GONE = '<visual><geometry><mesh filename="gone.dae"/></geometry></visual>'
BOX = '<collision><origin xyz="0 0 1"/><geometry><box size="1 2 3"/></geometry></collision>'
BALL = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'


def test_collision_shapes_are_drawn_where_all_visuals_are_missing() -> None:
    def drawn(inner: str) -> tuple[list[str], tuple[str, ...]]:
        model = parse_urdf(f'<robot name="r"><link name="a">{inner}</link></robot>', Path("r.urdf"))
        return [visual.shape.kind for visual in model.links[0].visuals], model.warnings

    kinds, warnings = drawn(GONE + BOX)
    assert kinds == ["box"]
    assert warnings == (
        "r.urdf: link 'a': visual: mesh gone.dae does not exist; left out",
        "r.urdf: link 'a': its collision shapes are drawn, since it has no usable visual",
    )
    assert drawn(GONE + BALL + BOX)[0] == ["sphere"]
    assert drawn(BOX) == ([], ()), "a link that is not drawn stays so"
    assert drawn(GONE) == ([], ("r.urdf: link 'a': visual: mesh gone.dae does not exist; left out",))
