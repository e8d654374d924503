#version 330
// Shared by floor and mesh; the same arithmetic as shading.py, which a test compares pixel by pixel.
uniform vec3 eye, right, up, back, centre, light;
uniform vec2 size, corner;
uniform float focal, ground, radius, cell, texel;
uniform sampler2D heights, floor_shadow;
uniform vec3 key_color, sky_color, bounce_color, rim_color, top_color, bottom_color, floor_color, line_color;
out vec4 color;

float fetch(sampler2D map, ivec2 at) { return texelFetch(map, at, 0).r; }

float bilinear(sampler2D map, vec2 at) {
    at -= 0.5;
    int last = textureSize(map, 0).x - 1;
    if (at.x < 0.0 || at.y < 0.0 || at.x >= float(last) || at.y >= float(last)) return 0.0;
    ivec2 i = ivec2(at);
    vec2 f = at - vec2(i);
    float upper = mix(fetch(map, i), fetch(map, i + ivec2(1, 0)), f.x);
    float lower = mix(fetch(map, i + ivec2(0, 1)), fetch(map, i + ivec2(1, 1)), f.x);
    return mix(upper, lower, f.y);
}

float occlusion(vec2 at, float height) {
    at -= 0.5;
    ivec2 i = ivec2(floor(at));
    int last = textureSize(heights, 0).x - 2;
    if (i.x < 1 || i.y < 1 || i.x >= last || i.y >= last) return 0.0;
    vec2 f = at - vec2(i);
    float total = 0.0;
    for (int dj = -1; dj < 3; dj++) {
        float wy = dj == -1 ? 1.0 - f.y : (dj == 2 ? f.y : 1.0);
        for (int di = -1; di < 3; di++) {
            float wx = di == -1 ? 1.0 - f.x : (di == 2 ? f.x : 1.0);
            if (fetch(heights, i + ivec2(di, dj)) > height) total += wx * wy;
        }
    }
    return total / 9.0;
}
