// The fine pass's positions of one ray: the inverse of the CDF of its coarse weights. A group a ray.
// Sums are pairs (value, rest), as the host's are in f64.
struct Resample {
    coarse: u32,     // weights of a ray
    columns: u32,    // coarse positions of a ray
    fine: u32,       // new positions
    intervals: u32,  // 1: new edges from blurred weights; 0: new points, merged with the coarse ones
    padding: f32,    // added to each weight
    narrowest: f32,  // bins with at most this probability count as of width 1
    mode: u32,       // of u: 0 uniform, 1 uniform in equal parts, 2 evenly spaced
    rays: u32,
}
@group(0) @binding(0) var<uniform> p: Resample;
@group(0) @binding(1) var<storage, read> t_vals: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<f32>;
@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read_write> out: array<f32>;
var<workgroup> high: array<f32, {MOST}>;
var<workgroup> low: array<f32, {MOST}>;
var<workgroup> positions: array<f32, {MOST}>;

fn two_sum(a: vec2<f32>, b: f32) -> vec2<f32> {
    let sum = a.x + b;
    let back = sum - a.x;
    let rest = (a.x - (sum - back)) + (b - back) + a.y;
    let whole = sum + rest;
    return vec2<f32>(whole, rest - (whole - sum));
}
fn weight(ray: u32, i: u32) -> f32 { return weights[ray * p.coarse + i]; }
fn mass(ray: u32, bin: u32) -> f32 {
    if (p.intervals == 0u) { return weight(ray, bin + 1u) + p.padding; }
    let before = weight(ray, max(bin, 1u) - 1u);
    let here = weight(ray, bin);
    let behind = weight(ray, min(bin + 1u, p.coarse - 1u));
    return 0.5 * (max(before, here) + max(here, behind)) + p.padding;
}
fn edge(ray: u32, i: u32) -> f32 {
    let at = ray * p.columns + i;
    if (p.intervals == 1u) { return t_vals[at]; }
    return 0.5 * (t_vals[at] + t_vals[at + 1u]);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let ray = group.x + group.y * 65535u;
    if (ray >= p.rays) { return; }
    let bins = select(p.coarse - 2u, p.coarse, p.intervals == 1u);
    if (thread == 0u) {
        var sum = vec2<f32>(0.0);
        high[0] = 0.0; low[0] = 0.0;
        for (var i = 0u; i < bins; i++) {
            sum = two_sum(sum, mass(ray, i));
            high[i + 1u] = sum.x; low[i + 1u] = sum.y;
        }
    }
    workgroupBarrier();
    // In units of weights instead of probabilities: u times the total.
    let total = high[bins];
    let total_rest = low[bins];
    for (var j = thread; j < p.fine; j += 64u) {
        var share = 0.0;
        if (p.mode == 2u) { share = f32(j) / f32(max(p.fine, 2u) - 1u); } else { share = u[ray * p.fine + j]; }
        if (p.mode == 1u) { share = (share + f32(j)) / f32(p.fine); }
        let wanted = share * total;
        let rest = share * total_rest;
        // The number of ends at or below u.
        var begin = 0u;
        var to = bins + 1u;
        while (begin < to) {
            let middle = (begin + to) / 2u;
            if ((high[middle] - wanted) + (low[middle] - rest) <= 0.0) { begin = middle + 1u; } else { to = middle; }
        }
        let lower = max(begin, 1u) - 1u;
        let upper = min(begin, bins);
        let below = (wanted - high[lower]) + (rest - low[lower]);
        let width = (high[upper] - high[lower]) + (low[upper] - low[lower]);
        // Not below 0: at u = 1 there is no bin, and devices may take the smallest positive numbers as 0.
        let fraction = select(below / width, below / total, width <= p.narrowest * total);
        let start = edge(ray, lower);
        positions[j] = start + fraction * (edge(ray, upper) - start);
    }
    var count = p.fine;
    if (p.intervals == 0u) {
        for (var i = thread; i < p.coarse; i += 64u) { positions[p.fine + i] = t_vals[ray * p.columns + i]; }
        count += p.coarse;
    }
    workgroupBarrier();
    // Each position's rank. Equal ones keep their order.
    for (var j = thread; j < count; j += 64u) {
        let here = positions[j];
        var rank = 0u;
        for (var i = 0u; i < count; i++) {
            let other = positions[i];
            rank += select(0u, 1u, other < here || (other == here && i < j));
        }
        out[ray * count + rank] = here;
    }
}
