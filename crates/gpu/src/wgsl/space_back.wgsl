// The gradients in raw density and its derivatives of l1 density + tv |gradient of density| + laplacian |Laplacian of density|; 0 in
// the head's other columns. A thread a number.
@group(0) @binding(2) var<storage, read_write> d_head: array<f32>;     // [rows, columns]

// The third derivative of density in raw density.
fn density_third(raw: f32) -> f32 {
    return density_curve(raw) * select(1.0, 1.0 - 2.0 * density_slope(raw), p.activation == 1u);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    let jet = i / p.columns / ROWS;
    if (jet >= JETS * p.points) { return; }
    d_head[i] = 0.0;
    let row = (i / p.columns) % ROWS;
    let point = jet % p.points;
    if (i % p.columns != p.columns - 4u || !is_inside(point)) { return; }
    let raw = raw_at(point, 0u);
    let slope = slope_in_space(raw);
    let raw_slopes = raw_gradient(point);
    let gradient = slope * raw_slopes;
    let norm = sqrt(dot(gradient, gradient));
    // Where the gradient is 0, the subgradient of least length.
    let along = p.tv * gradient / select(norm, 1.0, norm == 0.0);
    let of_laplacian = p.laplacian * sign(laplacian_at(point));
    if (jet >= p.points) {
        d_head[i] = select(0.0, of_laplacian * slope, row == 1u);
    } else if (row == 0u) {
        let bent = density_curve(raw) * raw_laplacian(point) + density_third(raw) * dot(raw_slopes, raw_slopes);
        d_head[i] = p.l1 * sign(density_of(raw)) * slope + dot(along, raw_slopes) * density_curve(raw) + of_laplacian * bent;
    } else {
        d_head[i] = along[row - 1u] * slope + 2.0 * of_laplacian * density_curve(raw) * raw_slopes[row - 1u];
    }
}
