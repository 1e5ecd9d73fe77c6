"""Texturing pipeline: from a mesh and posed photographs to a texture atlas, vertex colours where no photograph shows it, and a report.

The report holds corrections of the poses, outliers, patches, and steps across seams. Vertex colours of unseen triangles are interpolated
harmonically (Laplace) over the mesh; the mesh's own colours serve as a guide if it has any.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim_tools.scanning.posed_images import Photographs, ScanError
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing import atlas as atlases
from gibson_sim_tools.texturing.exposure import Exposures, estimate_exposures, identity_exposures
from gibson_sim_tools.texturing.labelling import (
    Candidates,
    best_labels,
    connected_patches,
    label_candidates,
    optimise_labels,
    quality_loss,
)
from gibson_sim_tools.texturing.levelling import (
    colors_along_seams,
    find_seams,
    global_levelling,
    local_levelling,
    mean_color_step,
    mean_edge_color_step,
)
from gibson_sim_tools.texturing.linear_solvers import conjugate_gradients
from gibson_sim_tools.texturing.outliers import inlier_mask, propagate_to_neighbours
from gibson_sim_tools.texturing.pose_refinement import refine_poses
from gibson_sim_tools.texturing.quality import Views, concatenate_views, face_views, normalised_radius, sample_bilinear
from gibson_sim_tools.texturing.settings import TextureSettings
from gibson_sim_tools.texturing.surface import Adjacency, face_adjacency, project, split_long_edges
from gibson_sim_tools.texturing.visibility import depth_consistent, visible_faces

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
Progress = Callable[[float], None]
Bools = NDArray[np.bool_]
_GREY = 0.5
"""Colour of components without any known vertex, sRGB, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class TexturedSurface:
    """A surface with its texture atlas."""

    surface: TriangleMesh
    labels: I32
    """(F,), photograph of each triangle, -1 = unseen."""
    atlas: atlases.Atlas
    pages: tuple[NDArray[np.uint8], ...]
    """(H, W, 3) each, sRGB."""
    vertex_colors: NDArray[np.uint8]
    """(V, 3), sRGB, for unseen triangles."""
    photographs: Photographs
    """At their refined poses."""
    exposures: Exposures
    report: TextureReport


def texture_surface(
    surface: TriangleMesh,
    photographs: Photographs,
    settings: TextureSettings,
    progress: Progress = lambda _: None,
    *,
    held_out: Sequence[int] = (),
) -> TexturedSurface:
    """Returns a surface with a texture; its long edges are split.

    Args:
        surface: in the world frame of the photographs.
        photographs: posed photographs.
        settings: settings of texturing.
        progress: called with the fraction that is done, 0 to 1.
        held_out: numbers of photographs that are calibrated and posed with the others, but do not texture.

    Raises:
        ScanError: a photograph cannot be read, or none shows the surface.
    """
    surface = split_long_edges(surface, settings.longest_edge)
    report = TextureReport(triangles=len(surface.triangles), photographs=len(photographs))
    views = collect_views(surface, photographs, lambda fraction: progress(0.2 * fraction))
    if not len(views):
        raise ScanError(
            f"{photographs.folder}: no photograph shows a triangle of the mesh; are the poses and the mesh of the same frame, in metres?"
        )
    exposures = _estimate_exposures(views, photographs, settings)
    if settings.poses:
        photographs = _refine_poses(
            surface, photographs, views, exposures, settings, report, lambda fraction: progress(0.2 + 0.2 * fraction)
        )
        views = collect_views(surface, photographs, lambda fraction: progress(0.4 + 0.2 * fraction))
        exposures = _estimate_exposures(views, photographs, settings)
    views = views.subset(~np.isin(views.photograph, list(held_out)))
    views = exposure_corrected(views, exposures)
    report.views = len(views)
    adjacency = face_adjacency(surface.triangles)
    if settings.outliers:
        is_inlier = propagate_to_neighbours(views, inlier_mask(views, views.srgb), adjacency)
        report.outliers = int((~is_inlier).sum())
        views = views.subset(is_inlier)
    progress(0.65)
    candidates = label_candidates(views, len(surface.triangles))
    labels = optimise_labels(candidates, adjacency, settings.smoothness) if settings.smoothness else best_labels(candidates)
    _report_labels(report, labels, candidates, adjacency)
    progress(0.7)
    return build_texture(
        surface, photographs, labels, exposures, adjacency, settings, report, lambda fraction: progress(0.7 + 0.3 * fraction)
    )


def _estimate_exposures(views: Views, photographs: Photographs, settings: TextureSettings) -> Exposures:
    if not settings.exposures:
        return identity_exposures(len(photographs))
    return estimate_exposures(views, len(photographs), np.random.default_rng(0))


def _refine_poses(
    surface: TriangleMesh, photographs: Photographs, views: Views, exposures: Exposures, settings: TextureSettings, report: TextureReport,
    progress: Progress,
) -> Photographs:  # fmt: skip
    """Returns the photographs at refined poses, and reports the corrections."""
    refined = refine_poses(
        surface,
        photographs,
        views,
        exposures,
        max_translation_m=settings.most_shift,
        max_rotation_deg=settings.most_turn_deg,
        progress=progress,
    )
    report.moved_mm = 1000.0 * float(np.median(refined.translation_m))
    report.turned_deg = float(np.median(refined.rotation_deg))
    report.kept_poses = refined.rejected_count
    return photographs.with_poses(refined.poses)


def collect_views(surface: TriangleMesh, photographs: Photographs, progress: Progress = lambda _: None) -> Views:
    """Returns the views of all photographs, without triangles whose depth in the photograph's depth image, if any, is inconsistent."""
    parts = []
    for number, item in enumerate(photographs.items):
        visible = visible_faces(surface, photographs.intrinsics(number), item.T_world_camera)
        depth = photographs.depth(number)
        if depth is not None:
            visible = depth_consistent(surface, visible, depth, item.T_world_camera)
        parts.append(face_views(number, visible, photographs.image(number)))
        progress((number + 1) / len(photographs))
    return concatenate_views(parts)


def exposure_corrected(views: Views, exposures: Exposures) -> Views:
    """Returns views with colours at the mean exposure and without vignetting."""
    return Views(
        views.face,
        views.photograph,
        views.quality,
        views.linear_rgb * exposures.factors(views.photograph, views.radius),
        views.radius,
    )


def build_texture(
    surface: TriangleMesh, photographs: Photographs, labels: I32, exposures: Exposures, adjacency: Adjacency, settings: TextureSettings,
    report: TextureReport, progress: Progress = lambda _: None,
) -> TexturedSurface:  # fmt: skip
    """Returns the textured surface of given labels (F,): atlas, seam levelling, colours of unseen triangles.

    Args:
        surface: mesh of F triangles, world frame.
        photographs: at their refined poses.
        labels: (F,), photograph of each triangle, -1 = unseen.
        exposures: calibration of the photographs.
        adjacency: face adjacency of the surface.
        settings: settings of texturing.
        report: filled in.
        progress: called with the fraction that is done, 0 to 1.
    """
    corners = np.zeros((len(labels), 3, 2))
    for number, item in enumerate(photographs.items):
        faces = np.flatnonzero(labels == number)
        points = surface.vertices[surface.triangles[faces]].reshape(-1, 3)
        corners[faces] = project(points, photographs.intrinsics(number), item.T_world_camera)[0].reshape(-1, 3, 2)
    atlas = atlases.build_atlas(connected_patches(labels, adjacency), labels, corners, settings.largest_page)
    pages = atlases.blank_pages(atlas)
    for number in np.unique(atlas.photograph).tolist():
        radius = normalised_radius(photographs.intrinsics(number))
        atlases.copy_patches(atlas, number, exposures.corrected(number, photographs.image(number), radius), pages)
        progress(0.4 * (number + 1) / len(photographs))
    face_maps = atlases.face_index_pages(atlas)
    seams = find_seams(atlas, surface.triangles, adjacency)
    report.seam_edges = len(seams.rows)
    colors = colors_along_seams(seams, atlas, pages)
    report.add_steps("before", colors)
    if settings.levelling != "none":
        atlases.add_vertex_offsets(atlas, pages, face_maps, global_levelling(atlas, surface.triangles, seams, colors))
        report.add_steps("global", colors_along_seams(seams, atlas, pages))
    progress(0.6)
    if settings.levelling == "both":
        local_levelling(seams, atlas, pages, face_maps)
        report.add_steps("local", colors_along_seams(seams, atlas, pages))
    progress(0.9)
    atlases.fill_padding(atlas, pages, face_maps)
    report.page_sizes = atlas.pages
    vertex_colors = _vertex_colors(surface, atlas, pages)
    pages_8bit = tuple(np.rint(np.clip(page.astype(np.float32), 0.0, 1.0) * 255.0).astype(np.uint8) for page in pages)
    progress(1.0)
    return TexturedSurface(surface, labels, atlas, pages_8bit, vertex_colors, photographs, exposures, report)


def _vertex_colors(surface: TriangleMesh, atlas: atlases.Atlas, pages: list[F16]) -> NDArray[np.uint8]:
    """Returns the vertex colours (V, 3), sRGB: mean of the texture at textured vertices, interpolated at the others."""
    count = len(surface.vertices)
    color_sums, counts = np.zeros((count, 3)), np.zeros(count)
    vertices = surface.triangles[atlas.faces]
    page_of = atlas.page[atlas.patch]
    for k, page in enumerate(pages):
        on_page = page_of == k
        colors = sample_bilinear(page.astype(np.float32), atlas.corners[on_page].astype(np.float32)).reshape(-1, 3)
        corner_vertices = vertices[on_page].ravel()
        color_sums += np.stack([np.bincount(corner_vertices, colors[:, c], count) for c in range(3)], axis=1)
        counts += np.bincount(corner_vertices, minlength=count)
    is_known = counts > 0
    prior_colors = None if surface.colors is None else (surface.colors / 255.0).astype(np.float32)
    filled = interpolate_vertex_colors(
        surface.triangles, is_known, (color_sums / np.maximum(counts, 1)[:, None]).astype(np.float32), prior_colors
    )
    return np.asarray(np.rint(filled * 255.0), dtype=np.uint8)


def _report_labels(report: TextureReport, labels: I32, candidates: Candidates, adjacency: Adjacency) -> None:
    report.unseen = int((labels < 0).sum())
    report.patches = int(connected_patches(labels, adjacency).max(initial=-1)) + 1
    report.best_patches = int(connected_patches(best_labels(candidates), adjacency).max(initial=-1)) + 1
    report.quality_loss = quality_loss(labels, candidates)


@dataclass(slots=True)
class TextureReport:
    """Report of texturing. The names of the fields are keys of its JSON."""

    triangles: int = 0
    photographs: int = 0
    views: int = 0
    moved_mm: float = 0.0
    """Median correction of the positions, millimetres."""
    turned_deg: float = 0.0
    """Median correction of the orientations, degrees."""
    kept_poses: int = 0
    """Number of photographs whose correction exceeded the limits and was rejected."""
    outliers: int = 0
    """Number of rejected views."""
    unseen: int = 0
    """Number of triangles that no photograph shows."""
    patches: int = 0
    best_patches: int = 0
    """Number of patches if each triangle had its view of highest quality."""
    quality_loss: float = 0.0
    """Quality lost against the best views, as a fraction."""
    seam_edges: int = 0
    seam_steps: dict[str, float] = field(default_factory=dict)
    """Mean colour step across seams, 8-bit steps, by stage of levelling: ``before``, ``global``, ``local``."""
    edge_steps: dict[str, float] = field(default_factory=dict)
    """Mean step of the mean colours of each seam edge, without noise and fine detail, by the same stages."""
    page_sizes: tuple[tuple[int, int], ...] = ()
    """Width and height of each page, pixels."""

    def add_steps(self, name: str, colors: NDArray[np.float32]) -> None:
        """Records the colour steps after a stage of levelling, from the colours of both sides of the seams, (S, 2, T, 3)."""
        self.seam_steps[name], self.edge_steps[name] = mean_color_step(colors), mean_edge_color_step(colors)

    def lines(self) -> list[str]:
        """Returns the report as text, one line per stage."""
        share = 100.0 * self.unseen / max(self.triangles, 1)
        steps = ", ".join(f"{value:.2f} {name}" for name, value in self.seam_steps.items())
        edges = ", ".join(f"{value:.2f} {name}" for name, value in self.edge_steps.items())
        pages = ", ".join(f"{w}x{h}" for w, h in self.page_sizes)
        poses = (
            f"poses: median correction {self.moved_mm:.1f} mm, {self.turned_deg:.2f} degrees; {self.kept_poses} beyond the limits"
        )
        return [
            poses,
            f"{self.triangles} triangles in {self.photographs} photographs: {self.views} views, {self.outliers} of them outliers; "
            f"no photograph shows {share:.1f} % of the triangles",
            f"{self.patches} patches ({self.best_patches} if each triangle had its best photograph) for {100.0 * self.quality_loss:.1f} % of "
            f"the quality; textures {pages}",
            f"{self.seam_edges} seam edges; mean step over them, of 255: {steps}; of the means of edges: {edges}",
        ]

    def as_dict(self) -> dict[str, Any]:
        """Returns the report as plain values for JSON."""
        return asdict(self)


def interpolate_vertex_colors(triangles: I64, known: Bools, colors: F32, prior_colors: F32 | None) -> F32:
    """Returns the colours of all vertices, (V, 3) float32, sRGB, 0 to 1: the known ones, and harmonic interpolation between them.

    Args:
        triangles: (F, 3), vertex indices.
        known: (V,), mask of the vertices with a known colour.
        colors: (V, 3), colours of the known vertices, sRGB, 0 to 1.
        prior_colors: (V, 3), the mesh's own colours, sRGB, 0 to 1; then the difference to them is interpolated. None = there are none.
    """
    count = len(known)
    base = np.zeros((count, 3)) if prior_colors is None else prior_colors.astype(np.float64)
    difference = np.where(known[:, None], colors - base, 0.0 if prior_colors is not None else _GREY)
    is_unknown = ~known
    if is_unknown.any() and known.any():
        edges = np.unique(
            np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1), axis=0
        )
        ones = np.ones(len(edges))
        graph = sparse.csr_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(count, count))
        graph = graph + graph.T
        degree = np.asarray(graph.sum(axis=1)).ravel()
        # The small diagonal term keeps components without any known vertex at their initial values.
        matrix = (sparse.diags(degree + 1e-6) - graph).tocsr()[is_unknown]
        interior = matrix[:, is_unknown].tocsr()
        initial = difference[is_unknown]
        rhs = -(matrix[:, known] @ difference[known]) + 1e-6 * initial
        difference[is_unknown] = conjugate_gradients(interior, rhs, start=initial, max_iterations=1000)
    return np.asarray(np.clip(base + difference, 0.0, 1.0), dtype=np.float32)
