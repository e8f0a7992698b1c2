// The gradients in raw density and its derivatives of l1 density + tv |gradient of density|; 0 in the head's other columns.
// A thread a number.
@group(0) @binding(2) var<storage, read_write> d_head: array<f32>;     // [rows, columns]

// The second derivative of density in raw density.
fn density_curve(raw: f32) -> f32 {
    let slope = density_slope(raw);
    if (p.activation == 0u) { return 0.0; }
    return select(slope, slope * (1.0 - slope), p.activation == 1u);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= ROWS * p.points * p.columns) { return; }
    d_head[i] = 0.0;
    let row = (i / p.columns) % ROWS;
    let point = i / p.columns / ROWS;
    if (i % p.columns != p.columns - 4u || !is_inside(point)) { return; }
    let raw = raw_at(point, 0u);
    let slope = slope_in_space(raw);
    let raw_slopes = raw_gradient(point);
    let gradient = slope * raw_slopes;
    let norm = sqrt(dot(gradient, gradient));
    // Where the gradient is 0, the subgradient of least length.
    let along = p.tv * gradient / select(norm, 1.0, norm == 0.0);
    if (row == 0u) {
        d_head[i] = p.l1 * sign(density_of(raw)) * slope + dot(along, raw_slopes) * density_curve(raw);
    } else {
        d_head[i] = along[row - 1u] * slope;
    }
}
