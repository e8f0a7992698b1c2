// The samples whose raw colour or density has a gradient, in their order: others change nothing on the way back. First each group's
// count, then (LIST) the list. A thread a sample.
struct Live { points: u32, columns: u32 }
@group(0) @binding(0) var<uniform> p: Live;
@group(0) @binding(1) var<storage, read> d_raw: array<f32>;            // [points, 4]
@group(0) @binding(2) var<storage, read> d_head: array<f32>;           // [points, columns]
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;     // of each group
//#if LIST
@group(0) @binding(4) var<storage, read_write> live: array<u32>;       // how many, and which
//#end
var<workgroup> before: atomic<u32>;
var<workgroup> bits: array<atomic<u32>, 8>;                            // one a sample
// What is not a number is a gradient, which comparisons would not say.
fn is_zero(number: f32) -> bool { return (bitcast<u32>(number) << 1u) == 0u; }
fn has_gradient(i: u32) -> bool {
    let at = p.columns * i + p.columns - 4u;
    return !(is_zero(d_raw[4u * i]) && is_zero(d_raw[4u * i + 1u]) && is_zero(d_raw[4u * i + 2u]) && is_zero(d_head[at]));
}
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let group = id.x + id.y * 65535u;
    let i = group * 256u + thread;
    let word = thread / 32u;
    if (thread < 8u) { atomicStore(&bits[thread], 0u); }
    if (thread == 0u) { atomicStore(&before, 0u); }
    workgroupBarrier();
    var is_live = false;
    if (i < p.points) { is_live = has_gradient(i); }
    if (is_live) { atomicOr(&bits[word], 1u << (thread % 32u)); }
    //#if LIST
    var of_groups = 0u;
    for (var g = thread; g < group; g += 256u) { of_groups += counts[g]; }
    atomicAdd(&before, of_groups);
    //#end
    workgroupBarrier();
    //#if LIST
    var place = 1u + atomicLoad(&before) + countOneBits(atomicLoad(&bits[word]) & ((1u << (thread % 32u)) - 1u));
    for (var w = 0u; w < word; w++) { place += countOneBits(atomicLoad(&bits[w])); }
    if (is_live) { live[place] = i; }
    if (i == p.points - 1u) { live[0] = place - 1u + u32(is_live); }
    //#else
    var count = 0u;
    for (var w = 0u; w < 8u; w++) { count += countOneBits(atomicLoad(&bits[w])); }
    if (thread == 0u) { counts[group] = count; }
    //#end
}
