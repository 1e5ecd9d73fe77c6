// First pass: the code of each pixel of the canvas, and the finest level of the pyramid. See _fill() in filling/hole_filling.py.
layout(binding = 0) uniform usampler2D u_color;    // sRGB bytes, through a texture view
layout(binding = 1) uniform sampler2D u_depth;     // near / z, 0 = nothing
layout(binding = 2) uniform usampler2D u_normals;  // normalised 16-bit integers
layout(binding = 3) uniform sampler2D u_average;   // alpha > 0: a hole at some time of the exposure

uniform bool u_has_lens;    // the image has pixels outside the field of view of a lens
uniform bool u_blurred;     // colours are an average
uniform bool u_blended;     // pixels beside holes are blended with the background
uniform bool u_of_depth;    // the pyramid is of inverse depth
uniform float u_near, u_far;

uint seen(ivec2 pixel) {
    uvec4 normal = texelFetch(u_normals, texel(pixel), 0);
    uint code = code_of(normal);
    if (code == UNSEEN && u_has_lens && normal.g == 0u) code = OUTSIDE;
    bool is_kept = code == SURFACE || code == MOVING;
    if (u_blurred && is_kept && texelFetch(u_average, texel(pixel) - u_rect.xy, 0).a > 0.0) return NOTHING;
    return code;
}

bool is_beside_hole(ivec2 pixel) {
    for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
            ivec2 neighbour = pixel + ivec2(dx, dy);
            bool is_on = all(greaterThanEqual(neighbour, ivec2(0))) && all(lessThan(neighbour, canvas()));
            if (is_on && is_hole(seen(neighbour))) return true;
        }
    }
    return false;
}

void main() {
    if (!is_within(canvas())) return;
    ivec2 pixel = here();
    uint code = seen(pixel);
    if (u_blended && code == SURFACE && is_beside_hole(pixel)) code = NOTHING;
    codes[canvas_index(pixel)] = code;
    bool is_known = code == SURFACE;
    vec3 value = vec3(0.0);
    if (u_of_depth) {
        float inverse = texelFetch(u_depth, texel(pixel), 0).r / u_near;
        is_known = is_known && inverse * u_far >= 1.0;
        value.r = inverse;
    } else {
        value = vec3(texelFetch(u_color, texel(pixel), 0).rgb);
    }
    pyramid[canvas_index(pixel)] = is_known ? vec4(value, 1.0) : vec4(0.0);
}
