// Rows of A and D are the depth here: `k` of a part. Both along their columns.
fn left_line(col: u32, k: u32, part: u32) -> vec4<f32> {
    let row = part * p.part_rows + k;
    if (row < p.m && k < p.part_rows) { return a_four(row, col); }
    return vec4<f32>(0.0);
}
fn right_line(col: u32, k: u32, part: u32) -> vec4<f32> {
    let row = part * p.part_rows + k;
    if (row < p.m && k < p.part_rows && col < p.n) { return w[(p.w_from + row * p.ldw + col) / 4u]; }
    return vec4<f32>(0.0);
}
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.k1 + p.k2 || col >= p.n) { return; }
    c[(part * p.parameters + p.to + row * p.ldc + col) / 4u] = four;
}
fn store_bias(col: u32, four: vec4<f32>, part: u32) {
    if (col < p.n) { c[(part * p.parameters + p.to + (p.k1 + p.k2) * p.ldc + col) / 4u] = four; }
}
