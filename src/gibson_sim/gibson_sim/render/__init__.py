"""Draws a scene without a window: EGL contexts, GPU buffers, RGB and depth. The only package that speaks OpenGL."""
