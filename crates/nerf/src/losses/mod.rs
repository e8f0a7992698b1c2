//! Terms of the loss next to the photometric one: on the rays of a step, or in space.
//!
//! | term | where | at a ray or point | source |
//! |---|---|---|---|
//! | `l1` | space | abs(density) | Aug-NeRF, appendix "Implementation of explicit regularization" |
//! | `tv` | space | length of density's gradient | the same |
//! | `laplacian` | space | abs(Laplacian of density) | the same |
//! | `opacity-sparsity` | space | 1 - exp(-density / 20), over the box's volume | PlenOctrees |
//! | `distortion` | rays | spread of the weights along the ray | mip-NeRF 360, equation 15 |
//! | `occlusion` | rays | density next to the camera | FreeNeRF |
//! | `entropy` | rays | entropy of the opacities along the ray | InfoNeRF |
//! | `cauchy` | rays | mean of log(1 + 2 density^2) | SNeRG |
//! | `opacity-prior` | rays | log(0.1 + acc) + log(1.1 - acc) | Neural Volumes |
//! | `depth-smoothness` | unseen patches | squared differences of neighbouring pixels' depth | RegNeRF |
//! | `information-gain` | unseen pairs | divergence of the opacities of a ray and its twin | InfoNeRF |
//! | `orientation` | rays | weights where density falls along the ray | Ref-NeRF |
//! | `sparse-depth` | rays to points | squared difference of the ray's depth and the point's | DS-NeRF |
//! | `hash-decay` | tables | half the mean square of each level's entries | Zip-NeRF |
//!
//! A term on rays is the mean over a step's rays, which are those of its photographs or unseen ones, or over its pairs or
//! patches of unseen rays. A term on tables is of the hash grids' parameters alone. A term in space is an integral over a
//! box: volume / n * sum over n points. If the points are the midpoints of all cells, volume / n is the paper's delta^3. A term of your own
//! implements [`RayTerm`] or [`SpaceTerm`], and is passed to the trainer (`Learner::add_term` in [`crate::methods`]).
//!
//! A step computes terms in space in `methods/fields/space.rs`, at points of `RegularizerConfig::quadrature`. `spatial.rs` here
//! multiplies by weight and volume. `field/spatial.rs` has density's derivatives, and the gradients of the network's parameters.

use std::sync::Arc;

use candle_core::{Tensor, Var};

use crate::base::Result;
use crate::data::RayGroup;
use crate::field::{Cotangents, DensityAt, Order};
use crate::render::PassOutput;

mod cauchy;
mod depth_smoothness;
mod distortion;
mod entropy;
mod hash_decay;
mod information_gain;
mod l1;
mod laplacian;
mod occlusion;
mod opacity;
mod orientation;
mod settings;
mod smoothness;
mod sparse_depth;
mod spatial;
mod tv;

pub use crate::schedule::WeightSchedule;
pub use cauchy::Cauchy;
pub use depth_smoothness::DepthSmoothness;
pub use distortion::Distortion;
pub use entropy::Entropy;
pub use hash_decay::HashDecay;
pub use information_gain::InformationGain;
pub use l1::L1;
pub use laplacian::Laplacian;
pub use occlusion::Occlusion;
pub use opacity::{OpacityPrior, OpacitySparsity};
pub use orientation::Orientation;
pub use settings::{LatticePoints, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig, TermRays};
pub use smoothness::{Smoothness, measure, measure_density};
pub use sparse_depth::SparseDepth;
pub use spatial::{Regularized, WeightedSpaceTerm, regularize, regularize_at, regularize_unless};
pub use tv::Tv;

/// A rendered pass, as a term on rays reads it.
pub struct RayPass<'a> {
    /// Colour, depth, accumulation and weights of the rays, with their graph.
    pub output: &'a PassOutput,
    /// Near and far, in the units of `t_vals`.
    pub bounds: (f64, f64),
    /// Lengths of the rays' directions, `[rays, 1]`.
    pub direction_norm: &'a Tensor,
    /// The rays' directions in the space in which the field is queried, `[rays, 3]`, of any length.
    pub directions: &'a Tensor,
    /// Density's gradient at the samples, `[rays, samples, 3]`, if a term of the pass reads it.
    pub slopes: Option<&'a Tensor>,
    /// The t of the known point on each ray, `[rays]`, if the rays are those to points ([`RayGroup::Point`]).
    pub point_t: Option<&'a Tensor>,
}

impl RayPass<'_> {
    /// Returns the ends of the samples' intervals, `[rays, samples + 1]`, in 0..1 between near and far. If samples are
    /// points, an interval reaches to the next sample, and the last one's to far.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn edges(&self) -> Result<Tensor> {
        edges(&self.output.t_vals, self.samples()?, self.bounds)
    }

    /// Returns the number of samples of a ray.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn samples(&self) -> Result<usize> {
        Ok(self.output.density.dim(1)?)
    }
}

fn edges(t_vals: &Tensor, samples: usize, (near, far): (f64, f64)) -> Result<Tensor> {
    let edges = if t_vals.dim(1)? > samples {
        t_vals.clone()
    } else {
        let last = Tensor::full(far, (t_vals.dim(0)?, 1), t_vals.device())?.to_dtype(t_vals.dtype())?;
        Tensor::cat(&[t_vals, &last], 1)?
    };
    Ok(edges.affine(1.0 / (far - near), -near / (far - near))?)
}

/// A term with a value per ray, or per group of rays.
pub trait RayTerm: Send + Sync {
    /// Returns its name in logs (`regularizer.NAME`) and tables.
    fn name(&self) -> &str;
    /// Whether it counts in the evaluated pass alone, whatever `regularizer.fields` says.
    fn is_of_evaluated_pass(&self) -> bool {
        false
    }
    /// Returns the rays that it has a value for. Pairs and patches are unseen rays.
    fn group(&self) -> RayGroup {
        RayGroup::One
    }
    /// Returns whether it reads density's gradient at the samples ([`RayPass::slopes`]), which costs about as much as two
    /// further passes.
    fn reads_slopes(&self) -> bool {
        false
    }
    /// Returns the term of each group of a clean pass's rays, `[groups]`, differentiable. A group's rays are next to each
    /// other.
    fn per_group(&self, pass: &RayPass) -> Result<Tensor>;
}

/// A term that is integrated over a box.
pub trait SpaceTerm: Send + Sync {
    /// Returns its name in logs (`regularizer.NAME`) and tables.
    fn name(&self) -> &str;
    /// Returns the highest derivative of density that it reads. Higher ones are NaN.
    fn order(&self) -> Order {
        Order::Laplacian
    }
    /// Returns the integrand, `[n]`.
    fn at_points(&self, at: &DensityAt) -> Result<Tensor>;
    /// Returns the derivatives of the sum over points. By default candle differentiates [`SpaceTerm::at_points`].
    fn cotangents(&self, at: &DensityAt) -> Result<Cotangents> {
        let [density, gradient, laplacian] =
            [&at.density, &at.gradient, &at.laplacian].map(|tensor| Var::from_tensor(&tensor.detach()));
        let (density, gradient, laplacian) = (density?, gradient?, laplacian?);
        let moved = DensityAt {
            density: density.as_tensor().clone(),
            gradient: gradient.as_tensor().clone(),
            laplacian: laplacian.as_tensor().clone(),
        };
        let slopes = self.at_points(&moved)?.sum_all()?.backward()?;
        let slope = |var: &Var| slopes.get(var).cloned();
        Ok(Cotangents { density: slope(&density), gradient: slope(&gradient), laplacian: slope(&laplacian) })
    }
}

/// A term of the loss.
#[derive(Clone)]
pub enum LossTerm {
    /// The mean over rays, or groups of them.
    OnRays(Arc<dyn RayTerm>, TermRays),
    /// An integral over a box.
    InSpace(Arc<dyn SpaceTerm>),
    /// Of the tables of hash grids.
    OnTables(HashDecay),
}

/// Where a step computes a term's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TermSource {
    /// The clean passes of the step's own rays.
    TrainingRays,
    /// Passes of rays without photographs, in such groups.
    UnseenRays(RayGroup),
    /// Points of a box.
    Space,
    /// The tables of hash grids.
    Tables,
}

/// What a term is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TermNeeds {
    /// The samples of rays, which come in such groups. Pairs and patches are unseen.
    Samples(RayGroup),
    /// The samples of single rays with density's gradient there.
    Slopes,
    /// Density at points of the box of section `regularizer`, up to this derivative.
    Density(Order),
    /// The tables of hash grids.
    Tables,
}

/// A term and its weight in the loss.
#[derive(Clone)]
pub struct WeightedTerm {
    /// What is added to the loss.
    pub term: LossTerm,
    /// Its factor.
    pub weight: f64,
    /// How the factor moves.
    pub schedule: WeightSchedule,
}

impl LossTerm {
    /// Creates a term on the rays of photographs, or on unseen ones if it needs pairs or patches.
    pub fn on_rays(term: impl RayTerm + 'static) -> LossTerm {
        let rays = if term.group() == RayGroup::One { TermRays::Training } else { TermRays::Unseen };
        LossTerm::OnRays(Arc::new(term), rays)
    }

    /// Returns where a step computes its value.
    pub fn source(&self) -> TermSource {
        match self {
            LossTerm::OnRays(_, TermRays::Training) => TermSource::TrainingRays,
            LossTerm::OnRays(term, TermRays::Unseen) => TermSource::UnseenRays(term.group()),
            LossTerm::InSpace(_) => TermSource::Space,
            LossTerm::OnTables(_) => TermSource::Tables,
        }
    }

    /// Returns the groups of unseen rays that terms read, each once, in a fixed order.
    pub fn unseen_groups<'a>(terms: impl Iterator<Item = &'a LossTerm> + Clone) -> Vec<RayGroup> {
        let is_read = |group: &RayGroup| terms.clone().any(|term| term.source() == TermSource::UnseenRays(*group));
        [RayGroup::Point, RayGroup::One, RayGroup::Pair, RayGroup::Patch].into_iter().filter(is_read).collect()
    }

    /// Creates a term in space.
    pub fn in_space(term: impl SpaceTerm + 'static) -> LossTerm {
        LossTerm::InSpace(Arc::new(term))
    }

    /// Returns the default weight of each term, and the term with its settings: the table of the terms that settings name.
    ///
    /// With the default weight a term of the paper has a tenth of the photometric loss's gradient norm on fern, preset
    /// `paper-llff`, after 100 steps. Another scene can need hundreds of times as much; `augnerf train --balance` measures it.
    /// The others have their authors' weights: mip-NeRF 360's, FreeNeRF's, InfoNeRF's on Blender's scenes with 4 views,
    /// SNeRG's, Neural Volumes', PlenOctrees', Zip-NeRF's on the scenes of mip-NeRF 360, RegNeRF's after its first 512 steps,
    /// InfoNeRF's on DTU, FlipNeRF's on Blender's scenes, and DS-NeRF's.
    fn entry(regularizer: Regularizer, config: &RegularizerConfig) -> (f64, LossTerm) {
        match regularizer {
            Regularizer::L1 => (1.4e-4, LossTerm::in_space(L1)),
            Regularizer::Tv => (3.8e-6, LossTerm::in_space(Tv)),
            Regularizer::Laplacian => (7.4e-9, LossTerm::in_space(Laplacian)),
            Regularizer::Distortion => (0.01, LossTerm::on_rays(Distortion)),
            Regularizer::Occlusion => (0.01, LossTerm::on_rays(Occlusion { share: config.occlusion_share })),
            Regularizer::Entropy => (1e-3, LossTerm::on_rays(Entropy)),
            Regularizer::Cauchy => (1e-4, LossTerm::on_rays(Cauchy)),
            Regularizer::OpacityPrior => (0.01, LossTerm::on_rays(OpacityPrior)),
            Regularizer::OpacitySparsity => (1e-3, LossTerm::in_space(OpacitySparsity { volume: config.volume() })),
            Regularizer::HashDecay => (0.1, LossTerm::OnTables(HashDecay)),
            Regularizer::DepthSmoothness => (0.1, LossTerm::on_rays(DepthSmoothness)),
            Regularizer::InformationGain => (2e-5, LossTerm::on_rays(InformationGain)),
            Regularizer::Orientation => (0.01, LossTerm::on_rays(Orientation)),
            Regularizer::SparseDepth => (0.1, LossTerm::on_rays(SparseDepth)),
        }
    }

    /// Returns the default weight of a term.
    pub fn default_weight(regularizer: Regularizer) -> f64 {
        LossTerm::entry(regularizer, &RegularizerConfig::default()).0
    }

    /// Returns a term with its settings.
    pub fn of(regularizer: Regularizer, config: &RegularizerConfig) -> LossTerm {
        match (LossTerm::entry(regularizer, config).1, config.rays) {
            (LossTerm::OnRays(term, _), TermRays::Unseen) => LossTerm::OnRays(term, TermRays::Unseen),
            (term, _) => term,
        }
    }

    /// Returns what the term is computed from.
    pub fn needs(&self) -> TermNeeds {
        match self {
            LossTerm::OnRays(term, _) if term.reads_slopes() => TermNeeds::Slopes,
            LossTerm::OnRays(term, _) => TermNeeds::Samples(term.group()),
            LossTerm::InSpace(term) => TermNeeds::Density(term.order()),
            LossTerm::OnTables(_) => TermNeeds::Tables,
        }
    }

    /// Returns whether the term counts in the evaluated pass alone, whatever `regularizer.fields` says.
    pub fn is_of_evaluated_pass(&self) -> bool {
        matches!(self, LossTerm::OnRays(term, _) if term.is_of_evaluated_pass())
    }

    /// Returns the name in logs and tables.
    pub fn name(&self) -> &str {
        match self {
            LossTerm::OnRays(term, _) => term.name(),
            LossTerm::InSpace(term) => term.name(),
            LossTerm::OnTables(term) => term.name(),
        }
    }
}

impl WeightedTerm {
    /// Returns the terms of a configuration with their weights, in its order.
    pub fn all(config: &RegularizerConfig) -> Vec<WeightedTerm> {
        let terms = config.terms().zip(config.schedules());
        let of = |((term, weight), schedule)| WeightedTerm { term: LossTerm::of(term, config), weight, schedule };
        terms.map(of).collect()
    }

    /// Returns the term with its weight in the step after `step` finished ones, which is constant.
    pub fn at(&self, step: u64) -> WeightedTerm {
        let weight = self.schedule.at(self.weight, step);
        WeightedTerm { term: self.term.clone(), weight, schedule: WeightSchedule::Constant }
    }

    /// Returns a term with a constant weight.
    pub fn constant(term: LossTerm, weight: f64) -> WeightedTerm {
        WeightedTerm { term, weight, schedule: WeightSchedule::Constant }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perturb::UsedDeltas;
    use crate::render::volume::composite_reference;
    use candle_core::Device;

    #[test]
    fn the_settings_name_each_term_as_it_names_itself() {
        for regularizer in REGULARIZERS.iter() {
            assert_eq!(LossTerm::of(*regularizer, &RegularizerConfig::default()).name(), regularizer.name());
        }
    }

    /// A ray from 0 to `far` with evenly spaced points, in f64.
    pub(super) struct TestRay {
        /// Of all rays, one after the other.
        density: Vec<f64>,
        rays: usize,
        far: f64,
        has_edges: bool,
        /// Density's gradients at the samples, three numbers each. They do not depend on the densities above.
        slopes: Vec<f64>,
        /// The t of a known point.
        point_t: Option<f64>,
    }

    pub(super) fn rays(density: &[f64], far: f64) -> TestRay {
        TestRay {
            density: density.to_vec(),
            rays: 1,
            far,
            has_edges: false,
            slopes: vec![0.0; 3 * density.len()],
            point_t: None,
        }
    }

    /// Two such rays.
    pub(super) fn pair(density: &[f64], far: f64) -> TestRay {
        TestRay { rays: 2, ..rays(density, far) }
    }

    /// Those of a patch.
    pub(super) fn patch(density: &[f64], samples: usize, far: f64) -> TestRay {
        assert_eq!(density.len(), samples * RayGroup::Patch.rays());
        TestRay { rays: RayGroup::Patch.rays(), ..rays(density, far) }
    }

    /// The same between edges.
    pub(super) fn between_edges(density: &[f64], far: f64) -> TestRay {
        rays(density, far).edged()
    }

    impl TestRay {
        /// The same between edges, the last of which is `far`.
        pub(super) fn edged(self) -> TestRay {
            TestRay { has_edges: true, ..self }
        }

        /// The same with these gradients of density. The ray's direction is +z.
        pub(super) fn sloped(self, slopes: Vec<f64>) -> TestRay {
            TestRay { slopes, ..self }
        }

        /// The same with a known point on it.
        pub(super) fn with_point(self, t: f64) -> TestRay {
            TestRay { point_t: Some(t), ..self }
        }

        /// Returns a term's value, and its derivatives in density, and in density's gradients if it reads them.
        pub(super) fn differentiated(&self, term: &dyn RayTerm) -> (f64, Vec<f64>) {
            let (rays, n) = (self.rays, self.density.len() / self.rays);
            let density = Tensor::from_slice(&self.density, (rays, n), &Device::Cpu).unwrap();
            let density = Var::from_tensor(&density).unwrap();
            let columns = n + usize::from(self.has_edges);
            let t_vals: Vec<f64> = (0..columns).map(|k| k as f64 * self.far / n as f64).collect();
            let t_vals = Tensor::from_vec(t_vals.repeat(rays), (rays, columns), &Device::Cpu).unwrap();
            let direction_norm = Tensor::ones((rays, 1), candle_core::DType::F64, &Device::Cpu).unwrap();
            let rgb = Tensor::zeros((rays, n, 3), candle_core::DType::F64, &Device::Cpu).unwrap();
            let composite = composite_reference(&rgb, &density, &t_vals, &direction_norm, None).unwrap();
            let raw_density = density.as_tensor().clone();
            let (density_of_samples, used) = (density.as_tensor().clone(), UsedDeltas::default());
            let output = PassOutput { composite, rgb, density: density_of_samples, t_vals, raw_density, used };
            let slopes = Tensor::from_slice(&self.slopes, (rays, n, 3), &Device::Cpu).unwrap();
            let slopes = Var::from_tensor(&slopes).unwrap();
            let point_t = self.point_t.map(|t| Tensor::from_slice(&[t], 1, &Device::Cpu).unwrap());
            let directions = Tensor::from_vec([0.0, 0.0, 1.0].repeat(rays), (rays, 3), &Device::Cpu).unwrap();
            let pass = RayPass {
                output: &output,
                bounds: (0.0, self.far),
                direction_norm: &direction_norm,
                directions: &directions,
                slopes: term.reads_slopes().then_some(slopes.as_tensor()),
                point_t: point_t.as_ref(),
            };
            let value = term.per_group(&pass).unwrap();
            let gradients = value.sum_all().unwrap().backward().unwrap();
            let of = |var: &Var| gradients.get(var).map(|found| found.flatten_all().unwrap().to_vec1().unwrap());
            let found = of(&density).unwrap().into_iter().chain(of(&slopes).unwrap_or_default());
            (value.to_vec1::<f64>().unwrap()[0], found.collect())
        }

        pub(super) fn value(&self, term: &dyn RayTerm) -> f64 {
            self.differentiated(term).0
        }
    }

    /// Each term's derivatives, which are candle's, in density and its gradients are those of differences of the term.
    #[test]
    fn slopes_are_those_of_differences() {
        let four = [0.3, 0.9, 0.2, 0.6];
        let slopes = (0..12).map(|i| (1.7 * f64::from(i)).sin()).collect();
        // The factor has no gradient; on rays that end in something opaque it does not move.
        let of_pixel = |i: usize| [0.1 + 0.07 * ((i * 37 % 11) as f64), 0.1 + 0.05 * ((i * 23 % 13) as f64), 1e6];
        let opaque: Vec<f64> = (0..RayGroup::Patch.rays()).flat_map(of_pixel).collect();
        let terms: [(&dyn RayTerm, TestRay); 11] = [
            (&Distortion, rays(&four, 2.0)),
            (&Distortion, between_edges(&four, 2.0)),
            (&Occlusion { share: 0.6 }, rays(&four, 2.0)),
            (&Entropy, rays(&four, 2.0)),
            (&Entropy, between_edges(&four, 2.0)),
            (&Cauchy, rays(&four, 2.0)),
            (&OpacityPrior, between_edges(&four, 2.0)),
            (&InformationGain, pair(&[four, [0.4, 0.1, 0.8, 1.0]].concat(), 3.0)),
            (&Orientation, rays(&four, 4.0).sloped(slopes)),
            (&SparseDepth, rays(&four, 4.0).with_point(1.3)),
            (&DepthSmoothness, patch(&opaque, 3, 2.0).edged()),
        ];
        terms.iter().for_each(|(term, ray)| assert_slopes_by_differences(*term, ray));
    }

    fn assert_slopes_by_differences(term: &dyn RayTerm, ray: &TestRay) {
        let (_, found) = ray.differentiated(term);
        for (i, found) in found.iter().enumerate() {
            let moved = |by: f64| {
                let (mut density, mut slopes) = (ray.density.clone(), ray.slopes.clone());
                *density.iter_mut().chain(&mut slopes).nth(i).expect("as many as were found") += by;
                TestRay { density, slopes, ..*ray }.value(term)
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((found - slope).abs() < 1e-7, "{}, {i}: {found} for {slope}", term.name());
        }
    }
}
