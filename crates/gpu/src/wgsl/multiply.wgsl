// b = a * factors, or b = b * factors. A thread a number.
struct Multiply { numbers: u32 }
@group(0) @binding(0) var<uniform> p: Multiply;
@group(0) @binding(1) var<storage, read> factors: array<f32>;
@group(0) @binding(2) var<storage, read_write> b: array<f32>;
//#if FROM
@group(0) @binding(3) var<storage, read> a: array<f32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.numbers) { return; }
    //#if FROM
    b[i] = a[i] * factors[i];
    //#else
    b[i] *= factors[i];
    //#end
}
