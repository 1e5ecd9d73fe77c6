"""Textures a mesh from posed photographs: all steps, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.texturing import atlas as atlases
from gibson_sim_tools.texturing.exposure import Exposures, estimate_exposures, no_exposures
from gibson_sim_tools.texturing.filling import fill_vertices
from gibson_sim_tools.texturing.labelling import Candidates, best_labels, candidates_of, choose_labels, patches_of, quality_loss
from gibson_sim_tools.texturing.levelling import colors_along, find_seams, global_levelling, local_levelling
from gibson_sim_tools.texturing.outliers import inliers, judged_together
from gibson_sim_tools.texturing.pose_refinement import refine_poses
from gibson_sim_tools.texturing.quality import Views, intrinsics_radius, joined, sampled, views_of
from gibson_sim_tools.texturing.report import TextureReport
from gibson_sim_tools.texturing.settings import TextureSettings
from gibson_sim_tools.texturing.surface import Adjacency, Surface, adjacency, project, split_long_edges
from gibson_sim_tools.texturing.visibility import agreeing, seen_faces

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Textured:
    """A textured surface."""

    surface: Surface
    labels: I32
    """(F,), the photograph of each triangle, -1 = unseen."""
    atlas: atlases.Atlas
    pages: tuple[NDArray[np.uint8], ...]
    """(H, W, 3), sRGB."""
    vertex_colors: NDArray[np.uint8]
    """(V, 3), sRGB: for triangles that no photograph shows."""
    photographs: Photographs
    """At the poses that were found."""
    exposures: Exposures
    report: TextureReport


def texture(
    surface: Surface,
    photographs: Photographs,
    settings: TextureSettings,
    progress: Progress = lambda _: None,
    *,
    held_out: Sequence[int] = (),
) -> Textured:
    """Returns a surface with a texture.

    Args:
        surface: in the world frame of the photographs.
        photographs: posed.
        settings: settings.
        progress: called with the fraction that is done, 0 to 1.
        held_out: photographs whose poses are corrected with the others, and that are not used otherwise.

    Raises:
        ScanError: a photograph cannot be read, or none shows the surface.
    """
    surface = split_long_edges(surface, settings.longest_edge)
    report = TextureReport(triangles=len(surface.triangles), photographs=len(photographs))
    views = collect_views(surface, photographs, lambda part: progress(0.2 * part))
    if not len(views):
        raise ScanError(
            f"{photographs.folder}: no photograph shows a triangle of the mesh; are the poses and the mesh of the same frame, in metres?"
        )
    exposures = _exposures(views, photographs, settings)
    if settings.poses:
        photographs = _refined(surface, photographs, views, exposures, settings, report, lambda part: progress(0.2 + 0.2 * part))
        views = collect_views(surface, photographs, lambda part: progress(0.4 + 0.2 * part))
        exposures = _exposures(views, photographs, settings)
    views = views.subset(~np.isin(views.photograph, list(held_out)))
    views = corrected_views(views, exposures)
    report.views = len(views)
    beside = adjacency(surface.triangles)
    if settings.outliers:
        kept = judged_together(views, inliers(views, views.srgb), beside)
        report.outliers = int((~kept).sum())
        views = views.subset(kept)
    progress(0.65)
    candidates = candidates_of(views, len(surface.triangles))
    labels = choose_labels(candidates, beside, settings.smoothness) if settings.smoothness else best_labels(candidates)
    _report_labels(report, labels, candidates, beside)
    progress(0.7)
    return finish(surface, photographs, labels, exposures, beside, settings, report, lambda part: progress(0.7 + 0.3 * part))


def _exposures(views: Views, photographs: Photographs, settings: TextureSettings) -> Exposures:
    if not settings.exposures:
        return no_exposures(len(photographs))
    return estimate_exposures(views, len(photographs), np.random.default_rng(0))


def _refined(
    surface: Surface, photographs: Photographs, views: Views, exposures: Exposures, settings: TextureSettings, report: TextureReport,
    progress: Progress,
) -> Photographs:  # fmt: skip
    """Returns the photographs at corrected poses."""
    refined = refine_poses(
        surface, photographs, views, exposures, most_m=settings.most_shift, most_deg=settings.most_turn_deg, progress=progress
    )
    report.moved_mm = 1000.0 * float(np.median(refined.moved_m))
    report.turned_deg = float(np.median(refined.turned_deg))
    report.kept_poses = refined.kept
    return photographs.at(refined.poses)


def collect_views(surface: Surface, photographs: Photographs, progress: Progress = lambda _: None) -> Views:
    """Returns all triangles in all photographs. Where depth was measured that is not that of the surface, something else is seen."""
    parts = []
    for number, item in enumerate(photographs.items):
        seen = seen_faces(surface, photographs.intrinsics(number), item.T_world_camera)
        depth = photographs.depth(number)
        if depth is not None:
            seen = agreeing(surface, seen, depth, item.T_world_camera)
        parts.append(views_of(number, seen, photographs.picture(number)))
        progress((number + 1) / len(photographs))
    return joined(parts)


def corrected_views(views: Views, exposures: Exposures) -> Views:
    """Returns views with the light that the mean camera would have seen."""
    return Views(
        views.face, views.photograph, views.quality, views.light * exposures.factors(views.photograph, views.radius), views.radius
    )


def finish(
    surface: Surface, photographs: Photographs, labels: I32, exposures: Exposures, beside: Adjacency, settings: TextureSettings,
    report: TextureReport, progress: Progress = lambda _: None,
) -> Textured:  # fmt: skip
    """Returns the textured surface for given labels (F,)."""
    corners = np.zeros((len(labels), 3, 2))
    for number, item in enumerate(photographs.items):
        faces = np.flatnonzero(labels == number)
        points = surface.vertices[surface.triangles[faces]].reshape(-1, 3)
        corners[faces] = project(points, photographs.intrinsics(number), item.T_world_camera)[0].reshape(-1, 3, 2)
    plan = atlases.plan_atlas(patches_of(labels, beside), labels, corners, settings.largest_page)
    pages = atlases.blank_pages(plan)
    for number in np.unique(plan.photograph).tolist():
        radius = intrinsics_radius(photographs.intrinsics(number))
        atlases.copy_patches(plan, number, exposures.corrected(number, photographs.picture(number), radius), pages)
        progress(0.4 * (number + 1) / len(photographs))
    covers = atlases.face_pages(plan)
    seams = find_seams(plan, surface.triangles, beside)
    report.seam_edges = len(seams.rows)
    colors = colors_along(seams, plan, pages)
    report.add_steps("before", colors)
    if settings.levelling != "none":
        atlases.add_at_corners(plan, pages, covers, global_levelling(plan, surface.triangles, seams, colors))
        report.add_steps("global", colors_along(seams, plan, pages))
    progress(0.6)
    if settings.levelling == "both":
        local_levelling(seams, plan, pages, covers)
        report.add_steps("local", colors_along(seams, plan, pages))
    progress(0.9)
    atlases.fill_padding(plan, pages, covers)
    report.page_sizes = plan.pages
    vertex_colors = _vertex_colors(surface, plan, pages)
    eight = tuple(np.rint(np.clip(page.astype(np.float32), 0.0, 1.0) * 255.0).astype(np.uint8) for page in pages)
    progress(1.0)
    return Textured(surface, labels, plan, eight, vertex_colors, photographs, exposures, report)


def _vertex_colors(surface: Surface, plan: atlases.Atlas, pages: list[F16]) -> NDArray[np.uint8]:
    """Returns colours (V, 3) of the vertices: of the texture where there is one."""
    count = len(surface.vertices)
    total, number = np.zeros((count, 3)), np.zeros(count)
    vertices = surface.triangles[plan.faces]
    page_of = plan.page[plan.patch]
    for k, page in enumerate(pages):
        on = page_of == k
        colors = sampled(page.astype(np.float32), plan.corners[on].astype(np.float32)).reshape(-1, 3)
        flat = vertices[on].ravel()
        total += np.stack([np.bincount(flat, colors[:, c], count) for c in range(3)], axis=1)
        number += np.bincount(flat, minlength=count)
    known = number > 0
    own = None if surface.colors is None else (surface.colors / 255.0).astype(np.float32)
    filled = fill_vertices(surface.triangles, known, (total / np.maximum(number, 1)[:, None]).astype(np.float32), own)
    return np.asarray(np.rint(filled * 255.0), dtype=np.uint8)


def _report_labels(report: TextureReport, labels: I32, candidates: Candidates, beside: Adjacency) -> None:
    report.unseen = int((labels < 0).sum())
    report.patches = int(patches_of(labels, beside).max(initial=-1)) + 1
    report.best_patches = int(patches_of(best_labels(candidates), beside).max(initial=-1)) + 1
    report.quality_loss = quality_loss(labels, candidates)
