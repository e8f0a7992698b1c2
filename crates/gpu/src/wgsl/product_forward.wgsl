//#if DELTA
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> y: array<f32>;
//#end
fn left_of(row: u32, k: u32) -> f32 {
    if (row < p.m) { return a_of(row, k); }
    return 0.0;
}
fn left_four(row: u32, k: u32, part: u32) -> vec4<f32> {
    return vec4<f32>(left_of(row, k), left_of(row + 1u, k), left_of(row + 2u, k), left_of(row + 3u, k));
}
fn right_four(col: u32, k: u32, part: u32) -> vec4<f32> {
    var four = vec4<f32>(0.0);
    if (k >= p.k1 + p.k2) { return four; }
    let at = p.w_from + k * p.ldw + col;
    if (col < p.n) { four.x = w[at]; }
    if (col + 1u < p.n) { four.y = w[at + 1u]; }
    if (col + 2u < p.n) { four.z = w[at + 2u]; }
    if (col + 3u < p.n) { four.w = w[at + 3u]; }
    return four;
}
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.m) { return; }
    for (var j = 0u; j < 4u; j++) {
        if (col + j >= p.n) { return; }
        var value = four[j] + w[p.w_from + (p.k1 + p.k2) * p.ldw + col + j];
        // What is not a number stays.
        if (p.relu == 1u && value < 0.0) { value = 0.0; }
        c[p.c_from + row * p.ldc + col + j] = value;
        //#if DELTA
        y[row * p.ldx + col + j] = value + x[row * p.ldx + col + j];
        //#end
    }
}
