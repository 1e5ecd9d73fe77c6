// Effects of a real camera: vignetting, exposure, sensor noise, white balance, in this order, in linear light; the target is sRGB.
uniform sampler2D u_color;
uniform ivec2 u_origin;           // column and row of the image's top left corner in u_color
uniform float u_exposure;         // exposure factor
uniform mat3 u_white_balance;
uniform mat3 u_ray_from_pixel;    // K inverse
uniform float u_vignette;         // fraction of light lost where the fourth power of the cosine is 0
uniform vec2 u_variance;          // variance of the noise without light, and its increase at full white
uniform uvec2 u_key;              // random key of the image

layout(location = 0) out vec4 out_color;

float cosine_to_axis(vec2 pixel) {
    vec2 ray = (u_ray_from_pixel * vec3(pixel, 1.0)).xy;
#ifdef ANGULAR
    return cos(min(length(ray), 1.57079633));  // the distance from the centre is the angle
#else
    return inversesqrt(1.0 + dot(ray, ray));
#endif
}

#ifdef NOISE
// Returns four independent random numbers: pcg4d of Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9 (3), 2020.
uvec4 hash(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    for (int round = 0; round < 2; ++round) {
        v.x += v.y * v.w;
        v.y += v.z * v.x;
        v.z += v.x * v.y;
        v.w += v.y * v.z;
        if (round == 0) v ^= v >> 16u;
    }
    return v;
}

// Returns three standard normal random numbers (Box and Muller 1958).
vec3 normal_numbers(uvec2 pixel) {
    vec4 uniform_numbers = (vec4(hash(uvec4(pixel, u_key)) >> 9u) + 0.5) / 8388608.0;  // in (0, 1), exact in 24 bits
    vec2 radius = sqrt(-2.0 * log(uniform_numbers.xy));
    vec2 angle = 6.28318531 * uniform_numbers.zw;
    return vec3(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y));
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec3 light = u_exposure * texelFetch(u_color, pixel + u_origin, 0).rgb;
    float cosine = cosine_to_axis(vec2(pixel));
    light *= 1.0 - u_vignette * (1.0 - cosine * cosine * cosine * cosine);
#ifdef NOISE
    light += sqrt(u_variance.x + u_variance.y * light) * normal_numbers(uvec2(pixel));
#endif
    out_color = vec4(clamp(u_white_balance * light, 0.0, 1.0), 1.0);
}
