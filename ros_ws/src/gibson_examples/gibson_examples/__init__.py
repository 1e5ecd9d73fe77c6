"""Examples that use Gibson Sim as any robot: by standard topics alone. Imports nothing of ``gibson_sim``."""

__version__ = "0.1.0"
