// Stratified positions: lower + jitter * width. A thread a position.
struct Sample { rays: u32, columns: u32 }
@group(0) @binding(0) var<uniform> p: Sample;
@group(0) @binding(1) var<storage, read> rows: array<f32>;       // [2, columns] widths, lower ends
@group(0) @binding(2) var<storage, read> jitter: array<f32>;
@group(0) @binding(3) var<storage, read_write> t_vals: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.rays * p.columns) { return; }
    let k = i % p.columns;
    t_vals[i] = jitter[i] * rows[k] + rows[p.columns + k];
}
