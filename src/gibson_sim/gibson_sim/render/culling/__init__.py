"""What a picture leaves out: frustum, occlusion and back-face culling, and the plan of the draws that remain."""
