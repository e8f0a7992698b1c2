//! The geometry of an experiment's constraint sets on its scene.

use candle_core::{Device, Tensor};

use crate::base::Result;
use crate::data::Scene;
use crate::perturb::{
    Geometry, PaperPass, PaperSite, PassGeometry, PixelScale, SampleDensity, Sets, SiteSet, StepUnit,
};
use crate::render::settings::Spacing;
use crate::settings::Resolved;

use super::plan::Plan;

/// Shortest direction of a ray, indexed by NDC: in NDC a ray goes from -1 to 1 along the view axis, in the world it has
/// length 1.
const SHORTEST: [f64; 2] = [1.0, 2.0];

/// Everything that the sets of a pass depend on, except its samples.
pub struct AttackGeometry {
    /// Near and far, in the units of `t_vals`.
    bounds: (f64, f64),
    /// A pixel's size.
    pixel: PixelScale,
    /// Columns of the coarse pass's `t_vals`.
    coarse_columns: usize,
    /// The width of the network.
    width: usize,
    /// The paper's pass, if sets are measured in its samples and pixels.
    paper: Option<PaperPass>,
}

impl AttackGeometry {
    /// Returns that of a run on its scene.
    pub fn new(config: &Resolved, scene: &Scene) -> AttackGeometry {
        let paper = PaperPass::of_scenes(config.data.kind.forward_facing());
        AttackGeometry {
            bounds: scene.bounds(),
            pixel: pixel_scale(scene),
            coarse_columns: config.field.encoding.t_vals(config.sampling.coarse),
            width: config.field.width,
            paper: (config.perturb.geometry == Geometry::Paper).then_some(paper),
        }
    }

    /// Returns the geometry of a pass with `samples` at `t_vals`.
    ///
    /// # Errors
    /// Those of candle.
    pub fn pass<'a>(
        &self,
        t_vals: &'a Tensor,
        samples: usize,
        direction_norm: &'a Tensor,
        is_coarse: bool,
    ) -> Result<PassGeometry<'a>> {
        let AttackGeometry { bounds, pixel, coarse_columns: coarse_samples, width, paper } = *self;
        let (sample_density, cap_samples) = (SampleDensity::OWN, coarse_samples);
        let own = PassGeometry {
            is_coarse,
            t_vals,
            samples,
            direction_norm,
            bounds,
            coarse_samples,
            cap_samples,
            width,
            pixel,
            sample_density,
        };
        paper.map_or(Ok(own), |paper| own.of_paper(&paper))
    }
}

/// Returns step size over radius of the constraint set, for each site that is on and has a set. A step of 2 radii
/// crosses the complete set. The numbers are those of the site's first perturbed pass, with samples evenly spaced on
/// the shortest ray of an image. A coarse pass that only places samples is not perturbed.
///
/// # Errors
/// Those of candle.
pub fn step_over_radius(config: &Resolved, scene: &Scene) -> Result<Vec<(PaperSite, f64)>> {
    let geometry = AttackGeometry::new(config, scene);
    let (near, far) = geometry.bounds;
    let direction_norm = Tensor::full(SHORTEST[usize::from(geometry.pixel.ndc)], (1, 1), &Device::Cpu)?;
    let mut ratios: Vec<(PaperSite, f64)> = Vec::new();
    for plan in Plan::of(config).second {
        let Some(delta_plan) = plan.deltas else { continue };
        let columns = config.field.encoding.t_vals(plan.count);
        let at = |i: usize| match config.sampling.spacing {
            Spacing::Depth => near + (far - near) * i as f64 / (columns - 1) as f64,
            spacing => spacing.at((near, far), i as f64 / (columns - 1) as f64),
        };
        let t_vals = Tensor::from_vec((0..columns).map(at).collect::<Vec<f64>>(), (1, columns), &Device::Cpu)?;
        let pass = geometry.pass(&t_vals, plan.count, &direction_norm, plan.is_coarse)?;
        for SiteSet { site, set } in Sets::new(delta_plan.sites, &pass)?.iter() {
            let pgd = site.pgd();
            let ratio = match pgd.unit {
                StepUnit::Absolute => pgd.step_size / set.radius.mean_all()?.to_scalar::<f64>()?,
                StepUnit::Relative => pgd.step_size,
            };
            if ratios.iter().all(|(known, _)| *known != site.at()) {
                ratios.push((site.at(), ratio));
            }
        }
    }
    ratios.sort_by_key(|(site, _)| *site as usize);
    Ok(ratios)
}

/// Returns the size of a pixel in a scene, of its first training camera.
fn pixel_scale(scene: &Scene) -> PixelScale {
    let camera = &scene.train[0].camera;
    PixelScale {
        width: camera.width as f64,
        height: camera.height as f64,
        focal: camera.focal[0],
        ndc: scene.ndc.is_some(),
    }
}
