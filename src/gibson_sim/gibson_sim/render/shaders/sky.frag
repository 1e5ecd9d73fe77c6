// Draws the sky.
in vec3 v_direction;
layout(binding = 0) uniform sampler2D u_surroundings;  // equirectangular, linear
layout(location = 0) out vec4 out_color;

void main() {
    vec3 d = normalize(v_direction);
    vec2 uv = vec2(0.5 - atan(d.y, d.x) * 0.15915494, acos(clamp(d.z, -1.0, 1.0)) * 0.31830989);
    // Filters across the seam, which is at -x.
    vec2 size = vec2(textureSize(u_surroundings, 0));
    float x = uv.x * size.x - 0.5;
    float low = floor(x);
    float left = (mod(low, size.x) + 0.5) / size.x, right = (mod(low + 1.0, size.x) + 0.5) / size.x;
    vec3 first = textureLod(u_surroundings, vec2(left, uv.y), 0.0).rgb, second = textureLod(u_surroundings, vec2(right, uv.y), 0.0).rgb;
    out_color = vec4(mix(first, second, x - low), 1.0);
}
