"""The JSON schema of scenario files, for editors that complete and check YAML. ``config/trial.schema.json`` holds it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gibson_sim.trials.scenario.keys import SCENARIO
from gibson_sim.writing import write_file

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def schema() -> dict[str, Any]:
    """Returns the schema."""
    return {
        "$schema": DRAFT,
        "title": "Scenario file of gibson-sim trial",
        "description": "See docs/trial_file.md.",
        **SCENARIO.schema(),
    }


def schema_text() -> str:
    """Returns the schema as the text of a file."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def write_schema(path: Path) -> None:
    """Writes the schema to a file.

    Raises:
        WriteError: the file cannot be written.
    """
    write_file(path, schema_text())
