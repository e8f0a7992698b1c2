// Density at points, and its gradient; with LAPLACIAN, after those of all points, its Laplacian. A thread a point.
@group(0) @binding(2) var<storage, read_write> out: array<vec4<f32>>;  // [points, density and gradient], [points, Laplacian]
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.points) { return; }
    if (!is_inside(i)) {
        out[i] = vec4<f32>(density_of(-1e4), 0.0, 0.0, 0.0);
        //#if LAPLACIAN
        out[p.points + i] = vec4<f32>(0.0);
        //#end
        return;
    }
    let raw = raw_at(i, 0u);
    out[i] = vec4<f32>(density_of(raw), slope_in_space(raw) * raw_gradient(i));
    //#if LAPLACIAN
    out[p.points + i] = vec4<f32>(laplacian_at(i), 0.0, 0.0, 0.0);
    //#end
}
