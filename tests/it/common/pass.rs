//! A pass of a small field, with all that a loss of deltas needs.

use augnerf::base::rng::{Random, Stream};
use augnerf::data::{RayBuffer, RayParts, Rays};
use augnerf::field::Field;
use augnerf::perturb::{
    AttackGeometry, Deltas, Distribution, PaperSite, PassGeometry, Passes, PixelScale, Sets, worst_case,
};
use augnerf::render::{Pass, Perturbation, PlacedSamples, perturbed_pass, photometric_loss, sampling};
use augnerf::settings::{Method, PerturbConfig, Resolved, Spacing};
use candle_core::{DType, Device, Tensor};

use super::{tiny_config, tiny_scene};

/// A coarse pass on `t_vals` between 0 and 1, of a field 16 wide.
pub fn geometry<'a>(t_vals: &'a Tensor, direction_norm: &'a Tensor) -> PassGeometry<'a> {
    let samples = t_vals.dims()[1];
    let pixel = PixelScale { width: 16.0, height: 16.0, focal: 20.0, ndc: false };
    let run =
        AttackGeometry { bounds: (0.0, 1.0), pixel, coarse_samples: samples, are_even: false, width: 16, paper: None };
    PassGeometry { run, is_coarse: true, t_vals, samples, direction_norm }
}

/// Rays of the tiny scene through a new field, with density noise, on white.
pub struct Setting {
    pub config: Resolved,
    pub field: Field,
    pub rays: Rays,
    pub samples: PlacedSamples,
    pub noise: Option<Tensor>,
    pub background: Option<[f32; 3]>,
    pub target: Tensor,
    pub sets: Sets,
}

impl Setting {
    /// So many rays and samples. Sites that are off by default are on, too.
    pub fn new(
        method: Method,
        seed: u64,
        (rays, samples): (usize, usize),
        dtype: DType,
        change: impl FnOnce(&mut PerturbConfig),
    ) -> Setting {
        let config = tiny_config(method, |config| {
            PaperSite::ALL.into_iter().for_each(|site| config.perturb[site].passes = Passes::Both);
            change(&mut config.perturb);
        });
        let scene = tiny_scene();
        let mut random = Random::new(seed, Stream::Jitter, 0);
        let pixels: Vec<_> = (0..rays).map(|_| (&scene.train[0].camera, random.below(16), random.below(16))).collect();
        let rays = RayBuffer::new(&pixels, None, Default::default(), RayParts::ALL);
        let rays = rays.to_tensors(dtype, &Device::Cpu).unwrap();
        let mut draw = |shape: &[usize]| random.uniform_tensor(shape, dtype, &Device::Cpu).unwrap();
        let columns = samples + usize::from(method.encoding().at_intervals());
        let jitter = draw(&[rays.len(), columns]);
        let (bounds, depth) = ((2.0, 6.0), Spacing::Depth);
        let t_vals = sampling::stratified(bounds, depth, rays.len(), columns, Some(&jitter), &rays.origins).unwrap();
        let (noise, target) = (draw(&[rays.len(), samples]), draw(&[rays.len(), 3]));
        let geometry = geometry(&t_vals, &rays.direction_norm);
        let geometry = PassGeometry { samples, run: AttackGeometry { bounds, ..geometry.run }, ..geometry };
        let sets = Sets::new(config.perturb.sites_of_pass(&config.numbers, geometry.is_coarse), &geometry).unwrap();
        let field = Field::init(&config.field, seed, 0, dtype, &Device::Cpu).unwrap();
        let samples = PlacedSamples::all(t_vals);
        Setting { config, field, rays, samples, noise: Some(noise), background: Some([1.0; 3]), target, sets }
    }

    pub fn pass(&self) -> Pass<'_> {
        let Setting { rays, samples, noise, background, .. } = self;
        Pass { density_noise: noise.as_ref(), ..Pass::noiseless(rays, samples, *background) }
    }

    pub fn perturbation<'a>(&'a self, deltas: &'a Deltas) -> Perturbation<'a> {
        let (injection_layer, output) = (self.config.perturb.injection_layer, self.config.perturb.output);
        Perturbation { deltas, sets: &self.sets, injection_layer, output }
    }

    /// Loss with a tracked graph, and the deltas as used.
    pub fn loss(&self, deltas: &Deltas) -> (Tensor, Deltas) {
        let out = perturbed_pass(&self.field, self.pass(), self.perturbation(deltas)).unwrap();
        (photometric_loss(&out.composite.rgb, &self.target).unwrap(), out.used.deltas)
    }

    pub fn loss_value(&self, deltas: &Deltas) -> f64 {
        self.loss(deltas).0.to_scalar().unwrap()
    }

    pub fn draw(&self, index: u64) -> Deltas {
        self.sets.draw(Distribution::Uniform, 0, |part| Random::part(3, Stream::Search, index, part)).unwrap()
    }

    pub fn search(&self, start: Deltas) -> Deltas {
        let frozen = self.field.frozen().unwrap();
        worst_case(&self.sets, start, |deltas, _| {
            let out = perturbed_pass(&frozen, self.pass(), self.perturbation(deltas))?;
            Ok((photometric_loss(&out.composite.rgb, &self.target)?, out.used.deltas))
        })
        .unwrap()
    }
}
