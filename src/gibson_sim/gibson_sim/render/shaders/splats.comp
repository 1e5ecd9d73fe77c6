// Projects splats, one per invocation (Kerbl et al. 2023): centre, extent and depth plane in the picture, and colour. SH_DEGREE is the degree
// of the spherical harmonics.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Bodies { vec4 bodies[]; };     // position, opacity; covariance xx xy xz yy, yz zz - -
layout(std430, binding = 1) readonly buffer Harmonics { float harmonics[]; };
layout(std430, binding = 2) readonly buffer Order { uint rows[]; };
struct Projected {
    vec4 centre;  // clip coordinates x and y, near / depth, extent in standard deviations
    vec4 factor;  // Cholesky factor of the covariance: xx, xy, yy, clip coordinates
    vec4 slope;   // change of near / depth along the two axes of the factor
    vec4 color;   // sRGB; opacity
};
layout(std430, binding = 3) writeonly buffer Out { Projected projected[]; };

const float LOW_PASS = 0.3;
const int COUNT = (SH_DEGREE + 1) * (SH_DEGREE + 1);

#define SH(k) vec3(harmonics[at + 3u * k], harmonics[at + 3u * k + 1u], harmonics[at + 3u * k + 2u])

vec3 color_towards(uint splat, vec3 d) {
    uint at = splat * uint(3 * COUNT);
    vec3 c = 0.28209479177387814 * SH(0u) + 0.5;
#if SH_DEGREE > 0
    float x = d.x, y = d.y, z = d.z;
    c += 0.4886025119029199 * (-y * SH(1u) + z * SH(2u) - x * SH(3u));
#endif
#if SH_DEGREE > 1
    float xx = x * x, yy = y * y, zz = z * z;
    c += 1.0925484305920792 * (x * y * SH(4u) - y * z * SH(5u) - x * z * SH(7u))
       + 0.31539156525252005 * (2.0 * zz - xx - yy) * SH(6u) + 0.5462742152960396 * (xx - yy) * SH(8u);
#endif
#if SH_DEGREE > 2
    c += -0.5900435899266435 * y * (3.0 * xx - yy) * SH(9u) + 2.890611442640554 * x * y * z * SH(10u)
       - 0.4570457994644658 * y * (4.0 * zz - xx - yy) * SH(11u) + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * SH(12u)
       - 0.4570457994644658 * x * (4.0 * zz - xx - yy) * SH(13u) + 1.445305721320277 * z * (xx - yy) * SH(14u)
       - 0.5900435899266435 * x * (xx - 3.0 * yy) * SH(15u);
#endif
    return max(c, 0.0);
}

void main() {
    uint n = gl_GlobalInvocationID.x;
    if (n >= count) return;
    uint splat = rows[first + n];
    vec4 body = bodies[3u * splat], upper = bodies[3u * splat + 1u], lower = bodies[3u * splat + 2u];
    float near = eye.w;
    vec3 offset = body.xyz - eye.xyz;
    mat3 R = mat3(optical_from_world);
    vec3 p = R * offset;
    float inverse = 1.0 / p.z;
    vec2 plane = p.xy * inverse;
    vec2 t = clamp(plane, limits.xy, limits.zw);

    mat3 covariance = R * mat3(upper.x, upper.y, upper.z, upper.y, upper.w, lower.x, upper.z, lower.x, lower.y) * transpose(R);
    mat3x2 J = mat3x2(lens.x, 0.0, skew, lens.y, -lens.x * t.x - skew * t.y, -lens.y * t.y);
    J *= inverse;
    mat3x2 across = J * covariance;
    mat2 extent = across * transpose(J);

    // Low-pass filter and Cholesky factor: any factor spans a parallelogram of the same area around the ellipse.
    float a = sqrt(extent[0][0] + LOW_PASS);
    float b = extent[0][1] / a;
    float c = sqrt(max(extent[1][1] + LOW_PASS - b * b, 1e-6));

    // Mean depth of the splat along the ray of a pixel, from its covariance with the position in the picture: a plane for flat splats.
    float depth = near * inverse;
    vec2 with_depth = across[2] * (-depth * inverse);
    vec2 slope = vec2(with_depth.x / a, 0.0);
    slope.y = (with_depth.y - b * slope.x) / c;

    // Keeps the depth at the corners of the parallelogram finite and in front of the eye.
    float reach = sqrt(2.0 * log(255.0 * body.w));
    slope *= min(1.0, 0.7 * depth / max(reach * length(slope), 1e-20));

    Projected result;
    vec2 pixel = plane * lens.xy + vec2(skew * plane.y, 0.0) + lens.zw + 0.5;
    vec2 to_clip = 2.0 / place.xy;
    result.centre = vec4(pixel * to_clip - 1.0, depth, reach);
    result.factor = vec4(a * to_clip.x, b * to_clip.y, c * to_clip.y, 0.0);
    result.slope = vec4(slope, 0.0, 0.0);
    result.color = vec4(color_towards(splat, normalize(file_from_world * offset)), body.w);
    projected[first + n] = result;
}
