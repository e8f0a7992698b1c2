// The radius of the set of xyz: epsilon pixels, at most a part of the ray. A thread a ray.
struct XyzRadius { rays: u32, ray0: u32, pixel: f32, cap: f32 }
@group(0) @binding(0) var<uniform> p: XyzRadius;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read_write> radius: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = thread_of(id);
    if (ray >= p.rays) { return; }
    radius[ray] = min(p.cap * rays[RAY * (p.ray0 + ray) + NORM], p.pixel);
}
