"""Generates the meshes of ``arm_bot`` procedurally, without Blender, and renders robots."""
