// c = a + b. A thread a number.
struct Add { numbers: u32 }
@group(0) @binding(0) var<uniform> p: Add;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read> b: array<f32>;
@group(0) @binding(3) var<storage, read_write> c: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i < p.numbers) { c[i] = a[i] + b[i]; }
}
