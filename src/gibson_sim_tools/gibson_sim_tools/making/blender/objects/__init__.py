"""Models the meshes of the built-in objects: ``python -m gibson_sim_tools.making.blender.objects``, in a Python with Blender (``bpy``)."""

# Imported first: it makes ``bmesh`` and ``mathutils`` importable.
import bpy as bpy
