// The weights of samples from their density alone. A group a ray.
struct March { rays: u32, samples: u32, columns: u32, ray0: u32 }
@group(0) @binding(0) var<uniform> p: March;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> t_vals: array<f32>;
@group(0) @binding(3) var<storage, read> density: array<f32>;
//#if WEIGHTS
@group(0) @binding(4) var<storage, read_write> weights: array<f32>;
//#end
//#if ACC
@group(0) @binding(5) var<storage, read_write> out: array<f32>;
//#end
const LAST_INTERVAL: f32 = 1e10;
fn optical_depth(ray: u32, k: u32, norm: f32) -> f32 {
    let at = ray * p.columns + k;
    var gap = LAST_INTERVAL;
    if (k + 1u < p.columns) { gap = t_vals[at + 1u] - t_vals[at]; }
    return density[ray * p.samples + k] * (gap * norm);
}
@compute @workgroup_size(32)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let ray = group.x + group.y * 65535u;
    if (ray >= p.rays) { return; }
    let norm = rays[RAY * (p.ray0 + ray) + NORM];
    let run = run_of(thread, p.samples);
    var own = 0.0;
    for (var k = run.x; k < run.y; k++) { own += optical_depth(ray, k, norm); }
    var passed = around(thread, vec4<f32>(own)).before.x;
    var acc = 0.0;
    for (var k = run.x; k < run.y; k++) {
        let optical = optical_depth(ray, k, norm);
        let weight = exp(-passed) * (1.0 - exp(-optical));
        acc += weight;
        //#if WEIGHTS
        weights[ray * p.samples + k] = weight;
        //#end
        passed += optical;
    }
    //#if ACC
    acc = total(thread, vec4<f32>(acc)).x;
    if (thread == 0u) { out[OUT * (p.ray0 + ray) + 6u] = acc; }
    //#end
}
