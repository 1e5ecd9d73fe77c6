"""Tells scans, whose floors are bumpy and whose triangles are many, from meshes that somebody modelled."""

from __future__ import annotations

import numpy as np

from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.triangle_meshes import components, weld

SCAN_FROM = 20_000
"""A mesh of so many triangles, most of which hang together, is taken for a scan."""
SCAN_SHARE = 0.5
"""Of the triangles that hang together."""


def is_scan(mesh: Mesh) -> bool:
    """Returns whether a mesh looks like a scan."""
    if mesh.triangle_count < SCAN_FROM:
        return False
    vertices, triangles = weld(*mesh.merged())
    sizes = np.bincount(components(triangles, len(vertices)), minlength=1)
    return bool(sizes.max() > SCAN_SHARE * mesh.triangle_count)
