/* The loops of the software renderer: measuring, normals, shadows, rasterising and shading.

   reference.py says the same in numpy, and a test holds the two together; kernels.py describes the arguments. All
   arrays are contiguous, points and pixels come row by row, images have (height, width) first, and whole numbers that stand
   alone have 64 bits.
*/
#include <math.h>
#include <stdint.h>
#include <string.h>

#ifdef _WIN32
#define PUBLIC __declspec(dllexport)
#else
#define PUBLIC __attribute__((visibility("default")))
#endif

/* On Intel and AMD each loop is there twice, and the machine that loads it takes the one that it can run: the library may lie
   in a folder that others read. */
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__) && __GNUC__ >= 12
#define LOOP PUBLIC __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define LOOP PUBLIC
#endif

/* Four numbers at once, one for each sample of a pixel. */
typedef float four __attribute__((vector_size(16), aligned(4)));
typedef int32_t four_ids __attribute__((vector_size(16), aligned(4)));

/* So much beside its edge a face still covers a sample, as a share of the face: neighbours leave no gap. */
#define EDGE 1e-6f

static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }

/* Four samples a pixel on a rotated grid, as graphics cards place them. */
static const four SAMPLES_X = {0.375, 0.875, 0.125, 0.625};
static const four SAMPLES_Y = {0.125, 0.375, 0.625, 0.875};

LOOP void measure(int64_t count, const float *v, const double *axes, const double *slopes, float *bounds, double *support) {
    for (int i = 0; i < 3; i++) {
        bounds[i] = INFINITY;
        bounds[3 + i] = -INFINITY;
    }
    support[0] = support[2] = -INFINITY;
    support[1] = support[3] = INFINITY;
    for (int64_t n = 0; n < count; n++, v += 3) {
        double at[3];
        for (int i = 0; i < 3; i++) {
            bounds[i] = v[i] < bounds[i] ? v[i] : bounds[i];
            bounds[3 + i] = v[i] > bounds[3 + i] ? v[i] : bounds[3 + i];
            at[i] = axes[3 * i] * v[0] + axes[3 * i + 1] * v[1] + axes[3 * i + 2] * v[2];
        }
        support[0] = most(support[0], at[0] + slopes[0] * at[2]);
        support[1] = least(support[1], at[0] - slopes[0] * at[2]);
        support[2] = most(support[2], at[1] + slopes[1] * at[2]);
        support[3] = least(support[3], at[1] - slopes[2] * at[2]);
    }
}

LOOP void accumulate_normals(
    const float *v, int64_t face_count, const int32_t *faces, const int32_t *clusters, int64_t count, float *out
) {
    memset(out, 0, 3 * count * sizeof(float));
    for (int64_t f = 0; f < face_count; f++, faces += 3, clusters += 3) {
        const float *a = v + 3 * (int64_t)faces[0], *b = v + 3 * (int64_t)faces[1], *c = v + 3 * (int64_t)faces[2];
        float ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2];
        float vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2];
        float nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
        for (int corner = 0; corner < 3; corner++) {
            float *n = out + 3 * (int64_t)clusters[corner];
            n[0] += nx;
            n[1] += ny;
            n[2] += nz;
        }
    }
    for (int64_t k = 0; k < count; k++, out += 3) {
        float length = sqrtf(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
        if (length > 0) {
            out[0] /= length;
            out[1] /= length;
            out[2] /= length;
        } else {
            out[1] = 1;
        }
    }
}

LOOP void project(
    int64_t count, const float *v, const double *axes, const double *eye, double focal, int64_t width, int64_t height,
    float *out
) {
    for (int64_t n = 0; n < count; n++, v += 3, out += 3) {
        double px = v[0] - eye[0], py = v[1] - eye[1], pz = v[2] - eye[2];
        double z = -(axes[6] * px + axes[7] * py + axes[8] * pz);
        if (z > 1e-6) {
            double near = 1 / z;
            out[0] = (float)(0.5 * width + focal * near * (axes[0] * px + axes[1] * py + axes[2] * pz));
            out[1] = (float)(0.5 * height - focal * near * (axes[3] * px + axes[4] * py + axes[5] * pz));
            out[2] = (float)near;
        } else {
            out[0] = out[1] = out[2] = 0;
        }
    }
}

LOOP void rasterise(
    const float *screen, int64_t face_count, const int32_t *faces, int64_t width, int64_t height, float *depth,
    int32_t *ids, int32_t *window
) {
    int32_t first_x = (int32_t)width, first_y = (int32_t)height, last_x = 0, last_y = 0;
    for (int64_t f = 0; f < face_count; f++, faces += 3) {
        const float *a = screen + 3 * (int64_t)faces[0], *b = screen + 3 * (int64_t)faces[1], *c = screen + 3 * (int64_t)faces[2];
        if (a[2] <= 0 || b[2] <= 0 || c[2] <= 0) continue;
        double ax = a[0], ay = a[1], bx = b[0] - ax, by = b[1] - ay, cx = c[0] - ax, cy = c[1] - ay;
        double area = bx * cy - by * cx;
        if (area == 0) continue;
        double left = ax + least(0, least(bx, cx)), right = ax + most(0, most(bx, cx));
        double top = ay + least(0, least(by, cy)), bottom = ay + most(0, most(by, cy));
        if (right < 0 || bottom < 0 || left >= width || top >= height) continue;
        /* Samples lie between 1/8 and 7/8 of a pixel. */
        int32_t x0 = (int32_t)most(left + 0.125, 0), x1 = (int32_t)least(right - 0.125, width - 1.0);
        int32_t y0 = (int32_t)most(top + 0.125, 0), y1 = (int32_t)least(bottom - 0.125, height - 1.0);
        if (right - 0.125 < 0 || bottom - 0.125 < 0 || x1 < x0 || y1 < y0) continue;
        if (x0 < first_x) first_x = x0;
        if (y0 < first_y) first_y = y0;
        if (x1 >= last_x) last_x = x1 + 1;
        if (y1 >= last_y) last_y = y1 + 1;
        double share = 1 / area;
        double ux = cy * share, uy = -cx * share, vx = -by * share, vy = bx * share;
        four step_u = (float)ux * SAMPLES_X + (float)uy * SAMPLES_Y, step_v = (float)vx * SAMPLES_X + (float)vy * SAMPLES_Y;
        /* How far a pixel's samples reach inside each edge, seen from its corner: a whole pixel outside is skipped at once. */
        double reach_u = 0.875 * (most(ux, 0) + most(uy, 0));
        double reach_v = 0.875 * (most(vx, 0) + most(vy, 0));
        double reach_w = 1 + 0.875 * (most(-ux - vx, 0) + most(-uy - vy, 0));
        float za = a[2], zb = b[2] - za, zc = c[2] - za;
        for (int32_t y = y0; y <= y1; y++) {
            double row_u = ux * (x0 - ax) + uy * (y - ay), row_v = vx * (x0 - ax) + vy * (y - ay);
            float *near = depth + 4 * ((int64_t)y * width + x0);
            int32_t *seen = ids + 4 * ((int64_t)y * width + x0);
            for (int32_t x = x0; x <= x1; x++, row_u += ux, row_v += vx, near += 4, seen += 4) {
                if (row_u + reach_u < 0 || row_v + reach_v < 0 || row_u + row_v > reach_w) continue;
                four u = (float)row_u + step_u, w = (float)row_v + step_v, z = za + u * zb + w * zc, kept = *(four *)near;
                four_ids covered = (u >= -EDGE) & (w >= -EDGE) & (u + w <= 1 + EDGE) & (z > kept);
                four_ids *face = (four_ids *)seen;
                *(four_ids *)near = (covered & (four_ids)z) | (~covered & (four_ids)kept);
                *face = (covered & (int32_t)f) | (~covered & *face);
            }
        }
    }
    window[0] = first_x;
    window[1] = first_y;
    window[2] = last_x;
    window[3] = last_y;
}

LOOP void drop_shadow(
    const float *v, int64_t face_count, const int32_t *faces, double slope_x, double slope_z, double ground,
    double left, double near, double texel, int64_t lowest, int64_t size, float *heights
) {
    double share = 1 / texel;
    for (int64_t f = 0; f < face_count; f++, faces += 3) {
        const float *a = v + 3 * (int64_t)faces[0], *b = v + 3 * (int64_t)faces[1], *c = v + 3 * (int64_t)faces[2];
        double ha = a[1] - ground, hb = b[1] - ground, hc = c[1] - ground;
        double ax = (a[0] - slope_x * ha - left) * share, ay = (a[2] - slope_z * ha - near) * share;
        double bx = (b[0] - slope_x * hb - left) * share - ax, by = (b[2] - slope_z * hb - near) * share - ay;
        double cx = (c[0] - slope_x * hc - left) * share - ax, cy = (c[2] - slope_z * hc - near) * share - ay;
        double area = bx * cy - by * cx;
        if (area == 0) continue;
        int32_t x0 = (int32_t)ceil(least(most(ax + least(0, least(bx, cx)) - 0.5, 0), size));
        int32_t x1 = (int32_t)floor(most(least(ax + most(0, most(bx, cx)) - 0.5, size - 1.0), -1));
        int32_t y0 = (int32_t)ceil(least(most(ay + least(0, least(by, cy)) - 0.5, 0), size));
        int32_t y1 = (int32_t)floor(most(least(ay + most(0, most(by, cy)) - 0.5, size - 1.0), -1));
        if (x1 < x0 || y1 < y0) continue;
        double ux = cy / area, uy = -cx / area, vx = -by / area, vy = bx / area;
        for (int32_t y = y0; y <= y1; y++) {
            for (int32_t x = x0; x <= x1; x++) {
                double px = x + 0.5 - ax, py = y + 0.5 - ay;
                double u = ux * px + uy * py, w = vx * px + vy * py;
                if (u >= 0 && w >= 0 && u + w <= 1) {
                    float h = (float)(ha + u * (hb - ha) + w * (hc - ha)), *kept = heights + (int64_t)y * size + x;
                    if (lowest) {
                        h = h > 0 ? h : 0;
                        *kept = h < *kept ? h : *kept;
                    } else {
                        *kept = h > *kept ? h : *kept;
                    }
                }
            }
        }
    }
}

/* Mean over a square of odd `width`, zero outside the image; `sums` holds `size` numbers and `scratch` an image. */
LOOP void box(int64_t size, int64_t width, const float *image, float *out, float *scratch, double *sums) {
    int64_t half = width / 2;
    double share = 1.0 / width;
    for (int64_t y = 0; y < size; y++) {
        const float *row = image + y * size;
        double sum = 0;
        for (int64_t x = 0; x < half && x < size; x++) sum += row[x];
        for (int64_t x = 0; x < size; x++) {
            sum += x + half < size ? row[x + half] : 0;
            scratch[y * size + x] = (float)(sum * share);
            sum -= x >= half ? row[x - half] : 0;
        }
    }
    for (int64_t x = 0; x < size; x++) sums[x] = 0;
    for (int64_t y = -half; y < size; y++) {
        if (y + half < size)
            for (int64_t x = 0; x < size; x++) sums[x] += scratch[(y + half) * size + x];
        if (y < 0) continue;
        for (int64_t x = 0; x < size; x++) out[y * size + x] = (float)(sums[x] * share);
        if (y >= half)
            for (int64_t x = 0; x < size; x++) sums[x] -= scratch[(y - half) * size + x];
    }
}

/* Share of a pixel of this footprint that grid lines at multiples of `cell` cover. */
static inline double line(double position, double cell, double per_cell, double width, double footprint) {
    double at = position * per_cell;
    double distance = fabs(at - (double)(int64_t)(at + (at < 0 ? -0.5 : 0.5))) * cell;
    double blur = least(most(2.5 * footprint * per_cell - 0.5, 0), 1);
    double inside = 0.5 * (width + footprint) - distance, share = 0;
    if (inside > 0) {
        footprint = most(footprint, 1e-9);
        share = least(inside / least(width, footprint), 1) * least(1, width / footprint);
    }
    return share + (width * per_cell - share) * blur;
}

LOOP void draw_grid(
    int64_t width, int64_t height, const float *floor_, const double *offset, double cell, double thickness,
    const double *color, float *base, uint8_t *plain
) {
    double per_cell = 1 / cell;
    for (int64_t n = width * height; n > 0; n--, floor_ += 5, base += 3, plain += 3) {
        if (floor_[4] <= 0) continue;
        double across = line(floor_[0] + offset[0], cell, per_cell, thickness, floor_[2]);
        double along = line(floor_[1] + offset[1], cell, per_cell, thickness, floor_[3]);
        double cover = floor_[4] * most(across, along);
        if (cover <= 0) continue;
        for (int i = 0; i < 3; i++) {
            base[i] += (float)((color[i] - base[i]) * cover);
            plain[i] = (uint8_t)(255 * base[i] + 0.5f);
        }
    }
}

static inline double bilinear(const float *image, int64_t size, double x, double y) {
    x -= 0.5;
    y -= 0.5;
    if (!(x >= 0 && y >= 0 && x < size - 1 && y < size - 1)) return 0;
    int32_t i = (int32_t)x, j = (int32_t)y;
    double fx = x - i, fy = y - j;
    const float *at = image + (int64_t)j * size + i;
    double upper = at[0] + (at[1] - at[0]) * fx, lower = at[size] + (at[size + 1] - at[size]) * fx;
    return upper + (lower - upper) * fy;
}

/* Share of 3 x 3 texels around (x, y) where something stands higher than `height` in the way of the light. */
static inline double occlusion(const float *heights, int64_t size, double x, double y, double height) {
    x -= 0.5;
    y -= 0.5;
    if (!(x >= 1 && y >= 1 && x < size - 2 && y < size - 2)) return 0;
    int32_t i = (int32_t)x, j = (int32_t)y;
    double wx[4] = {1 - (x - i), 1, 1, x - i}, wy[4] = {1 - (y - j), 1, 1, y - j}, total = 0;
    for (int dj = 0; dj < 4; dj++) {
        const float *row = heights + (int64_t)(j + dj - 1) * size + i - 1;
        double sum = 0;
        for (int di = 0; di < 4; di++) sum += row[di] > height ? wx[di] : 0;
        total += sum * wy[dj];
    }
    return total / 9;
}

/* Whether two faces share a point: no crease parts them there, and one shading serves both within a pixel. */
static inline int touch(const int32_t *f, const int32_t *g) {
    for (int i = 0; i < 3; i++)
        if (f[i] == g[0] || f[i] == g[1] || f[i] == g[2]) return 1;
    return 0;
}

LOOP void shade(
    int64_t width, int64_t height, const int32_t *window, const float *screen, const int32_t *faces,
    const float *points, const float *normals, const float *colors, const int32_t *ids, const float *base,
    const double *axes, const double *eye, double focal, double ground, const double *light, const double *lights,
    const float *heights, const float *floor_shadow, int64_t texels, double left, double near, double texel,
    const float *encode, int64_t steps, uint8_t *out
) {
    double slope_x = light[0] / light[1], slope_z = light[2] / light[1], per_texel = 1 / texel;
    for (int32_t y = window[1]; y < window[3]; y++) {
        double sy = (0.5 * height - y - 0.5) / focal;
        for (int32_t x = window[0]; x < window[2]; x++) {
            int64_t pixel = (int64_t)y * width + x;
            const int32_t *found = ids + 4 * pixel;
            double tint[4][3], sum[3] = {0, 0, 0};
            int shadowless = 0; /* a pixel of the backdrop alone, which is drawn already */
            for (int s = 0; s < 4 && !shadowless; s++) {
                int32_t f = found[s];
                int seen = -1;
                for (int e = 0; e < s && seen < 0; e++)
                    if (found[e] == f || (f >= 0 && found[e] >= 0 && touch(faces + 3 * (int64_t)f, faces + 3 * (int64_t)found[e])))
                        seen = e;
                if (seen >= 0) {
                    for (int i = 0; i < 3; i++) tint[s][i] = tint[seen][i];
                } else if (f < 0) {
                    double dark = 0, sx = (x + 0.5 - 0.5 * width) / focal;
                    double dy = axes[1] * sx + axes[4] * sy - axes[7], t = dy < -1e-4 ? (ground - eye[1]) / dy : 0;
                    if (t > 0) {
                        double px = eye[0] + t * (axes[0] * sx + axes[3] * sy - axes[6]);
                        double pz = eye[2] + t * (axes[2] * sx + axes[5] * sy - axes[8]);
                        dark = bilinear(floor_shadow, texels, (px - left) * per_texel, (pz - near) * per_texel);
                    }
                    shadowless = dark == 0 && s == 0 && found[1] < 0 && found[2] < 0 && found[3] < 0;
                    for (int i = 0; i < 3; i++) tint[s][i] = base[3 * pixel + i] * (1 - dark);
                } else {
                    int64_t a = 3 * (int64_t)faces[3 * (int64_t)f], b = 3 * (int64_t)faces[3 * (int64_t)f + 1];
                    int64_t c = 3 * (int64_t)faces[3 * (int64_t)f + 2];
                    double ax = screen[a], ay = screen[a + 1], bx = screen[b] - ax, by = screen[b + 1] - ay;
                    double cx = screen[c] - ax, cy = screen[c + 1] - ay, area = bx * cy - by * cx;
                    double px = x + 0.5 - ax, py = y + 0.5 - ay;
                    double v = least(most((cy * px - cx * py) / area, 0), 1);
                    double w = least(most((bx * py - by * px) / area, 0), 1 - v);
                    double u = (1 - v - w) * screen[a + 2];
                    v *= screen[b + 2];
                    w *= screen[c + 2];
                    double total = 1 / (u + v + w);
                    u *= total;
                    v *= total;
                    w *= total;
                    double n[3], q[3], e[3], length = 0, away = 0, half = 0, facing = 0, toward = 0, gloss = 0;
                    for (int i = 0; i < 3; i++) {
                        n[i] = u * normals[a + i] + v * normals[b + i] + w * normals[c + i];
                        q[i] = u * points[a + i] + v * points[b + i] + w * points[c + i];
                        e[i] = eye[i] - q[i];
                        length += n[i] * n[i];
                        away += e[i] * e[i];
                    }
                    /* Rows grow downwards, so a face turned to the viewer has a negative area here. */
                    length = length > 0 ? 1 / sqrt(length) : 1;
                    length = area < 0 ? length : -length;
                    away = 1 / sqrt(away);
                    for (int i = 0; i < 3; i++) {
                        n[i] *= length;
                        e[i] *= away;
                        facing += n[i] * light[i];
                        toward += n[i] * e[i];
                        half += (e[i] + light[i]) * (e[i] + light[i]);
                        gloss += n[i] * (e[i] + light[i]);
                    }
                    double rise = q[1] - ground;
                    /* The bias grows where the light grazes the surface; lifting along the normal keeps creases clean. */
                    double lift = texel * (1.5 + 2.5 * (1 - most(facing, 0)));
                    double hidden = occlusion(
                        heights, texels, (q[0] + n[0] * lift - slope_x * (rise + n[1] * lift) - left) * per_texel,
                        (q[2] + n[2] * lift - slope_z * (rise + n[1] * lift) - near) * per_texel,
                        rise + n[1] * lift + 1.5 * texel
                    );
                    double key = most((facing + 0.2) / 1.2, 0) * (1 - 0.7 * hidden), sky = 0.5 + 0.5 * n[1];
                    double grazing = 1 - most(toward, 0), rim = grazing * grazing * grazing * sky;
                    gloss = most(gloss / sqrt(half), 0);
                    gloss *= gloss;
                    gloss *= gloss;
                    gloss *= gloss;
                    gloss = 0.05 * gloss * gloss * (1 - hidden);
                    for (int i = 0; i < 3; i++) {
                        double albedo = u * colors[a + i] + v * colors[b + i] + w * colors[c + i];
                        double value = albedo * (lights[i] * key + lights[3 + i] * sky + lights[6 + i] * (1 - sky));
                        value += lights[9 + i] * rim + gloss;
                        tint[s][i] = encode[(int32_t)(least(most(0.5 * value, 0), 1) * steps + 0.5)];
                    }
                }
                for (int i = 0; i < 3; i++) sum[i] += tint[s][i];
            }
            if (shadowless) continue;
            for (int i = 0; i < 3; i++) out[3 * pixel + i] = (uint8_t)(least(most(sum[i] * 63.75, 0), 255) + 0.5);
        }
    }
}
