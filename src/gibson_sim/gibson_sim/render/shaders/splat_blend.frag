// Composites the splats over the picture.
uniform sampler2D u_splats;  // premultiplied, sRGB
layout(location = 0) out vec4 out_color;

void main() {
    out_color = texelFetch(u_splats, ivec2(gl_FragCoord.xy), 0);
}
