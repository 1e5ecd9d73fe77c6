"""``python -m gibson_sim_tools.making.blender.objects PICTURES OUTPUT NAME...``: writes ``OUTPUT/<name>/<mesh>.glb``.

Prints one line of JSON for each mesh.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from gibson_sim_tools.making.blender.objects import cabinets, doors, things, vessels
from gibson_sim_tools.making.blender.objects.workshop import LinkModel, Workshop
from gibson_sim_tools.making.objects.catalogue import OBJECTS
from gibson_sim_tools.making.objects.urdf import mesh_name


def _makers(name: str) -> Mapping[str, Callable[[LinkModel], None]]:
    """Returns the modelling function of each link of an object."""
    joined = {**doors.MAKERS, **cabinets.MAKERS}
    if name in joined:
        return joined[name]
    return {"body": {**vessels.MAKERS, **things.MAKERS}[name]}


def main() -> None:
    """Models the objects named on the command line."""
    pictures, output, *names = sys.argv[1:]
    workshop = Workshop(Path(pictures))
    for name in names:
        model, makers = OBJECTS[name], _makers(name)
        written_paths = set()
        for link in model.links:
            path = Path(output) / name / mesh_name(model, link)
            if not link.visual or path in written_paths:
                continue
            written_paths.add(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            workshop.clear()
            part = LinkModel(workshop)
            makers[link.name](part)
            print(json.dumps({"object": name, "file": path.name, "triangles": part.write(path)}), flush=True)


if __name__ == "__main__":
    main()
