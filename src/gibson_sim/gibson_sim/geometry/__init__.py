"""Transforms, projections, triangles and grids. Knows ``types`` and nothing above."""
