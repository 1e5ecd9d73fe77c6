// Writes the colours of the image: with NETWORK those of a network, fading with the distance from holes, else those of push-pull in holes.
layout(binding = 0, rgba8ui) uniform uimage2D u_image;  // sRGB bytes, through a texture view

#ifdef NETWORK
layout(std430, binding = 3) readonly buffer Image { float planes[]; };         // of the padded canvas, 0 to 1
layout(std430, binding = 5) readonly buffer Distances { float distances[]; };  // from the nearest hole of the row
layout(std430, binding = 7) buffer Flags { uint is_not_finite; };

uniform ivec2 u_padded;
uniform int u_fade_limit_px;
uniform float u_fade_px;  // distance at which a correction has fallen to 1/e

const float EPSILON = 1e-5;  // of OpenCV's blendLinear

float share_at(ivec2 pixel) {
    float nearest = 1e12;
    for (int y = max(pixel.y - u_fade_limit_px, 0); y <= min(pixel.y + u_fade_limit_px, canvas().y - 1); ++y) {
        float across = distances[canvas_index(ivec2(pixel.x, y))], down = float(y - pixel.y);
        nearest = min(nearest, across * across + down * down);
    }
    return nearest > float(u_fade_limit_px * u_fade_limit_px) ? 0.0 : exp(-sqrt(nearest) / u_fade_px);
}
#else
uniform int u_last;  // last element of the pyramid: its weight is 0 if no pixel is known
#endif

void main() {
    if (!is_within(u_rect.zw)) return;
    ivec2 pixel = here() + ivec2(u_turn, 0);
    int index = canvas_index(pixel);
    uint code = codes[index];
#ifdef NETWORK
    int plane = u_padded.x * u_padded.y, own = pixel.y * u_padded.x + pixel.x;
    vec3 color = vec3(planes[own], planes[plane + own], planes[2 * plane + own]);
    if (!is_finite(color.r) || !is_finite(color.g) || !is_finite(color.b)) is_not_finite = 1u;
    if (code != SURFACE && !is_hole(code)) return;
    uvec4 drawn = imageLoad(u_image, texel(pixel));
    float share = share_at(pixel);
    color = roundEven(clamp(color, 0.0, 1.0) * 255.0);
    color = (color * share + vec3(drawn.rgb) * (1.0 - share)) / (1.0 + EPSILON);
#else
    if (!is_hole(code) || pyramid[u_last].a == 0.0) return;
    uvec4 drawn = imageLoad(u_image, texel(pixel));
    vec3 color = clamp(pyramid[index].rgb, 0.0, 255.0);
#endif
    imageStore(u_image, texel(pixel), uvec4(uvec3(roundEven(color)), drawn.a));
}
