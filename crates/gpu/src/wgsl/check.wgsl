// Looks for what is not finite before Adam: gradients of a field's weights, and the losses. A thread a number.
struct Check { numbers: u32, slots: u32, field: u32, pad0: u32 }
@group(0) @binding(0) var<uniform> p: Check;
@group(0) @binding(1) var<storage, read> gradient: array<f32>;
@group(0) @binding(2) var<storage, read> results: array<f32>;          // [slots, 16]
@group(0) @binding(3) var<storage, read_write> flags: array<atomic<u32>>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i < p.numbers && broken(gradient[i])) { atomicOr(&flags[0], 1u); atomicMin(&flags[1u + p.field], i); }
    // Losses, and the terms beside them: TV, and distortion.
    if (i < p.slots && (broken(results[16u * i]) || broken(results[16u * i + 1u]) || broken(results[16u * i + 14u]))) {
        atomicOr(&flags[0], 8u);
    }
}
