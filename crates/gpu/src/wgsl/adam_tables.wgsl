// A thread an entry. Entries that no gradient reached stay; the sums are made 0 for the next step.
@group(0) @binding(6) var<storage, read_write> sums: array<u32>;
const F: u32 = {FEATURES}u;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let entry = thread_of(id);
    if (F * entry >= p.numbers || (atomicLoad(&flags[0]) & 15u) != 0u) { return; }
    var any = 0u;
    for (var i = 2u * F * entry; i < 2u * F * (entry + 1u); i++) { any |= sums[i]; }
    if (any == 0u) { return; }
    for (var f = 0u; f < F; f++) {
        let i = F * entry + f;
        let g = of_fixed(sums[2u * i], sums[2u * i + 1u]) * p.unit;
        // Half of the range: larger sums may have run over.
        if (abs(g) >= 64.0) { atomicOr(&flags[0], 2u); }
        sums[2u * i] = 0u;
        sums[2u * i + 1u] = 0u;
        move_by(i, g);
    }
}
