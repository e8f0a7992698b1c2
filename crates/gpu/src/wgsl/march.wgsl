// The weights of samples from their density alone. A thread a ray.
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
@compute @workgroup_size(32)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.x;
    if (ray >= p.rays) { return; }
    let norm = rays[RAY * (p.ray0 + ray) + NORM];
    var passed = 0.0;                                                  // optical depth
    var acc = 0.0;
    for (var k = 0u; k < p.samples; k++) {
        let at = ray * p.columns + k;
        var gap = LAST_INTERVAL;
        if (k + 1u < p.columns) { gap = t_vals[at + 1u] - t_vals[at]; }
        let optical = density[ray * p.samples + k] * (gap * norm);
        let weight = exp(-passed) * (1.0 - exp(-optical));
        acc += weight;
        //#if WEIGHTS
        weights[ray * p.samples + k] = weight;
        //#end
        passed += optical;
    }
    //#if ACC
    out[OUT * (p.ray0 + ray) + 6u] = acc;
    //#end
}
