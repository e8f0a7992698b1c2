// A ray of the step: origin, direction, view direction, its two tangents, true colour, length of the direction, radius of its
// cone at t = 1.
const RAY: u32 = 20u;
fn ray_vector(ray: u32, at: u32) -> vec3<f32> {
    let i = RAY * ray + at;
    return vec3<f32>(rays[i], rays[i + 1u], rays[i + 2u]);
}
const ORIGIN: u32 = 0u;
const DIRECTION: u32 = 3u;
const VIEW: u32 = 6u;
const TANGENT_U: u32 = 9u;
const TANGENT_W: u32 = 12u;
const TARGET: u32 = 15u;
const NORM: u32 = 18u;
const RADIUS: u32 = 19u;
