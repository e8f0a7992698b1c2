// Makes numbers 0. A thread a number.
struct Zero { numbers: u32 }
@group(0) @binding(0) var<uniform> p: Zero;
@group(0) @binding(1) var<storage, read_write> a: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i < p.numbers) { a[i] = 0.0; }
}
