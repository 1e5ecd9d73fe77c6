"""Transforms, projections, triangles and grids. Imports ``types`` and nothing above it."""
