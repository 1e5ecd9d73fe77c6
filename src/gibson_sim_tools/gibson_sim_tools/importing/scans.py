"""Distinguishes scans, with uneven floors and many triangles, from modelled meshes."""

from __future__ import annotations

import numpy as np

from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.triangle_meshes import components, weld

MIN_SCAN_TRIANGLES = 20_000
"""Minimum number of triangles of a scan."""
MIN_SCAN_SHARE = 0.5
"""Minimum fraction of a scan's triangles in its largest connected component."""


def is_scan(mesh: Mesh) -> bool:
    """Returns whether a mesh is probably a scan: many triangles, most of them connected."""
    if mesh.triangle_count < MIN_SCAN_TRIANGLES:
        return False
    vertices, triangles = weld(*mesh.merged())
    sizes = np.bincount(components(triangles, len(vertices)), minlength=1)
    return bool(sizes.max() > MIN_SCAN_SHARE * mesh.triangle_count)
