// Appearances: tints and patterns applied to the material of a visual. Included before scene.frag.
#ifdef APPEARANCE
struct Appearance {
    vec4 red, green, blue;  // rows of the tint, linear light
    vec4 first;             // colour where the pattern is 0; layer of the pattern, -1 = none
    vec4 second;            // colour where the pattern is 1; repeats per metre
};
layout(std430, binding = 3) readonly buffer Appearances { Appearance appearances[]; };
layout(binding = 8) uniform sampler2DArray u_patterns;

// local: position of the surface in the frame of its link, metres; the pattern is fixed to the link.
vec3 with_appearance(vec3 color, Appearance appearance, vec3 local) {
    // Derivatives only of the interpolated position: in helper pixels outside the triangle the appearance may read as zero.
    vec3 scaled = local * appearance.second.w, dx = dFdx(local) * appearance.second.w, dy = dFdy(local) * appearance.second.w;
    vec3 face = abs(cross(dx, dy));
    // Projected along the dominant axis of the triangle's normal. On walls u is horizontal and v is vertical.
    bool along_x = face.x >= face.y && face.x >= face.z, along_z = face.z > face.x && face.z >= face.y;
    vec2 uv = along_x ? scaled.yz : along_z ? scaled.xy : scaled.xz;
    vec2 uv_dx = along_x ? dx.yz : along_z ? dx.xy : dx.xz;
    vec2 uv_dy = along_x ? dy.yz : along_z ? dy.xy : dy.xz;
    vec3 weight = textureGrad(u_patterns, vec3(uv.x, -uv.y, max(appearance.first.w, 0.0)), uv_dx, uv_dy).rgb;
    vec3 base = appearance.first.w < 0.0 ? color : mix(appearance.first.rgb, appearance.second.rgb, weight);
    return clamp(vec3(dot(appearance.red.rgb, base), dot(appearance.green.rgb, base), dot(appearance.blue.rgb, base)), 0.0, 1.0);
}
#endif
