//#if DELTA
@group(0) @binding(5) var<storage, read> x: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> y: array<vec4<f32>>;
//#end
fn depth_of(row0: u32, part: u32) -> u32 { return p.k1 + p.k2; }
// Along the depth.
fn left_line(row: u32, k: u32, part: u32) -> vec4<f32> {
    if (row < p.m) { return a_four(row, k); }
    return vec4<f32>(0.0);
}
// Along the columns.
fn right_line(col: u32, k: u32, part: u32) -> vec4<f32> {
    if (k < p.k1 + p.k2 && col < p.n) { return w[(p.w_from + k * p.ldw + col) / 4u]; }
    return vec4<f32>(0.0);
}
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.m || col >= p.n) { return; }
    var value = four + w[(p.w_from + (p.k1 + p.k2) * p.ldw + col) / 4u];
    // What is not a number stays.
    if (p.relu == 1u) { value = select(value, vec4<f32>(0.0), value < vec4<f32>(0.0)); }
    c[(p.c_from + row * p.ldc + col) / 4u] = value;
    //#if DELTA
    y[(row * p.ldx + col) / 4u] = value + x[(row * p.ldx + col) / 4u];
    //#end
}
//#if JETS
// A row of a point's jet, with the value's product.
fn store_jet(row: u32, col: u32, four: vec4<f32>, of_value: vec4<f32>, part: u32) {
    if (row >= p.m || col >= p.n) { return; }
    let before = of_value + w[(p.w_from + (p.k1 + p.k2) * p.ldw + col) / 4u];
    var value = select(four, before, row % 4u == 0u);
    if (p.relu == 1u) { value = select(value, vec4<f32>(0.0), before <= vec4<f32>(0.0)); }
    c[(p.c_from + row * p.ldc + col) / 4u] = value;
}
//#end
