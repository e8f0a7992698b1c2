// Rows of A and D are the depth here: `k` of a part.
fn left_four(col: u32, k: u32, part: u32) -> vec4<f32> {
    let row = part * p.part_rows + k;
    if (row >= p.m || k >= p.part_rows) { return vec4<f32>(0.0); }
    return vec4<f32>(a_of(row, col), a_of(row, col + 1u), a_of(row, col + 2u), a_of(row, col + 3u));
}
fn right_four(col: u32, k: u32, part: u32) -> vec4<f32> {
    let row = part * p.part_rows + k;
    var four = vec4<f32>(0.0);
    if (row >= p.m || k >= p.part_rows) { return four; }
    let at = row * p.ldw + col;
    if (col < p.n) { four.x = w[at]; }
    if (col + 1u < p.n) { four.y = w[at + 1u]; }
    if (col + 2u < p.n) { four.z = w[at + 2u]; }
    if (col + 3u < p.n) { four.w = w[at + 3u]; }
    return four;
}
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.k1 + p.k2) { return; }
    for (var j = 0u; j < 4u; j++) {
        if (col + j >= p.n) { return; }
        c[part * p.parameters + p.to + row * p.n + col + j] = four[j];
    }
}
fn store_bias(col: u32, four: vec4<f32>, part: u32) {
    for (var j = 0u; j < 4u; j++) {
        if (col + j >= p.n) { return; }
        c[part * p.parameters + p.to + (p.k1 + p.k2) * p.n + col + j] = four[j];
    }
}
