"""Distinguishes scans, which have bumpy floors and many triangles, from modelled meshes."""

from __future__ import annotations

import numpy as np

from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.triangle_meshes import components, weld

SCAN_FROM = 20_000
"""Least number of triangles of a scan, most of them connected."""
SCAN_SHARE = 0.5
"""Least fraction of a scan's triangles in its largest connected component."""


def is_scan(mesh: Mesh) -> bool:
    """Returns whether a mesh looks like a scan."""
    if mesh.triangle_count < SCAN_FROM:
        return False
    vertices, triangles = weld(*mesh.merged())
    sizes = np.bincount(components(triangles, len(vertices)), minlength=1)
    return bool(sizes.max() > SCAN_SHARE * mesh.triangle_count)
