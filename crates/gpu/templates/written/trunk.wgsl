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
struct Trunk {
    m: u32, layers: u32,        // rows, layers
    channels: u32,              // of the encoding
    skips: u32,                 // a bit for each layer that reads the encoding beside the layer below
    injection: u32,             // the layer with a delta, from 1, or 0
    lowest: u32,                // the lowest layer, from 1, whose input's gradient is wanted
    of_layer: u32,              // fours that layers leave, each
    kept: u32,                  // a bit for each layer whose gradient is kept
    end: u32,                   // weights of all layers
}
@group(0) @binding(0) var<uniform> p: Trunk;
@group(0) @binding(3) var<storage, read> right: array<Half>;            // the weights
fn rows() -> u32 { return p.m; }
fn row_at(i: u32) -> u32 { return i; }
var<private> row_count: u32;
@group(0) @binding(1) var<storage, read> encoded: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> c: array<Half>;          // what each layer leaves
// What the next layer reads of a row, which is kept as well.
fn leave(local: u32, i: u32, col: u32, layer: u32, bias_from: u32, four: vec4<f32>) {
    var value = four + four_of_Half(right[(bias_from + col) / 4u]);
    // What is not a number stays.
    value = select(value, vec4<f32>(0.0), value < vec4<f32>(0.0));
    var kept = Half_of(value);
    if (i < row_count) {
        let at = (i * WIDTH + col) / 4u;
        c[layer * p.of_layer + at] = kept;
    }
    left[local * LINE + col / 4u] = kept;
}
// So many fours of the encodings in place of what a layer left.
fn fetch(row0: u32, thread: u32, fours: u32) {
    for (var n = thread; n < ROWS * fours; n += 256u) {
        let i = row0 + n / fours;
        if (i < row_count) { left[n / fours * LINE + n % fours] = Half_of(encoded[i * fours + n % fours]); }
    }
}

// Columns, rows of a group, and fours of a row in shared memory.
const WIDTH: u32 = 64u;
const ROWS: u32 = 64u;
const LINE: u32 = 18u;
var<workgroup> left: array<Half, ROWS * LINE>;
var<workgroup> stage: array<f32, 2560>;
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    row_count = rows();
    let row0 = (group.x + group.y * 65535u) * ROWS;
    let subgroup = thread / 32u; let lane = thread % 32u;
    let r0 = subgroup / 2u * 16u; let c0 = subgroup % 2u * 32u;
    var first = 0u;
    for (var layer = 0u; layer < p.layers; layer++) {
        let of_encoding = select(0u, p.channels, layer == 0u || (p.skips >> layer & 1u) == 1u);
        let hidden = select(64u, 0u, layer == 0u);
        let size = (of_encoding + hidden + 1u) * 64u;
        var s0_0 = coop_mat16x16<f32, C>();
        var s0_1 = coop_mat16x16<f32, C>();
            for (var k = 0u; k < hidden; k += 16u) {
                let l0 = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + 0u) * LINE + k / 4u], LINE);
                let w0 = coopLoadT<coop_mat16x16<f16, B>>(&right[(first + (of_encoding + k) * 64u + c0 + 0u) / 4u], 16u);
                s0_0 = coopMultiplyAdd(l0, w0, s0_0);
                let w1 = coopLoadT<coop_mat16x16<f16, B>>(&right[(first + (of_encoding + k) * 64u + c0 + 16u) / 4u], 16u);
                s0_1 = coopMultiplyAdd(l0, w1, s0_1);
            }
        workgroupBarrier();
        fetch(row0, thread, of_encoding / 4u);
        workgroupBarrier();
            for (var k = 0u; k < of_encoding; k += 16u) {
                let l0 = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + 0u) * LINE + k / 4u], LINE);
                let w0 = coopLoadT<coop_mat16x16<f16, B>>(&right[(first + k * 64u + c0 + 0u) / 4u], 16u);
                s0_0 = coopMultiplyAdd(l0, w0, s0_0);
                let w1 = coopLoadT<coop_mat16x16<f16, B>>(&right[(first + k * 64u + c0 + 16u) / 4u], 16u);
                s0_1 = coopMultiplyAdd(l0, w1, s0_1);
            }
        workgroupBarrier();
        coopStoreT(s0_0, &stage[subgroup * 320u], 20u);
        workgroupBarrier();
        {
            let at = subgroup * 320u + lane / 2u * 20u + lane % 2u * 8u;
            let local = r0 + 0u + lane / 2u; let col = c0 + 0u + lane % 2u * 8u; let bias = first + size - 64u;
            leave(local, row0 + local, col, layer, bias, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]));
            leave(local, row0 + local, col + 4u, layer, bias, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]));
        }
        workgroupBarrier();
        coopStoreT(s0_1, &stage[subgroup * 320u], 20u);
        workgroupBarrier();
        {
            let at = subgroup * 320u + lane / 2u * 20u + lane % 2u * 8u;
            let local = r0 + 0u + lane / 2u; let col = c0 + 16u + lane % 2u * 8u; let bias = first + size - 64u;
            leave(local, row0 + local, col, layer, bias, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]));
            leave(local, row0 + local, col + 4u, layer, bias, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]));
        }
        workgroupBarrier();
        first += size;
    }
}
