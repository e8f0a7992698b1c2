// Raw density of points in space, with its gradient.
struct Space {
    points: u32,
    columns: u32,          // of the head: the feature, density and what pads it to a multiple of 4
    activation: u32,
    l1: f32, tv: f32, laplacian: f32,      // weights of the integrand at a point
}
@group(0) @binding(0) var<uniform> p: Space;
@group(0) @binding(1) var<storage, read> head: array<f32>;             // [rows, columns]
//#if INSIDE
@group(0) @binding(3) var<storage, read> inside: array<u32>;
//#end
//#if JETS
const ROWS: u32 = 4u;      // of a point: raw density, and its derivatives along x, y and z
//#else
const ROWS: u32 = 1u;
//#end
//#if LAPLACIAN
const JETS: u32 = 2u;      // of a point; the second has raw density again, and its Laplacian
//#else
const JETS: u32 = 1u;
//#end
fn raw_at(point: u32, row: u32) -> f32 { return head[p.columns * (ROWS * point + row) + p.columns - 4u]; }
fn raw_gradient(point: u32) -> vec3<f32> {
    //#if JETS
    return vec3<f32>(raw_at(point, 1u), raw_at(point, 2u), raw_at(point, 3u));
    //#else
    return vec3<f32>(0.0);
    //#end
}
// The Laplacian of raw density, which is in the second jet.
fn raw_laplacian(point: u32) -> f32 {
    //#if LAPLACIAN
    return raw_at(p.points + point, 1u);
    //#else
    return 0.0;
    //#end
}
fn is_inside(point: u32) -> bool {
    //#if INSIDE
    return inside[point] == 1u;
    //#else
    return true;
    //#end
}
// The slope of density on one side of a ReLU's kink, where density is 0.
fn slope_in_space(raw: f32) -> f32 { return select(density_slope(raw), 0.0, p.activation == 0u && raw <= 0.0); }
// The second derivative of density in raw density.
fn density_curve(raw: f32) -> f32 {
    let slope = density_slope(raw);
    if (p.activation == 0u) { return 0.0; }
    return select(slope, slope * (1.0 - slope), p.activation == 1u);
}
// The Laplacian of density.
fn laplacian_at(point: u32) -> f32 {
    let raw = raw_at(point, 0u);
    let gradient = raw_gradient(point);
    return slope_in_space(raw) * raw_laplacian(point) + density_curve(raw) * dot(gradient, gradient);
}
