enable f16;
enable wgpu_cooperative_matrix;
// f16 holds numbers to 65,504. What is not a number stays.
fn held_by_f16(four: vec4<f32>) -> vec4<f32> {
    let most = vec4<f32>(65504.0);
    return select(four, clamp(four, -most, most), abs(four) > most);
}
// Four numbers of a matrix in f16, where a device computes in it.
alias Half = vec4<f16>;
fn four_of_Half(kept: Half) -> vec4<f32> { return vec4<f32>(kept); }
fn Half_of(four: vec4<f32>) -> Half { return vec4<f16>(held_by_f16(four)); }
// The operands of a product, in fours: all sizes and strides are multiples of 4, and what pads them is 0.
struct Product {
    m: u32, n: u32,             // rows and columns of C
    k1: u32, k2: u32,           // columns of A1 and A2
    lda1: u32, lda2: u32,       // numbers between their rows
    every2: u32,                // rows that share a row of A2
    ldw: u32, w_from: u32,
    ldc: u32, c_from: u32,
    relu: u32,
    ldx: u32,
    part_rows: u32,             // rows of a part of a gradient
    parts: u32,                 // number of such parts
    parameters: u32,            // numbers of a part
    to: u32,                    // the layer's first number in it
}
@group(0) @binding(0) var<uniform> p: Product;
// Each matrix is kept as Full or as Half.
alias Full = vec4<f32>;
fn four_of_Full(kept: Full) -> vec4<f32> { return kept; }
fn Full_of(four: vec4<f32>) -> Full { return four; }
@group(0) @binding(1) var<storage, read> a1: array<Full>;
@group(0) @binding(3) var<storage, read> w: array<Full>;
@group(0) @binding(4) var<storage, read_write> c: array<Full>;

// Four numbers of what is multiplied.
alias Four = Half;
fn from_Full(kept: Full) -> Four { return Half_of(kept); }
fn from_Half(kept: Half) -> Four { return kept; }


// Four numbers of a row of A.
fn a_four(row: u32, k: u32) -> Four {
    if (k < p.k1) { return from_Full(a1[(row * p.lda1 + k) / 4u]); }
    return Four();
}
fn rows() -> u32 { return p.m; }
fn row_at(i: u32) -> u32 { return i; }
var<private> row_count: u32;
fn depth_of(row0: u32, part: u32) -> u32 { return p.k1 + p.k2; }
// Along the depth.
fn left_line(row: u32, k: u32, part: u32) -> Four {
    if (row < p.m) { return a_four(row, k); }
    return Four();
}
// Along the columns.
fn right_line(col: u32, k: u32, part: u32) -> Four {
    if (k < p.k1 + p.k2 && col < p.n) { return from_Full(w[(p.w_from + k * p.ldw + col) / 4u]); }
    return Four();
}
fn bias(col: u32) -> vec4<f32> { return four_of_Full(w[(p.w_from + (p.k1 + p.k2) * p.ldw + col) / 4u]); }
fn store_four(row: u32, col: u32, four: vec4<f32>, part: u32) {
    if (row >= p.m || col >= p.n) { return; }
    var value = four + bias(col);
    // What is not a number stays.
    if (p.relu == 1u) { value = select(value, vec4<f32>(0.0), value < vec4<f32>(0.0)); }
    c[(p.c_from + row * p.ldc + col) / 4u] = Full_of(value);
}

var<workgroup> left: array<Half, 1280>;
var<workgroup> right: array<Half, 576>;
var<workgroup> stage: array<f32, 2560>;
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let row0 = group.y * 128u; let col0 = group.x * 64u; let part = group.z; let depth = depth_of(row0, part);
    let subgroup = thread / 32u; let lane = thread % 32u;
    let r0 = (subgroup / 2u) * 32u; let c0 = (subgroup % 2u) * 32u;
    var s0_0 = coop_mat16x16<f32, C>();
    var s0_1 = coop_mat16x16<f32, C>();
    var s1_0 = coop_mat16x16<f32, C>();
    var s1_1 = coop_mat16x16<f32, C>();
    var sums = vec4<f32>(0.0);
    var a0 = Four();
    var a1 = Four();
    var a2 = Four();
    var a3 = Four();
    var d0 = Four();
    var d1 = Four();
    { let line = (thread + 0u) / 8u; let four = (thread + 0u) % 8u; a0 = left_line(row0 + line, 0u + 4u * four, part); }
    { let line = (thread + 256u) / 8u; let four = (thread + 256u) % 8u; a1 = left_line(row0 + line, 0u + 4u * four, part); }
    { let line = (thread + 512u) / 8u; let four = (thread + 512u) % 8u; a2 = left_line(row0 + line, 0u + 4u * four, part); }
    { let line = (thread + 768u) / 8u; let four = (thread + 768u) % 8u; a3 = left_line(row0 + line, 0u + 4u * four, part); }
    { let line = (thread + 0u) / 16u; let four = (thread + 0u) % 16u; d0 = right_line(col0 + 4u * four, 0u + line, part); }
    { let line = (thread + 256u) / 16u; let four = (thread + 256u) % 16u; d1 = right_line(col0 + 4u * four, 0u + line, part); }
    for (var k0 = 0u; k0 < depth; k0 += 32u) {
        { let line = (thread + 0u) / 8u; let four = (thread + 0u) % 8u; left[line * 10u + four] = a0; }
        { let line = (thread + 256u) / 8u; let four = (thread + 256u) % 8u; left[line * 10u + four] = a1; }
        { let line = (thread + 512u) / 8u; let four = (thread + 512u) % 8u; left[line * 10u + four] = a2; }
        { let line = (thread + 768u) / 8u; let four = (thread + 768u) % 8u; left[line * 10u + four] = a3; }
        { let line = (thread + 0u) / 16u; let four = (thread + 0u) % 16u; right[line * 18u + four] = d0; }
        { let line = (thread + 256u) / 16u; let four = (thread + 256u) % 16u; right[line * 18u + four] = d1; }
        workgroupBarrier();
        if (k0 + 32u < depth) {
    { let line = (thread + 0u) / 8u; let four = (thread + 0u) % 8u; a0 = left_line(row0 + line, k0 + 32u + 4u * four, part); }
    { let line = (thread + 256u) / 8u; let four = (thread + 256u) % 8u; a1 = left_line(row0 + line, k0 + 32u + 4u * four, part); }
    { let line = (thread + 512u) / 8u; let four = (thread + 512u) % 8u; a2 = left_line(row0 + line, k0 + 32u + 4u * four, part); }
    { let line = (thread + 768u) / 8u; let four = (thread + 768u) % 8u; a3 = left_line(row0 + line, k0 + 32u + 4u * four, part); }
    { let line = (thread + 0u) / 16u; let four = (thread + 0u) % 16u; d0 = right_line(col0 + 4u * four, k0 + 32u + line, part); }
    { let line = (thread + 256u) / 16u; let four = (thread + 256u) % 16u; d1 = right_line(col0 + 4u * four, k0 + 32u + line, part); }
        }
        let l0_0 = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + 0u) * 10u + 0u], 10u);
        let l0_1 = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + 16u) * 10u + 0u], 10u);
        let r0_0 = coopLoadT<coop_mat16x16<f16, B>>(&right[0u * 18u + (c0 + 0u) / 4u], 18u);
        s0_0 = coopMultiplyAdd(l0_0, r0_0, s0_0);
        s1_0 = coopMultiplyAdd(l0_1, r0_0, s1_0);
        let r0_1 = coopLoadT<coop_mat16x16<f16, B>>(&right[0u * 18u + (c0 + 16u) / 4u], 18u);
        s0_1 = coopMultiplyAdd(l0_0, r0_1, s0_1);
        s1_1 = coopMultiplyAdd(l0_1, r0_1, s1_1);
        let l16_0 = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + 0u) * 10u + 4u], 10u);
        let l16_1 = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + 16u) * 10u + 4u], 10u);
        let r16_0 = coopLoadT<coop_mat16x16<f16, B>>(&right[16u * 18u + (c0 + 0u) / 4u], 18u);
        s0_0 = coopMultiplyAdd(l16_0, r16_0, s0_0);
        s1_0 = coopMultiplyAdd(l16_1, r16_0, s1_0);
        let r16_1 = coopLoadT<coop_mat16x16<f16, B>>(&right[16u * 18u + (c0 + 16u) / 4u], 18u);
        s0_1 = coopMultiplyAdd(l16_0, r16_1, s0_1);
        s1_1 = coopMultiplyAdd(l16_1, r16_1, s1_1);
        workgroupBarrier();
    }
    coopStoreT(s0_0, &stage[subgroup * 320u], 20u);
    workgroupBarrier();
    {
        let at = subgroup * 320u + (lane / 2u) * 20u + (lane % 2u) * 8u;
        let row = row0 + r0 + 0u + lane / 2u; let col = col0 + c0 + 0u + (lane % 2u) * 8u;
        store_four(row, col, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]), part);
        store_four(row, col + 4u, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]), part);
    }
    workgroupBarrier();
    coopStoreT(s0_1, &stage[subgroup * 320u], 20u);
    workgroupBarrier();
    {
        let at = subgroup * 320u + (lane / 2u) * 20u + (lane % 2u) * 8u;
        let row = row0 + r0 + 0u + lane / 2u; let col = col0 + c0 + 16u + (lane % 2u) * 8u;
        store_four(row, col, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]), part);
        store_four(row, col + 4u, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]), part);
    }
    workgroupBarrier();
    coopStoreT(s1_0, &stage[subgroup * 320u], 20u);
    workgroupBarrier();
    {
        let at = subgroup * 320u + (lane / 2u) * 20u + (lane % 2u) * 8u;
        let row = row0 + r0 + 16u + lane / 2u; let col = col0 + c0 + 0u + (lane % 2u) * 8u;
        store_four(row, col, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]), part);
        store_four(row, col + 4u, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]), part);
    }
    workgroupBarrier();
    coopStoreT(s1_1, &stage[subgroup * 320u], 20u);
    workgroupBarrier();
    {
        let at = subgroup * 320u + (lane / 2u) * 20u + (lane % 2u) * 8u;
        let row = row0 + r0 + 16u + lane / 2u; let col = col0 + c0 + 16u + (lane % 2u) * 8u;
        store_four(row, col, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]), part);
        store_four(row, col + 4u, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]), part);
    }
    workgroupBarrier();
}
