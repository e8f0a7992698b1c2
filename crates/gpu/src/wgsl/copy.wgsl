// b = a. A thread a number.
struct Copy { numbers: u32 }
@group(0) @binding(0) var<uniform> p: Copy;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read_write> b: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i < p.numbers) { b[i] = a[i]; }
}
