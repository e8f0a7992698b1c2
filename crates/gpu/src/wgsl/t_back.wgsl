// The gradient in positions along rays: of compositing, and through the points. A thread a position.
struct TBack { rays: u32, samples: u32, columns: u32, ray0: u32 }
@group(0) @binding(0) var<uniform> p: TBack;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> d_points: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_t: array<f32>;
fn along(ray: u32, k: u32) -> f32 {
    let i = 3u * (ray * p.samples + k);
    return dot(vec3<f32>(d_points[i], d_points[i + 1u], d_points[i + 2u]), ray_vector(p.ray0 + ray, DIRECTION));
}
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.rays * p.columns) { return; }
    let ray = i / p.columns;
    let k = i % p.columns;
    var sum = d_t[i];
    if (p.columns == p.samples) {
        sum += along(ray, k);
    } else {
        if (k < p.samples) { sum += 0.5 * along(ray, k); }
        if (k > 0u) { sum += 0.5 * along(ray, k - 1u); }
    }
    d_t[i] = sum;
}
