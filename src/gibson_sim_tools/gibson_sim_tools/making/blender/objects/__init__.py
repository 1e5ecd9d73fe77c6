"""Makes the meshes of our objects: ``python -m gibson_sim_tools.making.blender.objects``, in a Python that has Blender (``bpy``)."""

# Loaded first: it makes ``bmesh`` and ``mathutils`` known.
import bpy as bpy
