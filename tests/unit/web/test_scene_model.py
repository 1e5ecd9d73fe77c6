"""The scene as the page renders it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.glb import GlbBuilder
from gibson_sim.formats.light_maps import light_map_png
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.web.scene_model import scene_model


def test_the_page_lights_surfaces_whose_light_map_it_does_not_draw(tmp_path: Path) -> None:
    shapes = []
    for name in ("unlit", "light_mapped"):
        builder = GlbBuilder()
        attributes = {
            "POSITION": builder.attribute([[0, 0, 0], [1, 0, 0], [0, 1, 0]], bounds=True),
            "TEXCOORD_1": builder.attribute([[0, 0], [1, 0], [0, 1]]),
        }
        if name == "unlit":
            material = builder.material({"extensions": {"KHR_materials_unlit": {}}})
        else:
            material = builder.light_mapped_material({}, builder.texture_data(light_map_png(np.ones((1, 1, 3)), 1.0)), 1.0)
        builder.primitive(attributes, builder.indices([[0, 1, 2]]), material)
        (tmp_path / f"{name}.glb").write_bytes(builder.to_bytes(name))
        shapes.append(Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / f"{name}.glb")))
    visuals = tuple(VisualSpec(str(k), "", shape) for k, shape in enumerate(shapes))
    batches = json.loads(scene_model(DrawnScene("test", 1, "", (), visuals, (), LightSpec())).description)["batches"]
    assert sorted(batch["unlit"] for batch in batches) == [False, True]
