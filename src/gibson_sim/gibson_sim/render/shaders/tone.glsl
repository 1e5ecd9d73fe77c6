// Tone mapping of light-mapped surfaces. Included before scene.frag.
#ifdef LIGHT_MAP
// Compresses highlights: the curve of tone_map() in gibson_sim_tools/making/pixels.py, without its sRGB encoding. x (K + M / (x + 1)) is
// Reinhard's curve with the white point 4.2, times 1.06; it reaches 1 at WHITE. Divisions take most of the time: there are four.
const float K = 1.06 / (4.2 * 4.2), M = 1.06 - K, WHITE = 3.6105911;

vec3 tone(vec3 color) {
    float peak = max(max(color.r, color.g), color.b);
    vec3 x = min(color, WHITE);
    vec4 inverse = 1.0 / vec4(x + 1.0, peak < WHITE ? peak + 1.0 : peak);
    // 0.55 of the curve on the brightest channel, which keeps the hue, and 0.45 of that on each channel.
    float keeping_hue = peak < WHITE ? K + M * inverse.w : inverse.w;
    vec3 mixed = color * (0.55 * keeping_hue) + x * (0.45 * K + 0.45 * M * inverse.rgb);
    // More contrast in the middle tones: a polynomial in place of the curve on sRGB values, within 0.6 / 255 of it in sRGB.
    return mixed * ((((6.102349 - 2.0192976 * mixed) * mixed - 7.2489958) * mixed + 3.6778801) * mixed + 0.48905259);
}
#endif
