// Rows of A and D are the depth here: `k` of a part. Both along their columns.
var<private> part_rows: u32;
// Also keeps it, with the number of rows, for what fetches.
fn depth_of(row0: u32, part: u32) -> u32 {
    //#if LIVE
    let depth = ((rows() + p.parts - 1u) / p.parts + 15u) / 16u * 16u;
    //#else
    let depth = p.part_rows;
    //#end
    part_rows = depth;
    row_count = rows();
    return depth;
}
fn left_line(col: u32, k: u32, part: u32) -> Four {
    let i = part * part_rows + k;
    if (i < row_count && k < part_rows) { return a_four(row_at(i), col); }
    return Four();
}
fn right_line(col: u32, k: u32, part: u32) -> Four {
    let i = part * part_rows + k;
    if (i < row_count && k < part_rows && col < p.n) { return from_{W}(w[(p.w_from + row_at(i) * p.ldw + col) / 4u]); }
    return Four();
}
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.k1 + p.k2 || col >= p.n) { return; }
    c[(part * p.parameters + p.to + row * p.ldc + col) / 4u] = {C}_of(four);
}
fn store_bias(col: u32, four: vec4<f32>, part: u32) {
    if (col < p.n) { c[(part * p.parameters + p.to + (p.k1 + p.k2) * p.ldc + col) / 4u] = {C}_of(four); }
}
