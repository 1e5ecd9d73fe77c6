// Lighting: the radiance from a surface to the eye. Included before scene.frag; world frame (z up), linear light.
//
// The BRDF is that of glTF 2.0, appendix B.3: GGX distribution, joint Smith visibility, Schlick's Fresnel. The strength of a light is the
// radiance of a white Lambertian surface that faces it: it includes the 1 / pi of the standard's diffuse term, so the specular term is
// multiplied by pi.
//
// Macros, so that a scene pays only for the features that it uses:
//   GLOSS         some material has specular highlights
//   POINT_LIGHTS  number of point lights
//   ENVIRONMENT   image-based lighting
//   SHADOWS       the sun casts shadows
//   MATERIAL_MAPS the material has maps in addition to its base colour texture
struct Surface {
    vec3 position;
    vec3 normal;  // unit length, towards the eye
    vec3 face;    // normal of the flat triangle, any length, towards the eye
    vec3 to_eye;  // any length
    vec3 base_color;
    float metallic;
    float roughness;
    vec3 emissive;
    float occlusion;  // ambient occlusion factor, 1 = unoccluded
};

layout(std140, binding = 1) uniform Light {
    vec4 to_sun;             // unit vector
    vec4 sun_and_ambient;    // colour times strength of the sun; strength of the ambient light
    vec4 irradiance[9];      // coefficients of the polynomial of irradiance() in environment.py
    mat4 shadow_from_world;  // to texture coordinates and depth, all 0 to 1; depth 1 = nearest to the sun
    vec4 shadow_size;        // size of a texel, metres; half a texel in texture coordinates
#ifdef POINT_LIGHTS
    vec4 lamps[4 * POINT_LIGHTS];  // position, 1 / range^4; colour, spot scale; attenuation, spot offset; direction
#endif
};

// Ratio of the ambient light on a surface facing down to that on a surface facing up.
const float FLOOR_LIGHT = 0.7;
// Roughness from which a dielectric has no highlight, and the range over which the highlight fades in.
const float MATTE_ROUGHNESS = 0.9, MATTE_FADE = 0.1;
const float PI = 3.14159265;

#if defined(POINT_LIGHTS) || defined(ENVIRONMENT) || defined(SHADOWS)
#define PHYSICAL  // otherwise the sun also approximates indirect light
#endif

// Ambient light on a diffuse surface with the given normal.
float ambient_diffuse(vec3 direction) {
    return sun_and_ambient.w * mix(FLOOR_LIGHT, 1.0, 0.5 + 0.5 * direction.z);
}

// Ambient light reflected by a glossy surface: bright above, dark below, with a horizon that blurs with roughness. Uniform light would make
// polished metal look like grey paint.
float ambient_specular(vec3 direction, float roughness) {
    float width = mix(0.2, 1.0, roughness);
    float up = smoothstep(-width, width, direction.z);
    return sun_and_ambient.w * mix(mix(0.3, FLOOR_LIGHT, roughness), mix(1.3, 1.0, roughness), up);
}

#ifdef ENVIRONMENT
layout(binding = 5) uniform sampler2DArray u_reflections;  // octahedral, one layer for each roughness, with a border of one texel
const float REFLECTION_LAYERS = 8.0, REFLECTION_SIZE = 256.0;

vec3 ambient_light(vec3 n) {
    vec3 sum = irradiance[0].rgb + irradiance[1].rgb * n.y + irradiance[2].rgb * n.z + irradiance[3].rgb * n.x
        + irradiance[4].rgb * (n.x * n.y) + irradiance[5].rgb * (n.y * n.z) + irradiance[6].rgb * (n.z * n.z)
        + irradiance[7].rgb * (n.x * n.z) + irradiance[8].rgb * (n.x * n.x - n.y * n.y);
    return max(sum, 0.0) + ambient_diffuse(n);
}

vec3 reflected_light(vec3 direction, float roughness) {
    vec3 d = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
    vec2 folded = (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
    vec2 uv = ((d.z >= 0.0 ? d.xy : folded) * 0.5 + 0.5) * ((REFLECTION_SIZE - 2.0) / REFLECTION_SIZE) + 1.0 / REFLECTION_SIZE;
    float layer = clamp(roughness, 0.0, 1.0) * (REFLECTION_LAYERS - 1.0);
    float low = floor(layer);
    vec3 first = textureLod(u_reflections, vec3(uv, low), 0.0).rgb;
    vec3 second = textureLod(u_reflections, vec3(uv, min(low + 1.0, REFLECTION_LAYERS - 1.0)), 0.0).rgb;
    return mix(first, second, layer - low) + ambient_specular(direction, roughness);
}
#else
vec3 ambient_light(vec3 n) {
    return vec3(ambient_diffuse(n));
}

vec3 reflected_light(vec3 direction, float roughness) {
    return vec3(ambient_specular(direction, roughness));
}
#endif

#ifdef SHADOWS
layout(binding = 6) uniform sampler2DShadow u_shadow_map;

// Fraction of the sunlight that is not shadowed, filtered over 3 x 3 texels.
float sunlight(vec3 position, vec3 face) {
    vec3 n = normalize(face);
    // On a slope, a texel may hold a depth nearer to the sun than the point itself. Offsets the point along its normal by the reach of the
    // filter down the slope.
    float facing = dot(n, to_sun.xyz);
    vec3 raised = position + n * (shadow_size.x * (0.5 + 2.5 * sqrt(max(1.0 - facing * facing, 0.0))));
    vec3 uvz = (shadow_from_world * vec4(raised, 1.0)).xyz;
    float reach = shadow_size.y;
    float sum = texture(u_shadow_map, vec3(uvz.xy + vec2(-reach, -reach), uvz.z))
        + texture(u_shadow_map, vec3(uvz.xy + vec2(reach, -reach), uvz.z))
        + texture(u_shadow_map, vec3(uvz.xy + vec2(-reach, reach), uvz.z))
        + texture(u_shadow_map, vec3(uvz.xy + vec2(reach, reach), uvz.z));
    return 0.25 * sum;
}
#endif

#ifdef GLOSS
layout(binding = 7) uniform sampler2D u_reflectance;  // by (n.v, roughness): scale of f0, and bias
const float REFLECTANCE_SIZE = 32.0;

// Returns the specular reflection of light from one direction; diffuse is the fraction left for diffuse reflection.
vec3 highlight(vec3 n, vec3 v, vec3 l, float n_l, float n_v, vec3 f0, float a2, out vec3 diffuse) {
    vec3 h = normalize(l + v);
    float n_h = max(dot(n, h), 0.0), v_h = max(dot(v, h), 0.0);
    float away = 1.0 - v_h;
    float away2 = away * away;
    vec3 fresnel = f0 + (1.0 - f0) * (away2 * away2 * away);
    float spread = n_h * n_h * (a2 - 1.0) + 1.0;
    float visibility = 0.5 / (n_l * sqrt(n_v * n_v * (1.0 - a2) + a2) + n_v * sqrt(n_l * n_l * (1.0 - a2) + a2) + 1e-6);
    diffuse = 1.0 - fresnel;
    return fresnel * (a2 / (spread * spread) * visibility);  // pi cancels the one in GGX
}
#endif

#ifdef POINT_LIGHTS
// Returns the radiance of a white Lambertian surface that faces lamp k; l is the unit vector towards the lamp.
vec3 lamp(int k, vec3 position, out vec3 l) {
    vec4 origin = lamps[4 * k], color = lamps[4 * k + 1], attenuation = lamps[4 * k + 2];
    vec3 to_lamp = origin.xyz - position;
    float d2 = dot(to_lamp, to_lamp);
    float d = sqrt(d2);
    l = to_lamp / max(d, 1e-6);
    float fade = clamp(1.0 - d2 * d2 * origin.w, 0.0, 1.0);  // KHR_lights_punctual
    float cone = clamp(dot(lamps[4 * k + 3].xyz, -l) * color.w + attenuation.w, 0.0, 1.0);
    return color.rgb * (fade * cone * cone / max(attenuation.x + attenuation.y * d + attenuation.z * d2, 1e-4));
}
#endif

vec3 shade(Surface s) {
    vec3 n = s.normal;
    vec3 color = s.base_color * (1.0 - s.metallic);
    float sun_facing = dot(n, to_sun.xyz);
    float n_sun = max(sun_facing, 0.0);
#ifdef PHYSICAL
    float sun = n_sun;
#else
    // Wrapped diffuse: surfaces facing away from the sun darken gradually, so that walls of all orientations differ.
    float sun = (0.5 + 0.5 * sun_facing) * (0.5 + 0.5 * sun_facing);
#endif
    float lit = 1.0;
#ifdef SHADOWS
    lit = sunlight(s.position, s.face);
    sun *= lit;
#endif

#ifndef GLOSS
    vec3 light = ambient_light(n) * s.occlusion + sun_and_ambient.rgb * sun;
#ifdef POINT_LIGHTS
    for (int k = 0; k < POINT_LIGHTS; ++k) {
        vec3 l;
        vec3 strength = lamp(k, s.position, l);
        light += strength * max(dot(n, l), 0.0);
    }
#endif
    vec3 result = s.base_color * light + s.emissive;
#else
    vec3 v = normalize(s.to_eye);
    float n_v = clamp(dot(n, v), 1e-3, 1.0);
    float gloss = max(clamp((MATTE_ROUGHNESS - s.roughness) / MATTE_FADE, 0.0, 1.0), s.metallic);
    vec3 f0 = mix(vec3(0.04), s.base_color, s.metallic);
    float roughness = max(s.roughness, 0.04);
    float a2 = roughness * roughness * roughness * roughness;

    // Image-based lighting by the split sum approximation. Energy of multiple scattering between microfacets is added back, so that a white
    // metal is white at every roughness.
    vec2 reflectance = texture(u_reflectance, (vec2(n_v, roughness) * (REFLECTANCE_SIZE - 1.0) + 0.5) / REFLECTANCE_SIZE).rg;
    vec3 albedo = f0 * reflectance.x + reflectance.y;
    albedo *= gloss * (1.0 + f0 * (1.0 / (reflectance.x + reflectance.y) - 1.0));
    // The dominant reflection of a rough surface is nearer to its normal than that of a mirror (Lagarde, de Rousiers 2014).
    float alpha = roughness * roughness;
    vec3 dominant = mix(n, reflect(-v, n), (1.0 - alpha) * (sqrt(1.0 - alpha) + alpha));
    vec3 ambient = color * (1.0 - albedo) * ambient_light(n) + albedo * reflected_light(dominant, roughness);

    vec3 diffuse;
    vec3 sun_specular = highlight(n, v, to_sun.xyz, n_sun, n_v, f0, a2, diffuse) * (gloss * n_sun * lit);
    vec3 sun_diffuse = color * mix(vec3(1.0), diffuse, gloss) * sun;
    vec3 result = ambient * s.occlusion + sun_and_ambient.rgb * (sun_diffuse + sun_specular) + s.emissive;
#ifdef POINT_LIGHTS
    for (int k = 0; k < POINT_LIGHTS; ++k) {
        vec3 l;
        vec3 strength = lamp(k, s.position, l);
        float n_l = max(dot(n, l), 0.0);
        vec3 specular = highlight(n, v, l, n_l, n_v, f0, a2, diffuse) * gloss;
        result += strength * n_l * (color * mix(vec3(1.0), diffuse, gloss) + specular);
    }
#endif
#endif
    return result;
}

#ifdef MATERIAL_MAPS
layout(binding = 1) uniform sampler2D u_metallic_roughness_map;  // blue, green
layout(binding = 2) uniform sampler2D u_normal_map;              // +x right, +y up in the image
layout(binding = 3) uniform sampler2D u_occlusion_map;           // red
layout(binding = 4) uniform sampler2D u_emissive_map;

// Applies the material maps to a surface whose fields hold the factors. Vertices have no tangents: they are computed from the screen-space
// derivatives of position and texture coordinates.
// weights: normal scale, occlusion strength, weights of the metalness map and of the roughness map.
void apply_maps(inout Surface s, vec2 uv, vec4 weights) {
    vec2 metallic_roughness = mix(vec2(1.0), texture(u_metallic_roughness_map, uv).bg, weights.zw);
    s.metallic *= metallic_roughness.x;
    s.roughness *= metallic_roughness.y;
    s.emissive *= texture(u_emissive_map, uv).rgb;
    s.occlusion = mix(1.0, texture(u_occlusion_map, uv).r, weights.y);
    vec3 tangent_normal = texture(u_normal_map, uv).xyz * 2.0 - 1.0;
    tangent_normal.xy *= weights.x;
    vec3 px = dFdx(s.position), py = dFdy(s.position);
    vec2 tx = dFdx(uv), ty = dFdy(uv);
    float handedness = tx.x * ty.y - ty.x * tx.y < 0.0 ? -1.0 : 1.0;
    vec3 right = (px * ty.y - py * tx.y) * handedness, down = (py * tx.x - px * ty.x) * handedness;
    right -= s.normal * dot(s.normal, right);
    down -= s.normal * dot(s.normal, down);
    right *= inversesqrt(max(dot(right, right), 1e-30));
    down *= inversesqrt(max(dot(down, down), 1e-30));
    s.normal = normalize(right * tangent_normal.x - down * tangent_normal.y + s.normal * max(tangent_normal.z, 1e-3));
}
#endif
