"""Converts the plan of a building to textured triangles with baked light, and traces pictures of scenes. Runs in a separate process, in a
Python interpreter with Blender (``bpy``).

``shapes``, ``furniture``, ``shell``, ``charts``, ``assembly``, ``appearances`` and ``exr`` need only NumPy; the other modules are for Blender.
"""
