// Common part of the compute passes that fill holes on the GPU; see filling/gpu_filling.py. Two-dimensional, one invocation per pixel.
// The canvas is the image; in a panorama, with half a turn more at its left and its right edge.
layout(local_size_x = 8, local_size_y = 8) in;

uniform ivec4 u_rect;  // x, y, width, height of the image in the target
uniform int u_turn;    // columns that the canvas has more than the image, at each edge

layout(std430, binding = 0) buffer Codes { uint codes[]; };        // of the canvas: a constant below
layout(std430, binding = 1) buffer Pyramid { vec4 pyramid[]; };    // all levels of the canvas, the finest first: values times weight, weight

// See filling/holes.py.
const uint SURFACE = 0u, NOTHING = 1u, BACK_FACE = 2u, UNSEEN = 3u, OUTSIDE = 4u, MOVING = 5u;

// Alpha of normals below which a surface shows its back, or belongs to a moving link: see readback/frames.py.
const uint BACK_BELOW = 49152u, MOVING_BELOW = 61440u;

// Code of a pixel by its stored normal; UNSEEN also outside the field of view of a lens.
uint code_of(uvec4 normal) {
    if (normal.a == 0u) return normal.r == 0u ? NOTHING : UNSEEN;
    return normal.a < BACK_BELOW ? BACK_FACE : normal.a < MOVING_BELOW ? MOVING : SURFACE;
}

bool is_hole(uint code) { return code == NOTHING || code == BACK_FACE; }

// Whether a pixel is a hole to a network: moving links are, too, and what is outside the lens.
bool is_hole_to_network(uint code) { return is_hole(code) || code == OUTSIDE || code == MOVING; }

// GLSL lets isnan() and isinf() be false for all values.
bool is_finite(float value) { return (floatBitsToUint(value) & 0x7F800000u) != 0x7F800000u; }

ivec2 canvas() { return ivec2(u_rect.z + 2 * u_turn, u_rect.w); }

ivec2 here() { return ivec2(gl_GlobalInvocationID.xy); }

bool is_within(ivec2 size) { return all(lessThan(here(), size)); }

int canvas_index(ivec2 pixel) { return pixel.y * canvas().x + pixel.x; }

// Texel of the target at a pixel of the canvas.
ivec2 texel(ivec2 pixel) {
    int column = (pixel.x - u_turn + u_rect.z) % u_rect.z;
    return u_rect.xy + ivec2(column, pixel.y);
}
