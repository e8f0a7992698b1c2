// A thread a number. The gradient is made 0 for the next step.
@group(0) @binding(6) var<storage, read_write> gradient: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.numbers || (atomicLoad(&flags[0]) & 15u) != 0u) { return; }
    let g = gradient[i] * p.unit;
    gradient[i] = 0.0;
    move_by(i, g);
}
