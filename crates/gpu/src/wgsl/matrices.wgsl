// f16 holds numbers to 65,504.
fn halves(four: vec4<f32>) -> vec4<f16> {
    return vec4<f16>(clamp(four, vec4<f32>(-65504.0), vec4<f32>(65504.0)));
}
// Four numbers of a row of A, along the depth.
fn left_line(row: u32, k: u32) -> vec4<f32> {
    if (row >= p.m) { return vec4<f32>(0.0); }
    return vec4<f32>(a_of(row, k), a_of(row, k + 1u), a_of(row, k + 2u), a_of(row, k + 3u));
}
// Four numbers of a row of W, which is a column of its transpose.
fn right_line(col: u32, k: u32) -> vec4<f32> {
    var four = vec4<f32>(0.0);
    if (col >= p.n) { return four; }
    let at = p.w_from + col * p.ldw + k;
    if (k < p.k1) { four.x = w[at]; }
    if (k + 1u < p.k1) { four.y = w[at + 1u]; }
    if (k + 2u < p.k1) { four.z = w[at + 2u]; }
    if (k + 3u < p.k1) { four.w = w[at + 3u]; }
    return four;
}
