"""Transforms and projections. Knows types, nothing above."""
