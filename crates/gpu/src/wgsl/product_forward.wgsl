//#if DELTA
@group(0) @binding(5) var<storage, read> x: array<{X}>;
@group(0) @binding(6) var<storage, read_write> y: array<{Y}>;
//#end
fn depth_of(row0: u32, part: u32) -> u32 { return p.k1 + p.k2; }
// Along the depth.
fn left_line(row: u32, k: u32, part: u32) -> Four {
    if (row < p.m) { return a_four(row, k); }
    return Four();
}
// Along the columns.
fn right_line(col: u32, k: u32, part: u32) -> Four {
    if (k < p.k1 + p.k2 && col < p.n) { return from_{W}(w[(p.w_from + k * p.ldw + col) / 4u]); }
    return Four();
}
fn bias(col: u32) -> vec4<f32> { return four_of_{W}(w[(p.w_from + (p.k1 + p.k2) * p.ldw + col) / 4u]); }
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.m || col >= p.n) { return; }
    var value = four + bias(col);
    // What is not a number stays.
    if (p.relu == 1u) { value = select(value, vec4<f32>(0.0), value < vec4<f32>(0.0)); }
    c[(p.c_from + row * p.ldc + col) / 4u] = {C}_of(value);
    //#if DELTA
    y[(row * p.ldx + col) / 4u] = {Y}_of(value + four_of_{X}(x[(row * p.ldx + col) / 4u]));
    //#end
}
//#if JETS
// A row of a point's jet, with the value's product.
fn store_jet(row: u32, col: u32, four: vec4<f32>, of_value: vec4<f32>, part: u32) {
    if (row >= p.m || col >= p.n) { return; }
    let before = of_value + bias(col);
    var value = select(four, before, row % 4u == 0u);
    if (p.relu == 1u) { value = select(value, vec4<f32>(0.0), before <= vec4<f32>(0.0)); }
    c[(p.c_from + row * p.ldc + col) / 4u] = {C}_of(value);
}
//#end
