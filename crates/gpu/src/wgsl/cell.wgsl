// A level of a hash grid: resolution, entries, offset, 1 if each vertex has an entry of its own.
struct Grid { points: u32, levels: u32, scale: f32, smooth_step: u32, stride: u32, level: array<vec4<u32>, 32> }
@group(0) @binding(0) var<uniform> g: Grid;
@group(0) @binding(1) var<storage, read> unit: array<f32>;

const F: u32 = {FEATURES}u;
struct Cell { vertex: vec3<u32>, f: vec3<f32> }
fn cell_of(point: u32, resolution: u32) -> Cell {
    let x = vec3<f32>(unit[3u * point], unit[3u * point + 1u], unit[3u * point + 2u]) * f32(resolution);
    let low = clamp(floor(x), vec3<f32>(0.0), vec3<f32>(f32(resolution - 1u)));
    return Cell(vec3<u32>(low), x - low);
}
fn entry(level: vec4<u32>, v: vec3<u32>) -> u32 {
    let side = level.x + 1u;
    if (level.w == 1u) { return level.z + v.x + side * (v.y + side * v.z); }
    return level.z + ((v.x ^ (v.y * 2654435761u) ^ (v.z * 805459861u)) & (level.y - 1u));
}
fn corner(k: u32) -> vec3<u32> { return vec3<u32>(k & 1u, (k >> 1u) & 1u, k >> 2u); }
fn upper(f: vec3<f32>) -> vec3<f32> { return select(f, f * f * (3.0 - 2.0 * f), g.smooth_step == 1u); }
fn slope_of(f: vec3<f32>) -> vec3<f32> { return select(vec3<f32>(1.0), 6.0 * f * (1.0 - f), g.smooth_step == 1u); }
fn shares(c: vec3<u32>, share: vec3<f32>) -> vec3<f32> { return select(1.0 - share, share, c == vec3<u32>(1u)); }
