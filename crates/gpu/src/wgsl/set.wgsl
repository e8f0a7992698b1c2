// A constraint set: boxes, or balls over vectors of `size` numbers, with bounds and a mask.
struct Set {
    vectors: u32,       // of the chunk
    size: u32,
    ball: u32,
    radius_every: u32,  // vectors that share a radius; 0: `radius` for all
    radius: f32,
    bounded: u32,       // within near - t and far - t
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
    pad0: u32, pad1: u32,
}
@group(0) @binding(0) var<uniform> p: Set;
@group(0) @binding(1) var<storage, read_write> delta: array<f32>;
//#if RADII
@group(0) @binding(2) var<storage, read> radii: array<f32>;
//#end
//#if BOUNDED
@group(0) @binding(3) var<storage, read> t_vals: array<f32>;
//#end
fn radius_of(v: u32) -> f32 {
    //#if RADII
    return radii[v / p.radius_every];
    //#else
    return p.radius;
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
// The nearest point of the set, in place.
fn project(v: u32) {
    let radius = radius_of(v);
    if (p.ball == 1u) {
        var sum = 0.0;
        for (var c = 0u; c < p.size; c++) { sum += delta[v * p.size + c] * delta[v * p.size + c]; }
        let norm = sqrt(sum);
        if (norm > radius) { for (var c = 0u; c < p.size; c++) { delta[v * p.size + c] *= radius / norm; } }
    } else {
        for (var c = 0u; c < p.size; c++) { delta[v * p.size + c] = clamp(delta[v * p.size + c], -radius, radius); }
    }
    //#if BOUNDED
    for (var c = 0u; c < p.size; c++) { delta[v * p.size + c] = max(min(delta[v * p.size + c], high_of(v)), low_of(v)); }
    //#end
    if (masked(v)) { for (var c = 0u; c < p.size; c++) { delta[v * p.size + c] = 0.0; } }
}
