//#if MASK
@group(0) @binding(5) var<storage, read> x: array<f32>;
//#end
//#if OPEN
@group(0) @binding(6) var<storage, read_write> y: array<f32>;
//#end
fn left_of(row: u32, k: u32) -> f32 {
    if (row < p.m) { return a_of(row, k); }
    return 0.0;
}
fn left_four(row: u32, k: u32, part: u32) -> vec4<f32> {
    return vec4<f32>(left_of(row, k), left_of(row + 1u, k), left_of(row + 2u, k), left_of(row + 3u, k));
}
fn right_of(col: u32, k: u32) -> f32 {
    if (k < p.k1 && col < p.n) { return w[p.w_from + col * p.ldw + k]; }
    return 0.0;
}
fn right_four(col: u32, k: u32, part: u32) -> vec4<f32> {
    return vec4<f32>(right_of(col, k), right_of(col + 1u, k), right_of(col + 2u, k), right_of(col + 3u, k));
}
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.m) { return; }
    for (var j = 0u; j < 4u; j++) {
        if (col + j >= p.n) { return; }
        let at = p.c_from + row * p.ldc + col + j;
        var value = four[j];
        //#if ADD
        value += c[at];
        //#end
        //#if OPEN
        y[row * p.ldx + col + j] = value;
        //#end
        //#if MASK
        if (x[row * p.ldx + col + j] <= 0.0) { value = 0.0; }
        //#end
        c[at] = value;
    }
}
