// Resamples the image of a non-pinhole camera from its views with a lookup table. Colours are interpolated in linear light; all other
// outputs come from the nearest texel.
uniform ivec2 u_origin;      // left column and top row of the image in the target
uniform sampler2D u_map;     // of each pixel: position in the source, texels; depth along the view's axis of a point at depth 1; tile
#ifdef TAPS
uniform sampler2D u_taps;    // of each of TAPS x TAPS subpixels: position in the source, texels; negative = nothing
#endif
uniform sampler2D u_color;
uniform sampler2D u_depth;   // near / depth along the view's axis
layout(location = 0) out vec4 out_color;
#ifdef LABELS
uniform usampler2D u_labels;
layout(location = 1) out uvec2 out_label;
#endif
#ifdef NORMALS
uniform sampler2D u_normals;
uniform mat3 u_turn[TILES];  // R_camera_view
layout(location = 2) out vec4 out_normal;
#endif
#ifdef FLOW
uniform sampler2D u_flow;
uniform mat3 u_ray[TILES];   // maps (column, row, 1) of the source to a direction in the camera's optical frame
uniform mat3 u_k;            // K of the camera
#ifdef PINHOLE
uniform float u_d[8];        // k1, k2, p1, p2, k3 to k6
#else
uniform float u_d[4];
#endif
uniform float u_limit;       // limit of the distortion model: squared distance in the plane z = 1, or angle
uniform float u_turn_px;     // columns of a full turn of an equirectangular image
layout(location = 3) out vec2 out_flow;

const float NOTHING = uintBitsToFloat(0x7FC00000u);

// See project() in geometry/projections.py.
vec2 project(vec3 p) {
    vec2 plane;
#if defined(PINHOLE)
    plane = p.xy / p.z;
    float q = dot(plane, plane);
    float radial = (1.0 + q * (u_d[0] + q * (u_d[1] + q * u_d[4]))) / (1.0 + q * (u_d[5] + q * (u_d[6] + q * u_d[7])));
    vec2 tangential = vec2(2.0 * u_d[2] * plane.x * plane.y + u_d[3] * (q + 2.0 * plane.x * plane.x),
                           u_d[2] * (q + 2.0 * plane.y * plane.y) + 2.0 * u_d[3] * plane.x * plane.y);
    plane = p.z > 0.0 && q < u_limit ? plane * radial + tangential : vec2(NOTHING);
#elif defined(FISHEYE)
    float across = length(p.xy);
    float theta = atan(across, p.z);
    float q = theta * theta;
    float radius = theta * (1.0 + q * (u_d[0] + q * (u_d[1] + q * (u_d[2] + q * u_d[3]))));
    plane = theta <= u_limit ? p.xy * (across > 0.0 ? radius / across : 0.0) : vec2(NOTHING);
#else
    plane = vec2(atan(p.x, p.z), atan(p.y, length(p.xz)));
#endif
    return (u_k * vec3(plane, 1.0)).xy;
}
#endif

// Returns the bilinearly interpolated colour at a position of the source.
vec3 interpolated_color(vec2 position) {
    vec2 corner = floor(position - 0.5);
    vec2 offset = position - 0.5 - corner;
    ivec2 texel = ivec2(corner);
    vec3 top = mix(texelFetch(u_color, texel, 0).rgb, texelFetch(u_color, texel + ivec2(1, 0), 0).rgb, offset.x);
    vec3 bottom = mix(texelFetch(u_color, texel + ivec2(0, 1), 0).rgb, texelFetch(u_color, texel + ivec2(1, 1), 0).rgb, offset.x);
    return mix(top, bottom, offset.y);
}

// Returns the change of a value from a texel's centre to an offset, -0.5 to 0.5, estimated from its two neighbours. A neighbour on another
// surface is ignored; if the two slopes have opposite signs, the change is 0.
float extrapolated(float previous, float centre, float next, float offset) {
    float left = centre - previous, right = next - centre;
    if (isnan(left)) left = right;
    if (isnan(right)) right = left;
    if (!(left * right > 0.0)) return 0.0;
    if (abs(left - right) <= min(abs(left), abs(right))) return offset * 0.5 * (left + right + offset * (right - left));
    return offset * (abs(left) < abs(right) ? left : right);
}

// Returns near / depth at a position of the source: it is linear in the image of a plane, so the result is exact on planes.
float reversed_depth(vec2 position, ivec2 texel) {
    vec2 offset = position - 0.5 - vec2(texel);
    float centre = texelFetch(u_depth, texel, 0).r;
    float sum = extrapolated(texelFetch(u_depth, texel - ivec2(1, 0), 0).r, centre, texelFetch(u_depth, texel + ivec2(1, 0), 0).r, offset.x)
              + extrapolated(texelFetch(u_depth, texel - ivec2(0, 1), 0).r, centre, texelFetch(u_depth, texel + ivec2(0, 1), 0).r, offset.y);
    return max(centre + sum, 0.5 * centre);
}

#ifdef FLOW
// Returns the flow, texels, of the surface visible at a position of the source.
vec2 flow_at(vec2 position, ivec2 texel) {
    vec2 offset = position - 0.5 - vec2(texel);
    vec2 centre = texelFetch(u_flow, texel, 0).rg;
    vec2 left = texelFetch(u_flow, texel - ivec2(1, 0), 0).rg, right = texelFetch(u_flow, texel + ivec2(1, 0), 0).rg;
    vec2 above = texelFetch(u_flow, texel - ivec2(0, 1), 0).rg, below = texelFetch(u_flow, texel + ivec2(0, 1), 0).rg;
    return centre + vec2(extrapolated(left.x, centre.x, right.x, offset.x) + extrapolated(above.x, centre.x, below.x, offset.y),
                         extrapolated(left.y, centre.y, right.y, offset.x) + extrapolated(above.y, centre.y, below.y, offset.y));
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - u_origin;
    vec4 entry = texelFetch(u_map, pixel, 0);
    bool valid = entry.z > 0.0;
    ivec2 texel = valid ? ivec2(floor(entry.xy)) : ivec2(0);
    int tile = int(entry.w);
#ifdef TAPS
    vec3 sum = vec3(0.0);
    for (int y = 0; y < TAPS; ++y) {
        for (int x = 0; x < TAPS; ++x) {
            vec2 position = texelFetch(u_taps, TAPS * pixel + ivec2(x, y), 0).xy;
            if (position.x >= 0.0) sum += interpolated_color(position);
        }
    }
    out_color = vec4(sum / float(TAPS * TAPS), 1.0);
#else
    out_color = vec4(valid ? interpolated_color(entry.xy) : vec3(0.0), 1.0);
#endif
    gl_FragDepth = valid ? reversed_depth(entry.xy, texel) * entry.z : 0.0;
#ifdef LABELS
    out_label = valid ? texelFetch(u_labels, texel, 0).rg : uvec2(0);
#endif
#ifdef NORMALS
    vec4 normal = valid ? texelFetch(u_normals, texel, 0) : vec4(1.0, 0.0, 1.0, 0.0);  // outside the field of view: not a hole, and not sky
    out_normal = normal.a > 0.0 ? vec4(0.5 + 0.5 * (u_turn[tile] * (2.0 * normal.rgb - 1.0)), normal.a) : normal;
#endif
#ifdef FLOW
    vec2 source_flow = flow_at(entry.xy, texel);
    vec2 flow = project(u_ray[tile] * vec3(entry.xy, 1.0)) - project(u_ray[tile] * vec3(entry.xy - source_flow, 1.0));
    if (u_turn_px > 0.0) flow.x -= u_turn_px * round(flow.x / u_turn_px);
    out_flow = valid && !isnan(source_flow.x) ? flow : vec2(NOTHING);
#endif
}
