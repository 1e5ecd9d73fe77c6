"""Reproducible measurements of Gibson Sim: ``gibson-sim bench``."""

__version__ = "0.1.0"
