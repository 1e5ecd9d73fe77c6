"""Generates procedural scenes: ``python -m gibson_sim_tools.generator flat scenes/flat``.

Deterministic: the same seed gives identical files. Uses only NumPy and OpenCV.
"""
