"""Measurements of Gibson Sim that anyone can repeat: ``gibson-sim bench``."""

__version__ = "0.1.0"
