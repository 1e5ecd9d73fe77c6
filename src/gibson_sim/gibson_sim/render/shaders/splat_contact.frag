// Ambient occlusion of splats by moving links; the splats are multiplied by the output. Each link is approximated by its box with rounded
// upright edges, since the picture does not show the side of the link that faces the surface.
uniform sampler2D u_depth;   // near / depth of all surfaces
uniform sampler2D u_hiding;  // near / depth of the occluders of splats: static surfaces are moved away from the eye
uniform int u_boxes;
struct Box {
    mat4 box_from_optical;  // rigid, metres; the origin is the centre of the box, z is its most upright axis
    vec4 half_size;         // metres; w: radius of the upright edges
};
layout(std430, binding = 0) readonly buffer Boxes { Box boxes[]; };
layout(location = 0) out vec4 out_factor;

const int TAPS = 3;
const float HEIGHTS[TAPS] = float[](0.2 * RADIUS, 0.5 * RADIUS, RADIUS);

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float reversed = texelFetch(u_depth, pixel, 0).r;
    out_factor = vec4(1.0);
    // Moving surfaces are not darkened: the scene's lighting applies to them.
    if (reversed <= 0.0 || texelFetch(u_hiding, pixel, 0).r > reversed * (1.0 - 1e-5)) return;
    vec3 normal = -normalize(normal_at(u_depth, pixel));
    vec3 point = vec3(ray_at(pixel), 1.0) * (eye.w / reversed);
    float occlusion = 0.0;
    for (int k = 0; k < u_boxes; ++k) {
        vec3 p = (boxes[k].box_from_optical * vec4(point, 1.0)).xyz, n = mat3(boxes[k].box_from_optical) * normal;
        float covered = 0.0;
        for (int tap = 0; tap < TAPS; ++tap) {
            vec3 outside = abs(p + n * HEIGHTS[tap]) - boxes[k].half_size.xyz;
            float radius = boxes[k].half_size.w;
            float horizontal = length(max(outside.xy + radius, 0.0)) - radius;
            float gap = length(max(vec2(horizontal, outside.z), 0.0));
            covered += max(1.0 - gap / HEIGHTS[tap], 0.0);
        }
        occlusion = max(occlusion, covered / float(TAPS));
    }
    out_factor.rgb -= DARKEST * occlusion;
}
