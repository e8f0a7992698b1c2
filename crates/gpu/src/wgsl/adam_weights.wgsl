// A thread a number. The gradient is made 0 for the next step. With DECAY, what is a weight decays before it moves.
@group(0) @binding(6) var<storage, read_write> gradient: array<f32>;
//#if DECAY
@group(0) @binding(8) var<storage, read> is_weight: array<f32>;        // 1 or 0
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.numbers || (atomicLoad(&flags[0]) & 15u) != 0u) { return; }
    let g = gradient[i] * p.unit;
    gradient[i] = 0.0;
    //#if DECAY
    values[i] *= 1.0 - now.learning_rate * p.decay * is_weight[i];
    //#end
    move_by(i, g);
}
