// Shades a Gaussian; the output is premultiplied.
in vec2 v_at;
flat in vec4 v_color;
layout(location = 0) out vec4 out_color;

void main() {
    float alpha = min(0.99, v_color.a * exp(-0.5 * dot(v_at, v_at)));
    if (alpha < 1.0 / 255.0) discard;
    out_color = vec4(v_color.rgb * alpha, alpha);
}
