// Lighting: the light that a surface sends to the eye. Included before scene.frag; world frame (z up), linear light.
//
// The reflection of metals and plastics is that of glTF 2.0, appendix B.3: GGX distribution, joint Smith visibility, Schlick's Fresnel.
// The strength of a light is the radiance of a white matte surface that faces it: it includes the 1 / pi of the standard's diffuse part,
// and highlights are multiplied by pi here.
//
// Macros, so that a scene pays only for what it has:
//   GLOSS         some material shows highlights
//   POINT_LIGHTS  number of lamps
//   ENVIRONMENT   image-based light
//   SHADOWS       the sun casts shadows
//   MATERIAL_MAPS the material has maps beside its base colour texture
struct Surface {
    vec3 position;
    vec3 normal;  // unit length, towards the eye
    vec3 face;    // normal of the flat triangle, any length, towards the eye
    vec3 to_eye;  // any length
    vec3 base_color;
    float metallic;
    float roughness;
    vec3 emissive;
    float occlusion;  // 1 = open to all sides
};

layout(std140, binding = 1) uniform Light {
    vec4 to_sun;             // unit vector
    vec4 sun_and_ambient;    // colour times strength of the sun; strength of the ambient light
    vec4 irradiance[9];      // factors of the polynomials in environment.py
    mat4 shadow_from_world;  // to texture coordinates and depth, all 0 to 1; depth 1 = nearest to the sun
    vec4 shadow_size;        // metres a texel, half a texel in texture coordinates
#ifdef POINT_LIGHTS
    vec4 lamps[4 * POINT_LIGHTS];  // position, 1 / range^4; colour, spot scale; attenuation, spot offset; direction
#endif
};

// Ambient light on a surface that faces down, relative to one that faces up.
const float FLOOR_LIGHT = 0.7;
// A dielectric rougher than this has no highlight; it fades in over the second number.
const float MATTE_ROUGHNESS = 0.9, MATTE_FADE = 0.1;
const float PI = 3.14159265;

#if defined(POINT_LIGHTS) || defined(ENVIRONMENT) || defined(SHADOWS)
#define PHYSICAL  // otherwise the sun also approximates the light that a room reflects
#endif

float from_everywhere(vec3 direction) {
    return sun_and_ambient.w * mix(FLOOR_LIGHT, 1.0, 0.5 + 0.5 * direction.z);
}

// Ambient light as reflected by a smooth surface: bright above, dark below, with a horizon that blurs with roughness. Light without
// any direction would make polished metal look like grey paint.
float mirrored_from_everywhere(vec3 direction, float roughness) {
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
    return max(sum, 0.0) + from_everywhere(n);
}

vec3 reflected_light(vec3 direction, float roughness) {
    vec3 d = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
    vec2 folded = (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
    vec2 at = ((d.z >= 0.0 ? d.xy : folded) * 0.5 + 0.5) * ((REFLECTION_SIZE - 2.0) / REFLECTION_SIZE) + 1.0 / REFLECTION_SIZE;
    float layer = clamp(roughness, 0.0, 1.0) * (REFLECTION_LAYERS - 1.0);
    float low = floor(layer);
    vec3 first = textureLod(u_reflections, vec3(at, low), 0.0).rgb;
    vec3 second = textureLod(u_reflections, vec3(at, min(low + 1.0, REFLECTION_LAYERS - 1.0)), 0.0).rgb;
    return mix(first, second, layer - low) + mirrored_from_everywhere(direction, roughness);
}
#else
vec3 ambient_light(vec3 n) {
    return vec3(from_everywhere(n));
}

vec3 reflected_light(vec3 direction, float roughness) {
    return vec3(mirrored_from_everywhere(direction, roughness));
}
#endif

#ifdef SHADOWS
layout(binding = 6) uniform sampler2DShadow u_shadow_map;

// Part of the sunlight that is not shadowed, from 3 x 3 texels.
float sunlight(vec3 position, vec3 face) {
    vec3 n = normalize(face);
    // On a slope, a texel may hold a depth nearer to the sun than the point itself. The point is offset along its normal by as much as
    // the filter reaches down the slope.
    float facing = dot(n, to_sun.xyz);
    vec3 raised = position + n * (shadow_size.x * (0.5 + 2.5 * sqrt(max(1.0 - facing * facing, 0.0))));
    vec3 at = (shadow_from_world * vec4(raised, 1.0)).xyz;
    float reach = shadow_size.y;
    float sum = texture(u_shadow_map, vec3(at.xy + vec2(-reach, -reach), at.z))
        + texture(u_shadow_map, vec3(at.xy + vec2(reach, -reach), at.z))
        + texture(u_shadow_map, vec3(at.xy + vec2(-reach, reach), at.z))
        + texture(u_shadow_map, vec3(at.xy + vec2(reach, reach), at.z));
    return 0.25 * sum;
}
#endif

#ifdef GLOSS
layout(binding = 7) uniform sampler2D u_reflectance;  // by (n.v, roughness): scale of f0, and bias
const float REFLECTANCE_SIZE = 32.0;

// Light from one direction: the highlight, and the part left for the diffuse reflection.
vec3 highlight(vec3 n, vec3 v, vec3 l, float n_l, float n_v, vec3 f0, float a2, out vec3 left) {
    vec3 h = normalize(l + v);
    float n_h = max(dot(n, h), 0.0), v_h = max(dot(v, h), 0.0);
    float away = 1.0 - v_h;
    float away2 = away * away;
    vec3 fresnel = f0 + (1.0 - f0) * (away2 * away2 * away);
    float spread = n_h * n_h * (a2 - 1.0) + 1.0;
    float visibility = 0.5 / (n_l * sqrt(n_v * n_v * (1.0 - a2) + a2) + n_v * sqrt(n_l * n_l * (1.0 - a2) + a2) + 1e-6);
    left = 1.0 - fresnel;
    return fresnel * (a2 / (spread * spread) * visibility);  // pi cancels the one in GGX
}
#endif

#ifdef POINT_LIGHTS
// Returns the radiance of a white matte surface that faces lamp k; l is the unit vector towards the lamp.
vec3 lamp(int k, vec3 position, out vec3 l) {
    vec4 place = lamps[4 * k], color = lamps[4 * k + 1], fall = lamps[4 * k + 2];
    vec3 to = place.xyz - position;
    float d2 = dot(to, to);
    float d = sqrt(d2);
    l = to / max(d, 1e-6);
    float fade = clamp(1.0 - d2 * d2 * place.w, 0.0, 1.0);  // KHR_lights_punctual
    float cone = clamp(dot(lamps[4 * k + 3].xyz, -l) * color.w + fall.w, 0.0, 1.0);
    return color.rgb * (fade * cone * cone / max(fall.x + fall.y * d + fall.z * d2, 1e-4));
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
    // Wrapped diffuse: surfaces facing away from the sun darken gradually, so that walls of all directions differ.
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

    // Image-based light by the split sum. Energy of multiple scattering between microfacets is added back, so that a white metal stays
    // white however rough it is.
    vec2 reflectance = texture(u_reflectance, (vec2(n_v, roughness) * (REFLECTANCE_SIZE - 1.0) + 0.5) / REFLECTANCE_SIZE).rg;
    vec3 albedo = f0 * reflectance.x + reflectance.y;
    albedo *= gloss * (1.0 + f0 * (1.0 / (reflectance.x + reflectance.y) - 1.0));
    // The dominant reflection of a rough surface is nearer to its normal than that of a mirror (Lagarde, de Rousiers 2014).
    float alpha = roughness * roughness;
    vec3 from = mix(n, reflect(-v, n), (1.0 - alpha) * (sqrt(1.0 - alpha) + alpha));
    vec3 all_around = color * (1.0 - albedo) * ambient_light(n) + albedo * reflected_light(from, roughness);

    vec3 left;
    vec3 shine = highlight(n, v, to_sun.xyz, n_sun, n_v, f0, a2, left) * (gloss * n_sun * lit);
    vec3 result = all_around * s.occlusion + sun_and_ambient.rgb * (color * mix(vec3(1.0), left, gloss) * sun + shine) + s.emissive;
#ifdef POINT_LIGHTS
    for (int k = 0; k < POINT_LIGHTS; ++k) {
        vec3 l;
        vec3 strength = lamp(k, s.position, l);
        float n_l = max(dot(n, l), 0.0);
        vec3 glint = highlight(n, v, l, n_l, n_v, f0, a2, left) * gloss;
        result += strength * n_l * (color * mix(vec3(1.0), left, gloss) + glint);
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

// Applies the material maps to a surface whose fields hold the factors. Vertices have no tangents: these are computed from the screen-space
// derivatives of position and texture coordinates.
// use: scale of the normals, strength of the occlusion, weights of the maps of metallic and of roughness.
void apply_maps(inout Surface s, vec2 uv, vec4 use) {
    vec2 mixed = mix(vec2(1.0), texture(u_metallic_roughness_map, uv).bg, use.zw);
    s.metallic *= mixed.x;
    s.roughness *= mixed.y;
    s.emissive *= texture(u_emissive_map, uv).rgb;
    s.occlusion = mix(1.0, texture(u_occlusion_map, uv).r, use.y);
    vec3 bumped = texture(u_normal_map, uv).xyz * 2.0 - 1.0;
    bumped.xy *= use.x;
    vec3 px = dFdx(s.position), py = dFdy(s.position);
    vec2 tx = dFdx(uv), ty = dFdy(uv);
    float turn = tx.x * ty.y - ty.x * tx.y < 0.0 ? -1.0 : 1.0;
    vec3 right = (px * ty.y - py * tx.y) * turn, down = (py * tx.x - px * ty.x) * turn;
    right -= s.normal * dot(s.normal, right);
    down -= s.normal * dot(s.normal, down);
    right *= inversesqrt(max(dot(right, right), 1e-30));
    down *= inversesqrt(max(dot(down, down), 1e-30));
    s.normal = normalize(right * bumped.x - down * bumped.y + s.normal * max(bumped.z, 1e-3));
}
#endif
