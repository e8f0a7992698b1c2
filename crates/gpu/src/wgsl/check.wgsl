// Looks for what is not finite before Adam: gradients of a field's weights, and the losses. A thread a number.
struct Check { numbers: u32, slots: u32, field: u32 }
@group(0) @binding(0) var<uniform> p: Check;
@group(0) @binding(1) var<storage, read> gradient: array<f32>;
@group(0) @binding(2) var<storage, read> results: array<f32>;          // [slots, SLOT]
@group(0) @binding(3) var<storage, read_write> flags: array<atomic<u32>>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i < p.numbers && broken(gradient[i])) { atomicOr(&flags[0], 1u); atomicMin(&flags[1u + p.field], i); }
    // Losses, and the terms beside them: TV, and those of rays. Extremes may be infinite.
    if (i < p.slots) {
        var any = broken(results[SLOT * i]) || broken(results[SLOT * i + 1u]);
        for (var what = 14u; what < SLOT; what++) { any = any || broken(results[SLOT * i + what]); }
        if (any) { atomicOr(&flags[0], 8u); }
    }
}
