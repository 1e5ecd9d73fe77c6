// Input of a network, planes of the canvas padded to multiples of 16. See network_input() in filling/inputs.py.
layout(binding = 0) uniform usampler2D u_color;
layout(binding = 1) uniform sampler2D u_depth;
layout(binding = 2) uniform usampler2D u_normals;

uniform ivec2 u_padded;
uniform int u_last;  // last element of the pyramid: its weight is 0 if no pixel is known
uniform float u_near, u_far;

layout(std430, binding = 2) writeonly buffer Input { float planes[]; };

const float MOST = 5.0, UNIT = 2.0 / 65535.0;  // see filling/inputs.py and readback/frames.py

void main() {
    if (!is_within(u_padded)) return;
    ivec2 pixel = min(here(), canvas() - 1);  // padding repeats the last row and column
    uint code = codes[canvas_index(pixel)];
    bool is_open = is_hole_to_network(code);
    vec3 color = vec3(texelFetch(u_color, texel(pixel), 0).rgb);
    if (is_open && pyramid[u_last].a > 0.0) color = roundEven(clamp(pyramid[canvas_index(pixel)].rgb, 0.0, 255.0));
    float inverse = texelFetch(u_depth, texel(pixel), 0).r / u_near;
    if (code == MOVING || inverse * u_far < 1.0) inverse = 0.0;
    uvec4 stored = texelFetch(u_normals, texel(pixel), 0);
    vec3 normal = is_open || stored.a == 0u ? vec3(0.0) : vec3(stored.rgb) * UNIT - 1.0;
    int plane = u_padded.x * u_padded.y, index = here().y * u_padded.x + here().x;
    for (int k = 0; k < 3; ++k) {
        planes[k * plane + index] = color[k] / 255.0;
        planes[(4 + k) * plane + index] = normal[k];
    }
    planes[3 * plane + index] = min(inverse, MOST);
    planes[7 * plane + index] = is_open ? 1.0 : 0.0;
    planes[8 * plane + index] = code == BACK_FACE ? 1.0 : 0.0;
}
