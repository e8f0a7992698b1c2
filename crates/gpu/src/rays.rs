//! Rays as the kernels read them.

use augnerf_nerf::methods::Batch;
use augnerf_nerf::settings::Spacing;
use augnerf_scenes::tangents;

/// Numbers of a ray in the rays' buffer; `rays.wgsl` says which.
pub(crate) const RAY: usize = 20;

/// Returns rays as the kernels read them, from `[rays, 3]` each and radii `[rays]`, which may be missing, without tangents and true
/// colours.
pub(crate) fn packed(origins: &[f32], directions: &[f32], views: &[f32], radii: &[f32]) -> Vec<f32> {
    let mut packed = vec![0.0; origins.len() / 3 * RAY];
    for (i, ray) in packed.chunks_exact_mut(RAY).enumerate() {
        for (at, from) in [origins, directions, views].into_iter().enumerate() {
            ray[3 * at..][..3].copy_from_slice(&from[3 * i..][..3]);
        }
        ray[RAY - 2] = ray[3..6].iter().map(|x| x * x).sum::<f32>().sqrt();
        ray[RAY - 1] = radii.get(i).copied().unwrap_or_default();
    }
    packed
}

/// Returns the rays of a batch, with what tilts view directions if it is needed.
pub(crate) fn of_batch(Batch { rays, target }: &Batch, has_tangents: bool) -> Vec<f32> {
    let mut packed = packed(&rays.origins, &rays.directions, &rays.viewdirs, &rays.radii);
    for (ray, target) in packed.chunks_exact_mut(RAY).zip(target.chunks_exact(3)) {
        if has_tangents {
            let (u, w) = tangents([ray[6], ray[7], ray[8]].map(f64::from));
            ray[9..15].iter_mut().zip(u.into_iter().chain(w)).for_each(|(to, x)| *to = x as f32);
        }
        ray[15..18].copy_from_slice(target);
    }
    packed
}

/// Returns widths and lower ends of the bins of coarse positions, or the positions themselves without jitter.
pub(crate) fn bins(spacing: Spacing, bounds: (f64, f64), columns: usize, jitter: bool) -> Vec<f32> {
    let last = (columns - 1) as f64;
    let points: Vec<f64> = (0..columns).map(|i| spacing.at(bounds, i as f64 / last)).collect();
    let middle = |i: usize| 0.5 * (points[i] + points[i + 1]);
    let lower: Vec<f64> = (0..columns).map(|i| if i == 0 { points[0] } else { middle(i - 1) }).collect();
    let upper: Vec<f64> = (0..columns).map(|i| if i + 1 == columns { points[i] } else { middle(i) }).collect();
    let widths = upper.iter().zip(&lower).map(|(upper, lower)| if jitter { (upper - lower) as f32 } else { 0.0 });
    let ends = if jitter { &lower } else { &points };
    widths.chain(ends.iter().map(|t| *t as f32)).collect()
}
