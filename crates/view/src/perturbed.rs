//! What the attack sees: rays rendered with the deltas of some sites.

use candle_core::Tensor;

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::{RayParts, Rays, Scene};
use crate::methods::Fields;
use crate::perturb::{AttackGeometry, Deltas, Distribution, PassGeometry, Sets, SiteSet};
use crate::render::{Pass, PassOutput, Perturbation, clean_pass, perturbed_pass, ray_parts, sample_count, search};
use crate::settings::Resolved;

/// Which deltas are added, and how much of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Attack {
    /// The sites that are on, by name.
    pub sites: Vec<String>,
    /// Factor on their deltas after the search. 1 is what training sees, 0 the clean pass.
    pub scale: f64,
}

/// Renders rays with the worst case of a run's own constraint sets: what PGD finds within them in the evaluated pass, with the
/// run's steps and step sizes. Random starts depend on the rays' number in their part alone, so a picture stays as it is.
pub struct PerturbedRenderer {
    fields: Fields,
    config: Resolved,
    geometry: AttackGeometry,
    background: Option<[f32; 3]>,
}

impl PerturbedRenderer {
    /// Creates a renderer of fields with their current weights.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(fields: &Fields, config: &Resolved, scene: &Scene) -> Result<PerturbedRenderer> {
        let (geometry, background) = (AttackGeometry::new(config, scene), scene.background);
        Ok(PerturbedRenderer { fields: fields.frozen()?, config: config.clone(), geometry, background })
    }

    /// Returns the parts of rays that it needs.
    pub fn ray_parts(&self) -> RayParts {
        RayParts { tangents: true, ..ray_parts(self.fields.evaluated()) }
    }

    /// Returns the names of the sites that can be on: those whose sets are larger than a point. If the run's own method has
    /// none on, as NeRF, they are those that Aug-NeRF has with the run's settings.
    pub fn sites(&self) -> Vec<&'static str> {
        let numbers = self.config.numbers.iter();
        numbers.filter(|(_, numbers)| numbers.on() && numbers.perturbs()).map(|(site, _)| site.spec().name).collect()
    }

    /// Runs the evaluated pass with the deltas of `attack`. Without sites it is the clean pass. The search raises the squared
    /// distance to `target`, `[rays, 3]`: photographed colours, or without them the clean pass's own. `part` numbers the rays'
    /// random starts.
    ///
    /// # Errors
    /// Those of candle.
    pub fn pass(&self, rays: &Rays, target: Option<&Tensor>, attack: &Attack, part: u64) -> Result<PassOutput> {
        let (field, is_coarse) = (self.fields.evaluated(), self.fields.fine().is_none());
        let evaluation = self.fields.evaluation(&self.config.sampling, self.geometry.bounds, self.background);
        let placed = evaluation.samples(rays)?;
        let pass = Pass::noiseless(rays, &placed, self.background);
        let (t_vals, direction_norm) = (&placed.t_vals, &rays.direction_norm);
        let samples = sample_count(field, t_vals)?;
        let geometry = PassGeometry { run: self.geometry, is_coarse, t_vals, samples, direction_norm };
        let mut sites = self.config.perturb.sites_of_pass(&self.config.numbers, is_coarse);
        sites.retain(|site| attack.sites.iter().any(|name| name == site.name()));
        let mut sets = Sets::new(sites, &geometry)?;
        let clean;
        let target = match target {
            Some(target) => target,
            None => {
                clean = clean_pass(field, pass)?.composite.rgb;
                &clean
            }
        };
        let start =
            sets.draw(Distribution::Uniform, part, |part| Random::part(self.config.seed, Stream::View, 0, part))?;
        let found = search(field, pass, self.perturbation(&start, &sets), target, 1.0)?;
        let mut scaled = Deltas::default();
        for SiteSet { site, set } in sets.iter_mut() {
            let Some(delta) = found.get(site.name()) else { continue };
            let scaled_up = (delta.detach() * attack.scale)?;
            if site.at().spec().largest_epsilon.0 < f64::MAX {
                // Its set ends where deltas lose their meaning: samples would pass each other.
                scaled.insert(site.name(), set.project(&scaled_up)?);
                continue;
            }
            scaled.insert(site.name(), scaled_up);
            // What is scaled up leaves its set on purpose.
            set.radius = (&set.radius * attack.scale.max(1.0))?;
        }
        perturbed_pass(field, pass, self.perturbation(&scaled, &sets))
    }

    fn perturbation<'a>(&self, deltas: &'a Deltas, sets: &'a Sets) -> Perturbation<'a> {
        let perturb = &self.config.perturb;
        Perturbation { deltas, sets, injection_layer: perturb.injection_layer, output: perturb.output }
    }
}
