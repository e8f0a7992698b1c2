// Emission and absorption along a ray, its loss, and the way back. A group a ray.
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
// [points, 4]; between two loops, density's place has the gradient of the weight
@group(0) @binding(7) var<storage, read_write> d_values: array<f32>;
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
fn optical_depth(ray: u32, k: u32, norm: f32) -> f32 {
    return values[4u * (ray * p.samples + k) + 3u] * (gap_of(ray * p.columns + k, k) * norm);
}
@compute @workgroup_size(32)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let ray = group.x + group.y * 65535u;
    if (ray >= p.rays) { return; }
    let all = p.ray0 + ray;
    let norm = rays[RAY * all + NORM];
    let start = ray * p.samples;
    let run = run_of(thread, p.samples);
    var own = 0.0;
    for (var k = run.x; k < run.y; k++) { own += optical_depth(ray, k, norm); }
    let optical_depths = around(thread, vec4<f32>(own));
    var passed = optical_depths.before.x;
    // Colour and accumulation, and depth, the opacities of intervals with an end, and what these stop.
    var stops_of_run = vec4<f32>(0.0);
    var further = vec4<f32>(0.0);
    for (var k = run.x; k < run.y; k++) {
        let i = start + k;
        let at = ray * p.columns + k;
        let optical = optical_depth(ray, k, norm);
        let transmitted = exp(-passed);
        let weight = transmitted * (1.0 - exp(-optical));
        weights[i] = weight;
        //#if BACK
        before[i] = transmitted;
        //#end
        stops_of_run += weight * vec4<f32>(values[4u * i], values[4u * i + 1u], values[4u * i + 2u], 1.0);
        var t = t_vals[at];
        if (p.columns > p.samples) { t = 0.5 * (t + t_vals[at + 1u]); }
        further.x += weight * t;
        passed += optical;
        //#if ENTROPY
        if (has_end(k)) { further += vec4<f32>(0.0, opacity(optical), weight, 0.0); }
        //#end
    }
    let stopped_light = total(thread, stops_of_run);
    let of_ray = total(thread, further);
    let acc = stopped_light.w;
    var colour = stopped_light.xyz;
    if (p.has_background == 1u) { colour += (1.0 - acc) * p.background; }
    let error = colour - ray_vector(all, TARGET);
    if (thread == 0u) {
        out[OUT * all] = colour.x; out[OUT * all + 1u] = colour.y; out[OUT * all + 2u] = colour.z;
        out[OUT * all + 3u] = of_ray.x; out[OUT * all + 4u] = acc; out[OUT * all + 5u] = dot(error, error);
        out[OUT * all + 6u] = acc;
    }
    //#if BACK
    let d = error * (2.0 * p.weight);
    // 1 - acc shows the background.
    var of_background = 0.0;
    if (p.has_background == 1u) { of_background = dot(d, p.background); }
    //#if DISTORTION
    var moment_of_run = 0.0;
    for (var k = run.x; k < run.y; k++) { moment_of_run += weights[start + k] * (0.5 * (end(ray, k) + end(ray, k + 1u))); }
    let masses = around(thread, vec4<f32>(stops_of_run.w, moment_of_run, 0.0, 0.0));
    let mass = masses.before.x + stops_of_run.w + masses.behind.x;
    let moment = masses.before.y + moment_of_run + masses.behind.y;
    //#end
    //#if OPACITY_PRIOR
    // log((0.1 + acc) (1.1 - acc) / 0.11), precisely where nearly all light is stopped.
    let left = exp(-(optical_depths.before.x + own + optical_depths.behind.x));
    let half_way = left * (1.0 - left);
    let d_acc = p.opacity_prior * (2.0 * left - 1.0) / (0.11 + half_way);
    //#end
    // The gradients of weights, and what lies behind a sample, seen from it.
    var spread = 0.0;
    var seen_of_run = 0.0;
    //#if DISTORTION
    var mass_behind = masses.behind.x;
    var moment_behind = masses.behind.y;
    //#end
    for (var j = run.x; j < run.y; j++) {
        let k = run.x + run.y - 1u - j;
        let i = start + k;
        let weight = weights[i];
        var d_weight = dot(d, vec3<f32>(values[4u * i], values[4u * i + 1u], values[4u * i + 2u])) - of_background;
        //#if DISTORTION
        let from_end = end(ray, k);
        let to_end = end(ray, k + 1u);
        let middle = 0.5 * (from_end + to_end);
        let mass_before = mass - mass_behind - weight;
        let moment_before = moment - moment_behind - weight * middle;
        let around_it = (middle * mass_before - moment_before) + (moment_behind - middle * mass_behind);
        spread += weight * around_it + weight * weight * (to_end - from_end) / 3.0;
        d_weight += p.distortion * (2.0 * around_it + 2.0 / 3.0 * weight * (to_end - from_end));
        mass_behind += weight;
        moment_behind += weight * middle;
        //#end
        //#if OPACITY_PRIOR
        d_weight += d_acc;
        //#end
        d_values[4u * i + 3u] = d_weight;
        seen_of_run += weight * d_weight;
    }
    var behind = around(thread, vec4<f32>(seen_of_run)).behind.x;
    //#if ENTROPY
    // -sum of p log2(p), and the mean over p of its slope in p.
    let opacities = of_ray.y + TINY;
    let has_entropy = of_ray.z > LEAST_ACC;
    var entropies = vec4<f32>(0.0);
    if (has_entropy) {
        for (var k = run.x; k < run.y; k++) {
            if (has_end(k)) {
                let stops = opacity(optical_depth(ray, k, norm)) / opacities;
                let log_of = log2(stops + TINY);
                entropies -= stops * vec4<f32>(log_of, log_of + stops / (stops + TINY) * LOG2_E, 0.0, 0.0);
            }
        }
    }
    entropies = total(thread, entropies);
    let mean_slope = entropies.y;
    //#end
    var occluded = 0.0;
    var sparsity = 0.0;
    // The gap to the next position grows with that one and shrinks with this one.
    var last_d_gap = 0.0;
    for (var j = run.x; j < run.y; j++) {
        let k = run.x + run.y - 1u - j;
        let i = start + k;
        let at = ray * p.columns + k;
        let gap = gap_of(at, k);
        let interval = gap * norm;
        let density = values[4u * i + 3u];
        let optical = density * interval;
        let weight = weights[i];
        let d_weight = d_values[4u * i + 3u];
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
        var d_gap = d_optical * density * norm;
        if (k + 1u >= p.columns) { d_gap = 0.0; }
        if (j > run.x) { d_t[at + 1u] += d_gap; } else { last_d_gap = d_gap; }
        d_t[at] = -d_gap;
    }
    let terms = total(thread, vec4<f32>(spread, occluded, sparsity, last_d_gap));
    // The position behind a run is the next one's first, or the ray's last.
    if (thread > 0u && run.x < run.y) { d_t[ray * p.columns + run.x] += of_threads[thread - 1u].w; }
    if (p.columns > p.samples && run.x < run.y && run.y == p.samples) { d_t[ray * p.columns + run.y] = last_d_gap; }
    if (thread == 0u) {
        //#if DISTORTION
        out[OUT * all + 7u] = terms.x;
        //#end
        //#if OCCLUSION
        out[OUT * all + 8u] = terms.y;
        //#end
        //#if ENTROPY
        out[OUT * all + 9u] = entropies.x;
        //#end
        //#if CAUCHY
        out[OUT * all + 10u] = terms.z;
        //#end
        //#if OPACITY_PRIOR
        out[OUT * all + 11u] = log(1.0 + half_way / 0.11);
        //#end
    }
    //#end
}
