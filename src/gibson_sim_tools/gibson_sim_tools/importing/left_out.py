"""Reads and writes ``left_out.yaml``: items of the source that an import could not use; ``check`` repeats them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import yaml

from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.errors import SceneError, TextError
from gibson_sim.quoting import clipped
from gibson_sim.reading import is_file, read_yaml_file

LEFT_OUT = "left_out.yaml"
"""File beside the scene.yaml."""
_MAX_LENGTH = 1000
"""Length limit of a line, characters."""
_HEADER = (
    "# Items of the source that could not be used. `gibson-sim scene check` repeats them; delete those that you have fixed.\n"
)


def left_out_text(lines: Iterable[str]) -> str:
    """Returns the text of the file for these lines; empty without lines."""
    entries = [{"kind": kind_of(line).name.lower(), "text": str(line)} for line in dict.fromkeys(lines)]
    return _HEADER + yaml.safe_dump(entries, sort_keys=False, allow_unicode=True, width=10_000) if entries else ""


def read_left_out(folder: Path) -> Sequence[Omission]:
    """Returns the omissions that an import listed in the folder of a scene; empty without the file.

    Raises:
        SceneError: the file cannot be read.
    """
    path = folder / LEFT_OUT
    if not is_file(path):
        return ()
    try:
        entries = read_yaml_file(path)
    except (OSError, TextError) as error:
        raise SceneError(f"{path}: {error}") from error
    kinds = {kind.name.lower(): kind for kind in OmissionKind}
    lines = []
    for entry in entries if isinstance(entries, list) else [entries]:
        if not isinstance(entry, dict) or not isinstance(entry.get("text"), str) or entry.get("kind") not in kinds:
            raise SceneError(
                f"{path}: must be a list of {{kind: .., text: ..}}, kind one of {', '.join(kinds)}; correct it, or delete it"
            )
        lines.append(Omission(clipped(entry["text"], _MAX_LENGTH), kinds[entry["kind"]]))
    return tuple(lines)
