// A constraint set: boxes, or balls over vectors of `size` numbers, with bounds and a mask.
struct Set {
    vectors: u32,       // of the chunk
    size: u32,
    ball: u32,
    per_ray: u32,
    radius: f32,        // of all, if it is neither a pixel's nor that of a gap
    near: f32, far: f32,
    masks_last: u32,    // 0, or the samples of a ray, the last of which has no delta
    step: f32,          // of the search
    relative: u32,      // in radii
    stride: u32,        // numbers between the gradients of two vectors
    offset: u32,        // of the first
    gaussian: u32,
    chunk: u32,         // vectors of a chunk of the host, which has its own random numbers
    normals: u32,       // numbers of such a chunk
    first: u32,         // place of the first vector's chunk
    first_distance: u32,
    // Of a pixel: the first ray of the chunk, a pixel, and a part of the ray in lengths of its direction.
    ray0: u32, pixel: f32, cap: f32,
    // Of the gap to the nearer neighbour.
    kind: u32,          // 0 epsilon over a uniform density, 1 over the paper's density around, 2 reach
    share: f32,         // 0: of the nearer gap; 1: epsilon; 2: the largest part
    coarse: f32, drawn: f32, coarse_gap: f32,
    reach: f32,
}
@group(0) @binding(0) var<uniform> p: Set;
@group(0) @binding(1) var<storage, read_write> delta: array<f32>;
@group(0) @binding(2) var<storage, read> rays: array<f32>;
//#if BOUNDED
@group(0) @binding(3) var<storage, read> t_vals: array<f32>;
//#end
// Two roundings below 1.
const SHORT: f32 = 0.99999976158142;
fn radius_of(v: u32) -> f32 {
    //#if PIXEL
    return min(p.cap * rays[RAY * (p.ray0 + v / p.per_ray) + NORM], p.pixel);
    //#else
    //#if BOUNDED
    let k = v % p.per_ray;
    var before = 0.0;
    var after = 0.0;
    if (k > 0u) { before = t_vals[v] - t_vals[v - 1u]; }
    if (k + 1u < p.per_ray) { after = t_vals[v + 1u] - t_vals[v]; }
    if (k == 0u) { before = after; }
    if (k + 1u == p.per_ray) { after = before; }
    let nearer = min(before, after);
    if (p.kind == 0u) { return nearer * (p.share * SHORT); }
    if (p.kind == 2u) { return min(nearer * (p.share * SHORT), p.reach); }
    let coarse_share = min(0.5 * (before + after) / p.coarse_gap, 1.0);
    let density = coarse_share * (p.coarse - p.drawn) + p.drawn;
    return nearer * min(p.share / density, 0.5) * SHORT;
    //#else
    return p.radius;
    //#end
    //#end
}
fn low_of(v: u32) -> f32 {
    //#if BOUNDED
    return min(p.near - t_vals[v], 0.0);
    //#else
    return -3.4e38;
    //#end
}
fn high_of(v: u32) -> f32 {
    //#if BOUNDED
    return max(p.far - t_vals[v], 0.0);
    //#else
    return 3.4e38;
    //#end
}
fn masked(v: u32) -> bool { return p.masks_last > 0u && v % p.masks_last == p.masks_last - 1u; }
// What a thread has of the vectors: one, or of boxes (EACH) one number, so that neighbours read neighbours.
struct Own { v: u32, begin: u32, end: u32 }
fn own_of(thread: u32) -> Own {
    //#if EACH
    return Own(thread / p.size, thread % p.size, thread % p.size + 1u);
    //#else
    return Own(thread, 0u, p.size);
    //#end
}
// The nearest point of the set, in place.
fn project(own: Own) {
    let v = own.v;
    let radius = radius_of(v);
    if (p.ball == 1u) {
        var sum = 0.0;
        for (var c = 0u; c < p.size; c++) { sum += delta[v * p.size + c] * delta[v * p.size + c]; }
        let norm = sqrt(sum);
        if (norm > radius) { for (var c = 0u; c < p.size; c++) { delta[v * p.size + c] *= radius / norm; } }
    } else {
        for (var c = own.begin; c < own.end; c++) { delta[v * p.size + c] = clamp(delta[v * p.size + c], -radius, radius); }
    }
    //#if BOUNDED
    for (var c = own.begin; c < own.end; c++) { delta[v * p.size + c] = max(min(delta[v * p.size + c], high_of(v)), low_of(v)); }
    //#end
    if (masked(v)) { for (var c = own.begin; c < own.end; c++) { delta[v * p.size + c] = 0.0; } }
}
