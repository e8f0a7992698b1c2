// The unit cube of a hash grid.
struct Domain { low: vec3<f32>, points: u32, high: vec3<f32>, contraction: u32 }   // 0 none, 1 axes, 2 ball

// The derivative of a point's place in the cube along `d`, in units of the box's sides. It is symmetric: the derivative
// along d of what has the gradient v is v . cube_slope(d) = d . cube_slope(v).
fn cube_slope(domain: Domain, point: vec3<f32>, d: vec3<f32>) -> vec3<f32> {
    let y = 2.0 * (point - domain.low) / (domain.high - domain.low) - 1.0;
    if (domain.contraction == 0u) { return d; }
    if (domain.contraction == 1u) {
        let size = max(abs(y), vec3<f32>(1.0));
        return 0.5 * d / (size * size);
    }
    let norm = sqrt(dot(y, y));
    if (norm <= 1.0) { return 0.5 * d; }
    // Of (2 - 1/|y|) y/|y|.
    let n2 = norm * norm;
    return 0.5 * ((2.0 * norm - 1.0) * d - 2.0 * (norm - 1.0) * y * (dot(y, d) / n2)) / n2;
}
