// How much of the light from all around reaches a surface that splats show beside what moves: darker towards the boxes of moving links.
// What moves is taken as its box with round upright edges, since a picture does not show the side that faces the surface. The splats are
// multiplied by the factor.
uniform sampler2D u_depth;   // near / depth of all surfaces
uniform sampler2D u_hiding;  // the same, where surfaces that do not move are moved away from the eye
uniform int u_boxes;
struct Box {
    mat4 box_from_optical;  // rigid, metres; the origin is the middle of the box, z is the most upright axis
    vec4 half_size;         // metres; w: radius of the upright edges
};
layout(std430, binding = 0) readonly buffer Boxes { Box boxes[]; };
layout(location = 0) out vec4 out_factor;

const int TAPS = 3;
const float HEIGHTS[TAPS] = float[](0.2 * REACH, 0.5 * REACH, REACH);

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    float here = texelFetch(u_depth, at, 0).r;
    out_factor = vec4(1.0);
    // A surface that moves has light of its own.
    if (here <= 0.0 || texelFetch(u_hiding, at, 0).r > here * (1.0 - 1e-5)) return;
    vec3 normal = -normalize(normal_at(u_depth, at));
    vec3 point = vec3(ray_at(at), 1.0) * (eye.w / here);
    float most = 0.0;
    for (int k = 0; k < u_boxes; ++k) {
        vec3 p = (boxes[k].box_from_optical * vec4(point, 1.0)).xyz, n = mat3(boxes[k].box_from_optical) * normal;
        float covered = 0.0;
        for (int tap = 0; tap < TAPS; ++tap) {
            vec3 beyond = abs(p + n * HEIGHTS[tap]) - boxes[k].half_size.xyz;
            float radius = boxes[k].half_size.w;
            float across = length(max(beyond.xy + radius, 0.0)) - radius;
            float gap = length(max(vec2(across, beyond.z), 0.0));
            covered += max(1.0 - gap / HEIGHTS[tap], 0.0);
        }
        most = max(most, covered / float(TAPS));
    }
    out_factor.rgb -= DARKEST * most;
}
