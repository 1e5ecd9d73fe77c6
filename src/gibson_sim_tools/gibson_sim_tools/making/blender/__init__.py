"""Turns the plan of a building into triangles with textures, their light baked in. Runs in a Python that has Blender (``bpy``), in a process of
its own.

``shapes``, ``furniture``, ``shell`` and ``charts`` need NumPy alone; ``materials`` and ``bake`` alone import ``bpy``.
"""
