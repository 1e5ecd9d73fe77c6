"""Generates procedural scenes: ``python -m gibson_sim_tools.generator flat scenes/flat``.

Everything comes from a seed: the same seed gives the same files, byte for byte. Pure numpy and OpenCV.
"""
