// Appearances: tints and patterns over the material of a visual. Included before scene.frag.
#ifdef APPEARANCE
struct Appearance {
    vec4 red, green, blue;  // rows of the tint, linear light
    vec4 first;             // colour where the pattern is 0; its layer, -1 = no pattern
    vec4 second;            // colour where it is 1; repeats in a metre
};
layout(std430, binding = 3) readonly buffer Appearances { Appearance appearances[]; };
layout(binding = 8) uniform sampler2DArray u_patterns;

// local: position of the surface, metres, in the frame of its link, to which the pattern is fixed.
vec3 with_appearance(vec3 color, Appearance appearance, vec3 local) {
    // Derivatives of the interpolated position alone: in helper pixels outside the triangle an appearance may read as zero.
    vec3 at = local * appearance.second.w, dx = dFdx(local) * appearance.second.w, dy = dFdy(local) * appearance.second.w;
    vec3 face = abs(cross(dx, dy));
    // Projected along the axis that the triangle faces most. On walls u is horizontal and v vertical.
    bool along_x = face.x >= face.y && face.x >= face.z, along_z = face.z > face.x && face.z >= face.y;
    vec2 uv = along_x ? at.yz : along_z ? at.xy : at.xz;
    vec2 uv_dx = along_x ? dx.yz : along_z ? dx.xy : dx.xz;
    vec2 uv_dy = along_x ? dy.yz : along_z ? dy.xy : dy.xz;
    vec3 share = textureGrad(u_patterns, vec3(uv.x, -uv.y, max(appearance.first.w, 0.0)), uv_dx, uv_dy).rgb;
    vec3 worn = appearance.first.w < 0.0 ? color : mix(appearance.first.rgb, appearance.second.rgb, share);
    return clamp(vec3(dot(appearance.red.rgb, worn), dot(appearance.green.rgb, worn), dot(appearance.blue.rgb, worn)), 0.0, 1.0);
}
#endif
