// The gradient in the edges of intervals: of compositing, and through the Gaussians. A thread an edge.
struct TBack { rays: u32, samples: u32, columns: u32, ray0: u32 }
@group(0) @binding(0) var<uniform> p: TBack;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> t_vals: array<f32>;
@group(0) @binding(3) var<storage, read> d_points: array<f32>;
@group(0) @binding(4) var<storage, read> d_variances: array<f32>;
@group(0) @binding(5) var<storage, read_write> d_t: array<f32>;
fn edges_back(of_chunk: u32, k: u32) -> vec2<f32> {
    let i = 3u * (of_chunk * p.samples + k);
    let ray = p.ray0 + of_chunk;
    let d_mean = vec3<f32>(d_points[i], d_points[i + 1u], d_points[i + 2u]);
    let d_variance = vec3<f32>(d_variances[i], d_variances[i + 1u], d_variances[i + 2u]);
    let direction = ray_vector(ray, DIRECTION);
    let squared = direction * direction;
    let across = dot(d_variance, 1.0 - squared / dot(direction, direction));
    let d = Moments(dot(d_mean, direction), dot(d_variance, squared), across);
    let at = of_chunk * p.columns + k;
    return moments_back(t_vals[at], t_vals[at + 1u], rays[RAY * ray + RADIUS], d);
}
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.rays * p.columns) { return; }
    let k = i % p.columns;
    var sum = d_t[i];
    if (k < p.samples) { sum += edges_back(i / p.columns, k).x; }
    if (k > 0u) { sum += edges_back(i / p.columns, k - 1u).y; }
    d_t[i] = sum;
}
