"""Writes the pose and scale of a scene's splats into its scene.yaml, and keeps all other lines."""

from __future__ import annotations

from pathlib import Path

import yaml

from gibson_sim.errors import SceneError, TextError
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.reading import parse_yaml, read_file
from gibson_sim.scenes.spec import SplatsSpec
from gibson_sim.writing import write_file
from gibson_sim_tools.importing.document import rpy_deg

_KEY = "visual"


def visual_line(spec: SplatsSpec, name: str) -> str:
    """Returns the line of a scene.yaml for splats. ``name``: path of their file, relative to the scene.yaml."""
    visual = {
        "splats": name,
        "up_axis": "z",
        "pose": {"xyz": [round(c, 5) + 0.0 for c in spec.pose.position], "rpy_deg": rpy_deg(matrix_from_pose(spec.pose))},
        "scale": float(f"{spec.scale:.7g}"),
    }
    return (
        f"{_KEY}: {yaml.safe_dump(visual, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10_000)}".rstrip()
    )


def write_visual(file: Path, spec: SplatsSpec) -> str:
    """Writes the pose and the scale of splats into a scene.yaml with splats, and returns the new line.

    Raises:
        SceneError: the file cannot be read, or its layout does not allow replacing the old lines by one.
        WriteError: the file cannot be written.
    """
    try:
        text = read_file(file).decode("utf-8")
    except OSError as e:
        raise SceneError(f"{file}: cannot be read: {e.strerror or e}") from e
    original = parse_yaml(text)
    line = visual_line(spec, original[_KEY]["splats"])
    document = yaml.compose(text, yaml.SafeLoader)
    pairs: list[tuple[yaml.Node, yaml.Node]] = [] if document is None else document.value
    key, value = next(pair for pair in pairs if pair[0].value == _KEY)
    changed_text = text[: key.start_mark.index] + line + text[_end(value) :]
    try:
        is_equivalent = parse_yaml(changed_text) == {**original, **parse_yaml(line)}
    except TextError:
        is_equivalent = False
    if not is_equivalent:
        raise SceneError(f"{file}: `{_KEY}` has a layout that cannot be edited automatically; replace it by: {line}")
    write_file(file, changed_text)
    return line


def _end(node: yaml.Node) -> int:
    """Returns the index after the last character of a node; the end mark of a block mapping is the start of the next key."""
    if isinstance(node, yaml.MappingNode) and not node.flow_style:
        return _end(node.value[-1][1])
    if isinstance(node, yaml.SequenceNode) and not node.flow_style:
        return _end(node.value[-1])
    return int(node.end_mark.index)
