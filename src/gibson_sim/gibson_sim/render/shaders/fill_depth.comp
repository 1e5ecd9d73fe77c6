// The depth of the image, near / z, with its holes filled by a network (NETWORK) or by push-pull.
layout(binding = 1) uniform sampler2D u_depth;
layout(binding = 2) uniform usampler2D u_normals;
layout(std430, binding = 6) writeonly buffer Depth { float reversed[]; };

uniform float u_near, u_far;

#ifdef NETWORK
layout(std430, binding = 4) readonly buffer Inverse { float inverse_of_network[]; };  // of the padded canvas, 1/m
layout(std430, binding = 7) buffer Flags { uint is_not_finite; };

uniform ivec2 u_padded;

const float LEAST = 1e-3;  // see filling/network.py
#endif

void main() {
    if (!is_within(u_rect.zw)) return;
    ivec2 pixel = here() + ivec2(u_turn, 0);
    float drawn = texelFetch(u_depth, texel(pixel), 0).r;
    float inverse = pyramid[canvas_index(pixel)].r;
#ifdef NETWORK
    float told = inverse_of_network[pixel.y * u_padded.x + pixel.x];
    if (!is_finite(told)) is_not_finite = 1u;
    if (told > LEAST) inverse = told;
#endif
    if (is_hole(code_of(texelFetch(u_normals, texel(pixel), 0)))) {
        // Where nothing is known, the depth that was drawn, if it is not too far, stays.
        if (inverse > 0.0) drawn = inverse * u_near;
        else if (drawn * u_far < u_near) drawn = 0.0;
    }
    reversed[here().y * u_rect.z + here().x] = drawn;
}
