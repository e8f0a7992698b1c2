// Sums and extremes over the rays of a pass: mean squared error, largest accumulation, the largest colours and minus the
// smallest ones, rendered and true, and the means of terms. One group.
struct Loss { rays: u32, slot: u32, numbers: u32 }
@group(0) @binding(0) var<uniform> p: Loss;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> out: array<f32>;
@group(0) @binding(3) var<storage, read_write> results: array<f32>;    // [slots, SLOT]
var<workgroup> shared_values: array<f32, 256>;
fn of_ray(what: u32, ray: u32) -> f32 {
    if (what == 0u) { return out[OUT * ray + 5u]; }
    if (what == 1u) { return out[OUT * ray + 6u]; }
    if (what < 5u) { return out[OUT * ray + what - 2u]; }
    if (what < 8u) { return -out[OUT * ray + what - 5u]; }
    if (what < 11u) { return rays[RAY * ray + TARGET + what - 8u]; }
    if (what < 14u) { return -rays[RAY * ray + TARGET + what - 11u]; }
    return out[OUT * ray + what - 7u];
}
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) thread: u32) {
    for (var what = 0u; what < p.numbers; what++) {
        let adds = what == 0u || what >= 14u;
        var value = select(-3.4e38, 0.0, adds);
        for (var ray = thread; ray < p.rays; ray += 256u) {
            let next = of_ray(what, ray);
            value = select(max(value, next), value + next, adds);
        }
        shared_values[thread] = value;
        workgroupBarrier();
        for (var half = 128u; half > 0u; half /= 2u) {
            if (thread < half) {
                let next = shared_values[thread + half];
                let mine = shared_values[thread];
                shared_values[thread] = select(max(mine, next), mine + next, adds);
            }
            workgroupBarrier();
        }
        if (thread == 0u) {
            var value = shared_values[0];
            if (what == 0u) { value /= f32(3u * p.rays); }
            if (what >= 14u) { value /= f32(p.rays); }
            results[SLOT * p.slot + what] = value;
        }
        workgroupBarrier();
    }
}
