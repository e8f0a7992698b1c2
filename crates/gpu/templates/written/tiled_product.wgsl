// f16 holds numbers to 65,504. What is not a number stays.
fn held_by_f16(four: vec4<f32>) -> vec4<f32> {
    let most = vec4<f32>(65504.0);
    return select(four, clamp(four, -most, most), abs(four) > most);
}
// Four numbers of a matrix in f16, two in a word.
alias Half = vec2<u32>;
fn four_of_Half(kept: Half) -> vec4<f32> { return vec4<f32>(unpack2x16float(kept.x), unpack2x16float(kept.y)); }
fn Half_of(four: vec4<f32>) -> Half {
    let held = held_by_f16(four);
    return vec2<u32>(pack2x16float(held.xy), pack2x16float(held.zw));
}
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
alias Four = vec4<f32>;
fn from_Full(kept: Full) -> Four { return kept; }
fn from_Half(kept: Half) -> Four { return four_of_Half(kept); }


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

var<workgroup> left: array<vec4<f32>, 272>;
var<workgroup> right: array<vec4<f32>, 272>;
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let across = 16u; let ty = thread / across; let tx = thread % across;
    let row0 = group.y * 64u; let col0 = group.x * 64u; let part = group.z; let depth = depth_of(row0, part);
    var s0_0 = vec4<f32>(0.0);
    var s1_0 = vec4<f32>(0.0);
    var s2_0 = vec4<f32>(0.0);
    var s3_0 = vec4<f32>(0.0);
    var a0_0 = Four();
    var a0_1 = Four();
    var a0_2 = Four();
    var a0_3 = Four();
    var d0_0 = Four();
{
    if ((thread + 0u) < 64u) {
    let k = 4u * ((thread + 0u) % 4u); let at = (thread + 0u) / 4u;
    
    a0_0 = left_line(row0 + 4u * at + 0u, 0u + k, part);
    a0_1 = left_line(row0 + 4u * at + 1u, 0u + k, part);
    a0_2 = left_line(row0 + 4u * at + 2u, 0u + k, part);
    a0_3 = left_line(row0 + 4u * at + 3u, 0u + k, part);
    }
}
{
    let k = (thread + 0u) / 16u; let at = (thread + 0u) % 16u;
    
    d0_0 = right_line(col0 + 4u * at + 0u, 0u + k, part);
}
    for (var k0 = 0u; k0 < depth; k0 += 16u) {
{
    if ((thread + 0u) < 64u) {
    let k = 4u * ((thread + 0u) % 4u); let at = (thread + 0u) / 4u;
    
    left[(k + 0u) * 17u + at] = vec4<f32>(a0_0.x, a0_1.x, a0_2.x, a0_3.x);
    left[(k + 1u) * 17u + at] = vec4<f32>(a0_0.y, a0_1.y, a0_2.y, a0_3.y);
    left[(k + 2u) * 17u + at] = vec4<f32>(a0_0.z, a0_1.z, a0_2.z, a0_3.z);
    left[(k + 3u) * 17u + at] = vec4<f32>(a0_0.w, a0_1.w, a0_2.w, a0_3.w);
    }
}
{
    let k = (thread + 0u) / 16u; let at = (thread + 0u) % 16u;
    
    right[k * 17u + at] = d0_0;
}
        workgroupBarrier();
        if (k0 + 16u < depth) {
{
    if ((thread + 0u) < 64u) {
    let k = 4u * ((thread + 0u) % 4u); let at = (thread + 0u) / 4u;
    
    a0_0 = left_line(row0 + 4u * at + 0u, k0 + 16u + k, part);
    a0_1 = left_line(row0 + 4u * at + 1u, k0 + 16u + k, part);
    a0_2 = left_line(row0 + 4u * at + 2u, k0 + 16u + k, part);
    a0_3 = left_line(row0 + 4u * at + 3u, k0 + 16u + k, part);
    }
}
{
    let k = (thread + 0u) / 16u; let at = (thread + 0u) % 16u;
    
    d0_0 = right_line(col0 + 4u * at + 0u, k0 + 16u + k, part);
}
        }
        for (var k = 0u; k < 16u; k++) {
            let l = k * 17u + 1u * ty; let r = k * 17u + 1u * tx;
            let l0 = left[l + 0u]; let r0 = right[r + 0u];
            s0_0 = fma(vec4<f32>(l0[0]), r0, s0_0);
            s1_0 = fma(vec4<f32>(l0[1]), r0, s1_0);
            s2_0 = fma(vec4<f32>(l0[2]), r0, s2_0);
            s3_0 = fma(vec4<f32>(l0[3]), r0, s3_0);
        }
        workgroupBarrier();
    }
    store_four(row0 + 4u * ty + 0u, col0 + 4u * tx + 0u, s0_0, part);
    store_four(row0 + 4u * ty + 1u, col0 + 4u * tx + 0u, s1_0, part);
    store_four(row0 + 4u * ty + 2u, col0 + 4u * tx + 0u, s2_0, part);
    store_four(row0 + 4u * ty + 3u, col0 + 4u * tx + 0u, s3_0, part);
}
