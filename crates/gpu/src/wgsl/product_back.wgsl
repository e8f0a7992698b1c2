//#if MASK
@group(0) @binding(5) var<storage, read> x: array<{X}>;
//#end
//#if OPEN
@group(0) @binding(6) var<storage, read_write> y: array<vec4<f32>>;
//#end
// Tiles without a row that counts have none. Also keeps the number of rows for what fetches.
fn depth_of(row0: u32, part: u32) -> u32 {
    row_count = rows();
    return select(0u, p.k1, row0 < rows());
}
// Along the depth.
fn left_line(i: u32, k: u32, part: u32) -> Four {
    if (i < row_count) { return a_four(row_at(i), k); }
    return Four();
}
// Along the depth: a row of W is a column of its transpose.
fn right_line(col: u32, k: u32, part: u32) -> Four {
    if (k < p.k1 && col < p.n) { return from_{W}(w[(p.w_from + col * p.ldw + k) / 4u]); }
    return Four();
}
fn store_four(i: u32, col: u32, four: vec4<f32>, part: u32) {
    if (i >= row_count || col >= p.n) { return; }
    let row = row_at(i);
    let at = (p.c_from + row * p.ldc + col) / 4u;
    var value = four;
    //#if ADD
    value += four_of_{C}(c[at]);
    //#end
    //#if OPEN
    y[(row * p.ldx + col) / 4u] = value;
    //#end
    //#if MASK
    //#if JETS
    let mask_row = row & 0xfffffffcu;
    //#else
    let mask_row = row;
    //#end
    value = select(value, vec4<f32>(0.0), four_of_{X}(x[(mask_row * p.ldx + col) / 4u]) <= vec4<f32>(0.0));
    //#end
    c[at] = {C}_of(value);
}
