"""Measures the distance between the splats and the mesh of a scene: physics and depth use the mesh, colour images show the splats.

Writes the pose and scale of a scene's splats into its scene.yaml, and keeps all other lines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.errors import SceneError, TextError
from gibson_sim.formats.splats import Splats, load_splats
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.geometry.triangle_meshes import areas_of, spread_over, unit_normals
from gibson_sim.reading import parse_yaml, read_file
from gibson_sim.scenes.spec import SplatsSpec
from gibson_sim.writing import write_file
from gibson_sim_tools.importing.document import rpy_deg

F64 = NDArray[np.float64]
SOLID_OPACITY = 0.5
"""Opacity from which a splat is solid; fainter ones are haze and reflections."""
MAX_SPLAT_DISTANCE = 0.03
"""Median distance of splats from the mesh above which colour and depth images do not match, m."""
LARGE_SPLAT = 10.0
"""Standard deviation above which a splat is larger than a room, m."""
_MAX_SAMPLES = 20_000
"""Maximum number of splats measured."""
_SPACING = 0.02
"""Mean distance of the sample points on the mesh, m, if that is not too many points."""
_MAX_POINTS = 1_000_000
"""Maximum number of sample points on the mesh."""
_KEY = "visual"


@dataclass(frozen=True, slots=True)
class SplatDistance:
    """Distances of the splats of a scene from the nearest surface of its mesh, metres."""

    splats: int
    """Number of splats, solid or not."""
    degree: int
    """Degree of their spherical harmonics."""
    median: float
    """Median of the distances of the solid splats."""
    p90: float
    """90th percentile of the distances of the solid splats."""
    large: int = 0
    """Number of splats with a standard deviation above ``LARGE_SPLAT``."""
    largest: float = 0.0
    """Largest standard deviation."""
    without_rotation: int = 0
    """Number of splats whose quaternion in the file has length 0."""

    def text(self) -> str:
        """Returns the distances as text."""
        return (
            f"{self.splats:,} splats of degree {self.degree}: half of the solid ones are within {100.0 * self.median:.1f} cm of the mesh, "
            f"nine tenths within {100.0 * self.p90:.1f} cm"
        )


class Surface:
    """Surface of a mesh, sampled as points with normals.

    Args:
        corners: corners of its triangles, (F, 3, 3), metres; their total area must not be 0.
        rng: samples the points.
        max_points: maximum number of points.
    """

    def __init__(self, corners: F64, rng: np.random.Generator, max_points: int = _MAX_POINTS) -> None:
        area = float(areas_of(corners).sum())
        self.points, triangle_of_point = spread_over(corners, min(round(area / _SPACING**2) + 1000, max_points), rng)
        """Sample points, (N, 3), m."""
        self.normals: F64 = unit_normals(corners)[triangle_of_point]
        """Unit normals at the sample points, (N, 3)."""
        self._tree = cKDTree(self.points)
        # Around a sample point, up to the next one, the surface is nearer than the point itself: the distance to its plane counts.
        self._plane_within = 2.0 * (area / len(self.points)) ** 0.5

    def nearest(self, positions: F64) -> tuple[F64, NDArray[np.int64]]:
        """Returns the distances, (N,), m, of positions (N, 3) from the surface, and the indices, (N,), of the nearest sample points."""
        point_distances, nearest = self._tree.query(positions)
        plane_distances = np.abs(((positions - self.points[nearest]) * self.normals[nearest]).sum(axis=1))
        distances = np.where(
            np.sqrt(np.maximum(point_distances**2 - plane_distances**2, 0.0)) <= self._plane_within,
            plane_distances,
            point_distances,
        )
        return distances, np.asarray(nearest, dtype=np.int64)


def splat_distance(spec: SplatsSpec, corners: F64, rng: np.random.Generator) -> SplatDistance:
    """Measures the distance between the splats and the mesh of a scene; infinite without a mesh or without solid splats.

    Args:
        spec: the splats of the scene.
        corners: corners of all visual triangles, (F, 3, 3), world frame, metres.
        rng: samples splats and points on the mesh.

    Raises:
        MeshError: the file of the splats cannot be read.
    """
    splats = load_splats(Path(spec.file))
    positions = solid_positions(spec, splats)
    measured = (
        measure_distance(splats, sample_positions(positions, rng), Surface(corners, rng))
        if len(positions) and has_area(corners)
        else SplatDistance(len(splats), splats.degree, np.inf, np.inf)
    )
    sizes = spec.scale * splats.scales.max(axis=1)
    return replace(
        measured, large=int((sizes > LARGE_SPLAT).sum()), largest=float(sizes.max()), without_rotation=splats.without_rotation
    )


def sample_positions(positions: F64, rng: np.random.Generator) -> F64:
    """Returns a random sample of positions (N, 3), at most ``_MAX_SAMPLES``."""
    return positions[rng.choice(len(positions), _MAX_SAMPLES, replace=False)] if len(positions) > _MAX_SAMPLES else positions


def measure_distance(splats: Splats, positions: F64, surface: Surface) -> SplatDistance:
    """Measures the distance of splats from a surface. ``positions``: sample of the solid ones, (N, 3), m."""
    distances, _ = surface.nearest(positions)
    return SplatDistance(len(splats), splats.degree, float(np.median(distances)), float(np.quantile(distances, 0.9)))


def has_area(corners: F64) -> bool:
    """Returns whether the total area of triangles (F, 3, 3) is not 0."""
    return bool(len(corners) and areas_of(corners).sum() > 0.0)


def solid_positions(spec: SplatsSpec, splats: Splats) -> F64:
    """Returns the centres of the solid splats, (N, 3), world frame, m."""
    T_world_file = matrix_from_pose(spec.pose)
    T_world_file[:3, :3] *= spec.scale
    return np.asarray(transform_points(T_world_file, splats.positions[splats.opacities >= SOLID_OPACITY].astype(np.float64)))


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
