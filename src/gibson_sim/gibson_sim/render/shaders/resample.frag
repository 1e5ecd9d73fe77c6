// Fills the image of a non-pinhole camera from its views: a table says where to look for each pixel. Colours are interpolated in linear
// light; all other outputs come from the nearest texel.
uniform ivec2 u_origin;      // left column and top row of the image in the target
uniform sampler2D u_map;     // for each pixel: position in the source, texels; depth along the view's axis of a point at depth 1; tile
#ifdef TAPS
uniform sampler2D u_taps;    // for each of TAPS x TAPS parts of a pixel: position in the source, texels; negative = nothing
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
uniform mat3 u_ray[TILES];   // from (column, row, 1) of the source to a direction in the camera's optical frame
uniform mat3 u_k;            // K of the camera
#ifdef PINHOLE
uniform float u_d[8];        // k1, k2, p1, p2, k3 to k6
#else
uniform float u_d[4];
#endif
uniform float u_reach;       // limit of the distortion model: squared distance on the plane z = 1, or angle
uniform float u_turn_px;     // columns of a full turn of an equirectangular image
layout(location = 3) out vec2 out_flow;

const float NOTHING = uintBitsToFloat(0x7FC00000u);

// The same as project() of geometry/projections.py.
vec2 project(vec3 p) {
    vec2 plane;
#if defined(PINHOLE)
    plane = p.xy / p.z;
    float q = dot(plane, plane);
    float radial = (1.0 + q * (u_d[0] + q * (u_d[1] + q * u_d[4]))) / (1.0 + q * (u_d[5] + q * (u_d[6] + q * u_d[7])));
    vec2 tangential = vec2(2.0 * u_d[2] * plane.x * plane.y + u_d[3] * (q + 2.0 * plane.x * plane.x),
                           u_d[2] * (q + 2.0 * plane.y * plane.y) + 2.0 * u_d[3] * plane.x * plane.y);
    plane = p.z > 0.0 && q < u_reach ? plane * radial + tangential : vec2(NOTHING);
#elif defined(FISHEYE)
    float across = length(p.xy);
    float theta = atan(across, p.z);
    float q = theta * theta;
    float radius = theta * (1.0 + q * (u_d[0] + q * (u_d[1] + q * (u_d[2] + q * u_d[3]))));
    plane = theta <= u_reach ? p.xy * (across > 0.0 ? radius / across : 0.0) : vec2(NOTHING);
#else
    plane = vec2(atan(p.x, p.z), atan(p.y, length(p.xz)));
#endif
    return (u_k * vec3(plane, 1.0)).xy;
}
#endif

vec3 mixed(vec2 place) {
    vec2 corner = floor(place - 0.5);
    vec2 part = place - 0.5 - corner;
    ivec2 at = ivec2(corner);
    vec3 top = mix(texelFetch(u_color, at, 0).rgb, texelFetch(u_color, at + ivec2(1, 0), 0).rgb, part.x);
    vec3 bottom = mix(texelFetch(u_color, at + ivec2(0, 1), 0).rgb, texelFetch(u_color, at + ivec2(1, 1), 0).rgb, part.x);
    return mix(top, bottom, part.y);
}

// Returns the change of a value from a texel's centre to the offset "part", -0.5 to 0.5, by its two neighbours. If one of them belongs to
// another surface, only the other one counts; if they disagree on the direction, none.
float rise(float before, float here, float after, float part) {
    float left = here - before, right = after - here;
    if (isnan(left)) left = right;
    if (isnan(right)) right = left;
    if (!(left * right > 0.0)) return 0.0;
    if (abs(left - right) <= min(abs(left), abs(right))) return part * 0.5 * (left + right + part * (right - left));
    return part * (abs(left) < abs(right) ? left : right);
}

// near / depth is linear in the image of a plane, so this is exact on planes.
float reversed_depth(vec2 place, ivec2 at) {
    vec2 part = place - 0.5 - vec2(at);
    float here = texelFetch(u_depth, at, 0).r;
    float sum = rise(texelFetch(u_depth, at - ivec2(1, 0), 0).r, here, texelFetch(u_depth, at + ivec2(1, 0), 0).r, part.x)
              + rise(texelFetch(u_depth, at - ivec2(0, 1), 0).r, here, texelFetch(u_depth, at + ivec2(0, 1), 0).r, part.y);
    return max(here + sum, 0.5 * here);
}

#ifdef FLOW
// Returns the flow, texels, of the surface that is seen at a position of the source.
vec2 moved_at(vec2 place, ivec2 at) {
    vec2 part = place - 0.5 - vec2(at);
    vec2 here = texelFetch(u_flow, at, 0).rg;
    vec2 left = texelFetch(u_flow, at - ivec2(1, 0), 0).rg, right = texelFetch(u_flow, at + ivec2(1, 0), 0).rg;
    vec2 above = texelFetch(u_flow, at - ivec2(0, 1), 0).rg, below = texelFetch(u_flow, at + ivec2(0, 1), 0).rg;
    return here + vec2(rise(left.x, here.x, right.x, part.x) + rise(above.x, here.x, below.x, part.y),
                       rise(left.y, here.y, right.y, part.x) + rise(above.y, here.y, below.y, part.y));
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - u_origin;
    vec4 entry = texelFetch(u_map, pixel, 0);
    bool seen = entry.z > 0.0;
    ivec2 at = seen ? ivec2(floor(entry.xy)) : ivec2(0);
    int tile = int(entry.w);
#ifdef TAPS
    vec3 sum = vec3(0.0);
    for (int y = 0; y < TAPS; ++y) {
        for (int x = 0; x < TAPS; ++x) {
            vec2 place = texelFetch(u_taps, TAPS * pixel + ivec2(x, y), 0).xy;
            if (place.x >= 0.0) sum += mixed(place);
        }
    }
    out_color = vec4(sum / float(TAPS * TAPS), 1.0);
#else
    out_color = vec4(seen ? mixed(entry.xy) : vec3(0.0), 1.0);
#endif
    gl_FragDepth = seen ? reversed_depth(entry.xy, at) * entry.z : 0.0;
#ifdef LABELS
    out_label = seen ? texelFetch(u_labels, at, 0).rg : uvec2(0);
#endif
#ifdef NORMALS
    vec4 normal = seen ? texelFetch(u_normals, at, 0) : vec4(1.0, 1.0, 1.0, 0.0);  // no hole: outside the lens's view
    out_normal = normal.a > 0.0 ? vec4(0.5 + 0.5 * (u_turn[tile] * (2.0 * normal.rgb - 1.0)), normal.a) : normal;
#endif
#ifdef FLOW
    vec2 moved = moved_at(entry.xy, at);
    vec2 flow = project(u_ray[tile] * vec3(entry.xy, 1.0)) - project(u_ray[tile] * vec3(entry.xy - moved, 1.0));
    if (u_turn_px > 0.0) flow.x -= u_turn_px * round(flow.x / u_turn_px);
    out_flow = seen && !isnan(moved.x) ? flow : vec2(NOTHING);
#endif
}
