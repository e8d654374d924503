
float grid_line(float position, float width, float footprint) {
    float distance = abs(position / cell - floor(position / cell + 0.5)) * cell;
    footprint = max(footprint, 1e-9);
    float near = (0.5 * (width + footprint) - distance) / min(width, footprint);
    float share = clamp(near, 0.0, 1.0) * min(1.0, width / footprint);
    return mix(share, width / cell, clamp(2.5 * footprint / cell - 0.5, 0.0, 1.0));
}

void main() {
    vec2 s = (gl_FragCoord.xy - 0.5 * size) / focal;
    vec3 d = right * s.x + up * s.y - back;
    float fade = 0.0, cover = 0.0, dark = 0.0;
    if (d.y < -1e-4) {
        float t = (ground - eye.y) / d.y;
        vec3 p = eye + t * d;
        if (t > 0.0) {
            dark = bilinear(floor_shadow, (p.xz - corner) / texel);
            float r = length(p.xz - centre.xz) / radius;
            if (r < 1.0) {
                fade = (1.0 - r * r) * (1.0 - r * r);
                vec2 across = abs(t / focal * (right.xz - right.y / d.y * d.xz)) + abs(t / focal * (up.xz - up.y / d.y * d.xz));
                float width = LINE_WIDTH * cell;
                cover = max(grid_line(p.x, width, across.x), grid_line(p.z, width, across.y));
            }
        }
    }
    vec3 value = mix(top_color, bottom_color, 1.0 - gl_FragCoord.y / size.y);
    value = mix(value, floor_color, fade);
    value = mix(value, line_color, cover * fade);
    color = vec4(value * (1.0 - dark), 1.0);
}
