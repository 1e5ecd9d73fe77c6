"""View-frustum, occlusion and back-face culling of a picture, and the plan of its remaining draws."""
