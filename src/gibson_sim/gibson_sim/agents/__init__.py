"""Coding agents: a server of the Model Context Protocol (MCP) whose tools start, drive, look into and stop a simulation.

``python -m gibson_sim.agents`` serves on stdin and stdout. ``tools`` declares the tools and checks their arguments, ``folders`` says which files
may be used, ``pictures`` makes PNGs, ``session`` executes the tools by a ``testing.HeadlessSimulation``, and ``server``, the only module that
imports the MCP SDK, carries their results to the agent.
"""
