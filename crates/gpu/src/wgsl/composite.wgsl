// Emission and absorption along a ray, its loss, and the way back. A thread a ray.
struct Composite {
    rays: u32, samples: u32, columns: u32, ray0: u32,
    background: vec3<f32>, has_background: u32,
    weight: f32,        // of the squared error of a channel: weight of the loss / (3 rays)
    near: f32, far: f32,
    share: f32,         // of near..far, in which occlusion counts density
    // Weights of terms / rays.
    distortion: f32, occlusion: f32, entropy: f32, cauchy: f32,
    opacity_prior: f32,
}
@group(0) @binding(0) var<uniform> p: Composite;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> t_vals: array<f32>;
@group(0) @binding(3) var<storage, read> values: array<f32>;           // [points, 4] colour and density
@group(0) @binding(4) var<storage, read_write> weights: array<f32>;    // [points]
// [all rays, OUT] colour, depth, accumulation, squared error, noiseless accumulation, terms in the order of their weights
@group(0) @binding(5) var<storage, read_write> out: array<f32>;
//#if BACK
@group(0) @binding(6) var<storage, read_write> before: array<f32>;     // [points] transmittance
@group(0) @binding(7) var<storage, read_write> d_values: array<f32>;   // [points, 4]
@group(0) @binding(8) var<storage, read_write> d_t: array<f32>;        // [rays, columns]
//#end
const LAST_INTERVAL: f32 = 1e10;
const LOG2_E: f32 = 1.4426950408889634;
fn gap_of(at: u32, k: u32) -> f32 {
    if (k + 1u < p.columns) { return t_vals[at + 1u] - t_vals[at]; }
    return LAST_INTERVAL;
}
// An end of an interval, 0..1 between near and far.
fn end(ray: u32, k: u32) -> f32 {
    if (k >= p.columns) { return 1.0; }
    return (t_vals[ray * p.columns + k] - p.near) / (p.far - p.near);
}
//#if ENTROPY
const LEAST_ACC: f32 = 0.1;
const TINY: f32 = 1e-10;
// 1 - exp(-x), to rounding.
fn opacity(x: f32) -> f32 {
    return select(1.0 - exp(-x), x * (1.0 - 0.5 * x * (1.0 - x / 3.0)), x < 0.01);
}
// The gap behind a last point has no end.
fn has_end(k: u32) -> bool { return k + 1u < p.columns; }
//#end
@compute @workgroup_size(32)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.x;
    if (ray >= p.rays) { return; }
    let all = p.ray0 + ray;
    let norm = rays[RAY * all + NORM];
    let start = ray * p.samples;
    var passed = 0.0;                                                  // optical depth
    var colour = vec3<f32>(0.0);
    var acc = 0.0;
    var depth = 0.0;
    //#if ENTROPY
    var opacities = TINY;
    var stopped = 0.0;
    //#end
    for (var k = 0u; k < p.samples; k++) {
        let i = start + k;
        let at = ray * p.columns + k;
        let optical = values[4u * i + 3u] * (gap_of(at, k) * norm);
        let transmitted = exp(-passed);
        let weight = transmitted * (1.0 - exp(-optical));
        weights[i] = weight;
        //#if BACK
        before[i] = transmitted;
        //#end
        colour += weight * vec3<f32>(values[4u * i], values[4u * i + 1u], values[4u * i + 2u]);
        acc += weight;
        var t = t_vals[at];
        if (p.columns > p.samples) { t = 0.5 * (t + t_vals[at + 1u]); }
        depth += weight * t;
        passed += optical;
        //#if ENTROPY
        if (has_end(k)) {
            opacities += opacity(optical);
            stopped += weight;
        }
        //#end
    }
    if (p.has_background == 1u) { colour += (1.0 - acc) * p.background; }
    let error = colour - ray_vector(all, TARGET);
    out[OUT * all] = colour.x; out[OUT * all + 1u] = colour.y; out[OUT * all + 2u] = colour.z;
    out[OUT * all + 3u] = depth; out[OUT * all + 4u] = acc; out[OUT * all + 5u] = dot(error, error);
    out[OUT * all + 6u] = acc;
    //#if BACK
    let d = error * (2.0 * p.weight);
    //#if DISTORTION
    var mass = 0.0;
    var moment = 0.0;
    for (var k = 0u; k < p.samples; k++) {
        let w = weights[start + k];
        mass += w;
        moment += w * (0.5 * (end(ray, k) + end(ray, k + 1u)));
    }
    var mass_behind = 0.0;
    var moment_behind = 0.0;
    var spread = 0.0;
    //#end
    //#if ENTROPY
    // -sum of p log2(p), and the mean over p of its slope in p.
    var bits = 0.0;
    var mean_slope = 0.0;
    let has_entropy = stopped > LEAST_ACC;
    if (has_entropy) {
        for (var k = 0u; k < p.samples; k++) {
            if (has_end(k)) {
                let gap = gap_of(ray * p.columns + k, k);
                let stops = opacity(values[4u * (start + k) + 3u] * (gap * norm)) / opacities;
                let log_of = log2(stops + TINY);
                bits -= stops * log_of;
                mean_slope -= stops * (log_of + stops / (stops + TINY) * LOG2_E);
            }
        }
    }
    //#end
    //#if OCCLUSION
    var occluded = 0.0;
    //#end
    //#if CAUCHY
    var sparsity = 0.0;
    //#end
    //#if OPACITY_PRIOR
    // log((0.1 + acc) (1.1 - acc) / 0.11), precisely where nearly all light is stopped.
    let left = exp(-passed);
    let half_way = left * (1.0 - left);
    let d_acc = p.opacity_prior * (2.0 * left - 1.0) / (0.11 + half_way);
    //#end
    // What lies behind a sample, seen from it. 1 - acc shows the background.
    var of_background = 0.0;
    if (p.has_background == 1u) { of_background = dot(d, p.background); }
    var behind = 0.0;
    for (var j = 0u; j < p.samples; j++) {
        let k = p.samples - 1u - j;
        let i = start + k;
        let at = ray * p.columns + k;
        let gap = gap_of(at, k);
        let interval = gap * norm;
        let density = values[4u * i + 3u];
        let optical = density * interval;
        let shown = vec3<f32>(values[4u * i], values[4u * i + 1u], values[4u * i + 2u]);
        let weight = weights[i];
        var d_weight = dot(d, shown) - of_background;
        //#if DISTORTION
        let from_end = end(ray, k);
        let to_end = end(ray, k + 1u);
        let middle = 0.5 * (from_end + to_end);
        let mass_before = mass - mass_behind - weight;
        let moment_before = moment - moment_behind - weight * middle;
        let around = (middle * mass_before - moment_before) + (moment_behind - middle * mass_behind);
        spread += weight * around + weight * weight * (to_end - from_end) / 3.0;
        d_weight += p.distortion * (2.0 * around + 2.0 / 3.0 * weight * (to_end - from_end));
        mass_behind += weight;
        moment_behind += weight * middle;
        //#end
        //#if OPACITY_PRIOR
        d_weight += d_acc;
        //#end
        let d_optical = before[i] * exp(-optical) * d_weight - behind;
        behind += weight * d_weight;
        d_values[4u * i] = weight * d.x; d_values[4u * i + 1u] = weight * d.y; d_values[4u * i + 2u] = weight * d.z;
        var d_density = d_optical * interval;
        //#if ENTROPY
        if (has_entropy && has_end(k)) {
            let stops = opacity(optical) / opacities;
            let slope = -(log2(stops + TINY) + stops / (stops + TINY) * LOG2_E);
            d_density += p.entropy * (slope - mean_slope) / opacities * exp(-optical) * interval;
        }
        //#end
        //#if OCCLUSION
        let inside = clamp(end(ray, k + 1u), 0.0, p.share) - clamp(end(ray, k), 0.0, p.share);
        occluded += density * inside;
        d_density += p.occlusion * inside;
        //#end
        //#if CAUCHY
        let square = 1.0 + 2.0 * density * density;
        sparsity += log(square) / f32(p.samples);
        d_density += p.cauchy * 4.0 * density / (square * f32(p.samples));
        //#end
        d_values[4u * i + 3u] = d_density;
        // The gap to the next position grows with that one and shrinks with this one.
        var d_gap = d_optical * density * norm;
        if (k + 1u >= p.columns) { d_gap = 0.0; }
        if (j == 0u) {
            if (p.columns > p.samples) { d_t[at + 1u] = d_gap; }
        } else {
            d_t[at + 1u] += d_gap;
        }
        d_t[at] = -d_gap;
    }
    //#if DISTORTION
    out[OUT * all + 7u] = spread;
    //#end
    //#if OCCLUSION
    out[OUT * all + 8u] = occluded;
    //#end
    //#if ENTROPY
    out[OUT * all + 9u] = bits;
    //#end
    //#if CAUCHY
    out[OUT * all + 10u] = sparsity;
    //#end
    //#if OPACITY_PRIOR
    out[OUT * all + 11u] = log(1.0 + half_way / 0.11);
    //#end
    //#end
}
