// The radius of the set of t: a part of the gap to the nearer neighbour. A thread a position.
struct TRadius {
    rays: u32, columns: u32,
    kind: u32,          // 0 epsilon over a uniform density, 1 over the paper's density around, 2 reach
    share: f32,         // 0: of the nearer gap; 1: epsilon; 2: the largest part
    coarse: f32, drawn: f32, coarse_gap: f32,
    reach: f32,
}
@group(0) @binding(0) var<uniform> p: TRadius;
@group(0) @binding(1) var<storage, read> t_vals: array<f32>;
@group(0) @binding(2) var<storage, read_write> radius: array<f32>;
// Two roundings below 1.
const SHORT: f32 = 0.99999976158142;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.rays * p.columns) { return; }
    let k = i % p.columns;
    var before = 0.0;
    var after = 0.0;
    if (k > 0u) { before = t_vals[i] - t_vals[i - 1u]; }
    if (k + 1u < p.columns) { after = t_vals[i + 1u] - t_vals[i]; }
    if (k == 0u) { before = after; }
    if (k + 1u == p.columns) { after = before; }
    let nearer = min(before, after);
    if (p.kind == 0u) { radius[i] = nearer * (p.share * SHORT); }
    if (p.kind == 1u) {
        let coarse_share = min(0.5 * (before + after) / p.coarse_gap, 1.0);
        let density = coarse_share * (p.coarse - p.drawn) + p.drawn;
        radius[i] = nearer * min(p.share / density, 0.5) * SHORT;
    }
    if (p.kind == 2u) { radius[i] = min(nearer * (p.share * SHORT), p.reach); }
}
