"""Lists all built-in objects by name."""

from __future__ import annotations

from gibson_sim_tools.making.objects.joined import JOINED
from gibson_sim_tools.making.objects.loose import LOOSE
from gibson_sim_tools.making.objects.model import ObjectModel

OBJECTS: dict[str, ObjectModel] = {model.name: model for model in (*LOOSE, *JOINED)}
"""Objects by name, in the order of the table in docs/objects.md."""
