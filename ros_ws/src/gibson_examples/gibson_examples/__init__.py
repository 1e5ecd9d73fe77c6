"""Examples that use Gibson Sim like any robot, through standard topics alone. Imports nothing of ``gibson_sim``."""

__version__ = "0.1.0"
