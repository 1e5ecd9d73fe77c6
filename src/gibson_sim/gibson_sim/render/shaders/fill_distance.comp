// Distance of each pixel of the canvas from the nearest hole of its row, pixels; FAR if there is none within reach.
layout(std430, binding = 5) writeonly buffer Distances { float distances[]; };

uniform int u_fade_limit_px;

const float FAR = 1e6;

void main() {
    if (!is_within(canvas())) return;
    ivec2 pixel = here();
    float nearest = FAR;
    for (int d = 0; d <= u_fade_limit_px && nearest == FAR; ++d) {
        int left = pixel.x - d, right = pixel.x + d;
        bool is_near = left >= 0 && is_hole(codes[canvas_index(ivec2(left, pixel.y))]);
        is_near = is_near || (right < canvas().x && is_hole(codes[canvas_index(ivec2(right, pixel.y))]));
        if (is_near) nearest = float(d);
    }
    distances[canvas_index(pixel)] = nearest;
}
