"""Scenes of the benchmarks, and their meshes."""
