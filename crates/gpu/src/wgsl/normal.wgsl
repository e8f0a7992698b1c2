// Box-Muller in place: pairs of uniform numbers of a chunk become pairs of normal numbers. A thread a pair.
struct Normal { chunks: u32, count: u32, scale: f32, first: u32 }   // numbers of a chunk, even
@group(0) @binding(0) var<uniform> p: Normal;
@group(0) @binding(1) var<storage, read_write> numbers: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pair = thread_of(id);
    if (2u * pair >= p.chunks * p.count) { return; }
    let at = p.first + 2u * pair;
    // 1 - u is in (0, 1], where the logarithm is finite.
    let radius = p.scale * sqrt(-2.0 * log(1.0 - numbers[at]));
    let turns = numbers[at + 1u];
    numbers[at] = radius * sin_turns(turns + 0.25);
    numbers[at + 1u] = radius * sin_turns(turns);
}
