"""Scenes and meshes that are measured."""
