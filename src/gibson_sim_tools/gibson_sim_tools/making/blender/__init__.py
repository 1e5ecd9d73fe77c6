"""Converts the plan of a building to textured triangles with baked light. Runs in a separate process, in a Python interpreter with Blender
(``bpy``).

``shapes``, ``furniture``, ``shell`` and ``charts`` need only NumPy; ``materials``, ``nodes``, ``bake`` and ``mirrors`` are for Blender.
"""
