//#if LAPLACIAN
// The Laplacian in space of a function of the place in the cube: the sum of `along` times its second derivatives along the axes, of
// `mixed` times those along y and z, x and z, x and y, and of `bend` times its gradient.
struct Curves { along: vec3<f32>, mixed: vec3<f32>, bend: vec3<f32> }
fn curves_of(domain: Domain, point: vec3<f32>) -> Curves {
    let side = domain.high - domain.low;
    let x_row = cube_slope(domain, point, vec3<f32>(1.0, 0.0, 0.0)) / side;
    let y_row = cube_slope(domain, point, vec3<f32>(0.0, 1.0, 0.0)) / side;
    let z_row = cube_slope(domain, point, vec3<f32>(0.0, 0.0, 1.0)) / side;
    let along = vec3<f32>(dot(x_row, x_row), dot(y_row, y_row), dot(z_row, z_row));
    let mixed = 2.0 * vec3<f32>(dot(y_row, z_row), dot(x_row, z_row), dot(x_row, y_row));
    let y = 2.0 * (point - domain.low) / side - 1.0;
    let scale = 4.0 / (side * side);
    var bend = vec3<f32>(0.0);
    if (domain.contraction == 1u) {
        // Of 2 - 1/y, or -2 - 1/y if y is negative.
        bend = select(-0.5 * scale / (y * y * y), vec3<f32>(0.0), abs(y) <= vec3<f32>(1.0));
    } else if (domain.contraction == 2u && dot(y, y) > 1.0) {
        // Of h(r) y with h = 2/r - 1/r^2.
        let r = sqrt(dot(y, y));
        let h_slope = (2.0 / r - 2.0) / (r * r);
        let h_bend = (4.0 - 6.0 / r) / (r * r * r);
        let share = y * y / (r * r);
        let of_all = dot(scale, h_bend * share + h_slope * (1.0 - share) / r);
        bend = 0.25 * y * (of_all + 2.0 * h_slope / r * scale);
    }
    return Curves(along, mixed, bend);
}
// The Laplacian in space of a corner's share. `sign` says on which side of the cell it is, and `w` its shares along the axes.
fn laplacian_of(curves: Curves, f: vec3<f32>, resolution: f32, sign: vec3<f32>, w: vec3<f32>) -> f32 {
    let others = vec3<f32>(w.y * w.z, w.x * w.z, w.x * w.y);
    let slope = sign * slope_of(f) * resolution;
    let curve = sign * (6.0 - 12.0 * f) * (resolution * resolution);
    return dot(curves.along * curve + curves.bend * slope, others) + dot(curves.mixed, w * slope.yxx * slope.zzy);
}
//#end
