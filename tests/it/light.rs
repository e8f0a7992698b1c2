//! One operation from raw output to the loss gives the numbers of many, to the bit: forward and back.

use crate::common::{flat, tiny_config, tiny_scene};
use augnerf::augment::{Deltas, Draw, Norm, PassGeometry, Passes, PixelScale, SampleDensity, Sets, Site};
use augnerf::base::rng::{Random, Stream};
use augnerf::data::{RayBuffer, RayParts, Rays};
use augnerf::field::Field;
use augnerf::render::{
    Pass, PassLoss, Perturbation, clean_pass, clean_pass_loss, perturbed_pass, perturbed_pass_loss, sampling,
};
use augnerf::settings::{Contraction, DensityActivation, Encoding, FieldConfig, HashConfig, Method, Resolved};
use candle_core::{DType, Device, Tensor, Var};

const CPU: Device = Device::Cpu;
const RAYS: usize = 5;
const SAMPLES: usize = 7;

/// A pass of a small f32 field.
struct Setting {
    config: Resolved,
    field: Field,
    rays: Rays,
    t_vals: Tensor,
    noise: Option<Tensor>,
    background: Option<[f32; 3]>,
    target: Tensor,
    sets: Sets,
}

impl Setting {
    /// With density noise and a background, or with neither.
    fn new(method: Method, rich: bool, norm: Norm) -> Setting {
        let config = tiny_config(method, |config| {
            config.perturb.sites.iter_mut().for_each(|(_, site)| site.passes = Passes::Both);
            config.perturb.sites[Site::Rgb].epsilon = Some(0.1.into());
            config.perturb.sites[Site::Rgb].norm = Some(norm);
            config.perturb.sites[Site::Density].epsilon = Some(0.3.into());
        });
        let scene = tiny_scene();
        let pixels: Vec<_> = (0..RAYS as u32).map(|i| (&scene.train[0].camera, 3 * i, 15 - 2 * i)).collect();
        let rays =
            RayBuffer::new(&pixels, None, Default::default(), RayParts::ALL).to_tensors(DType::F32, &CPU).unwrap();
        let mut random = Random::new(5, Stream::Jitter, 0);
        let mut draw = |shape: &[usize]| random.uniform_tensor(shape, DType::F32, &CPU).unwrap();
        let columns = SAMPLES + usize::from(method.encoding().at_intervals());
        let jitter = draw(&[RAYS, columns]);
        let t_vals = sampling::stratified(
            (2.0, 6.0),
            augnerf::settings::Spacing::Depth,
            RAYS,
            columns,
            Some(&jitter),
            &rays.origins,
        )
        .unwrap();
        let (noise, target) = (draw(&[RAYS, SAMPLES]), draw(&[RAYS, 3]));
        let geometry = PassGeometry {
            is_coarse: true,
            t_vals: &t_vals,
            samples: SAMPLES,
            direction_norm: &rays.direction_norm,
            bounds: (2.0, 6.0),
            coarse_samples: columns,
            cap_samples: columns,
            width: config.field.width,
            pixel: PixelScale { width: 16.0, height: 16.0, focal: 20.0, ndc: false },
            density: SampleDensity::OWN,
        };
        let sets = Sets::new(&config.perturb.numbers, &config.perturb.set_choices(), &geometry).unwrap();
        let field = Field::init(&config.field, 1, 0, DType::F32, &CPU).unwrap();
        let (noise, background) = (rich.then_some(noise), rich.then_some([0.9, 0.2, 0.4]));
        Setting { config, field, rays, t_vals, noise, background, target, sets }
    }

    /// The same of a field of another kind.
    fn of(self, config: FieldConfig) -> Setting {
        let field = Field::init(&config, 1, 0, DType::F32, &CPU).unwrap();
        Setting { field, ..self }
    }

    fn in_exp(self) -> Setting {
        let config = FieldConfig { density_activation: DensityActivation::Exp, ..self.field.config().clone() };
        self.of(config)
    }

    /// On a hash grid as training makes them, in a box that rays enter and leave; of a method with intervals, as grids
    /// have them.
    fn on_a_grid(self) -> Setting {
        let hash = HashConfig {
            levels: 4,
            log2_table: 8,
            coarsest: 3,
            finest: Some(14),
            bounds: Some([[-0.7; 3], [0.9; 3]]),
            contraction: Some(Contraction::None),
            ..HashConfig::default()
        };
        let density_activation = DensityActivation::Exp;
        let config = FieldConfig { encoding: Encoding::Hash, hash, density_activation, ..self.field.config().clone() };
        let setting = self.of(config);
        let mut values: Vec<Tensor> =
            setting.field.variables().iter().map(|(_, var)| var.as_tensor().clone()).collect();
        values[0] = (&values[0] * 1e4).unwrap();
        let field = Field::from_parameters(setting.field.config(), values).unwrap();
        Setting { field, ..setting }
    }

    fn pass(&self) -> Pass<'_> {
        let Setting { rays, t_vals, noise, background, .. } = self;
        Pass { rays, t_vals, density_noise: noise.as_ref(), background: *background, scales_gradients: false }
    }

    /// A random delta of each site, tracked.
    fn deltas(&self) -> (Deltas, Vec<Var>) {
        let mut deltas = self.sets.draw(Draw::Uniform, |site| Random::part(3, Stream::Search, 0, site as u64)).unwrap();
        let mut variables = Vec::new();
        for (site, _) in self.sets.iter() {
            // Beyond the set's end, too: what is used is projected.
            let variable = Var::from_tensor(&(deltas.get(site).unwrap() * 1.3).unwrap()).unwrap();
            deltas.set(site, variable.as_tensor().clone());
            variables.push(variable);
        }
        (deltas, variables)
    }
}

fn bits(tensor: &Tensor) -> Vec<u32> {
    flat(&tensor.to_dtype(DType::F64).unwrap()).into_iter().map(|value| (value as f32).to_bits()).collect()
}

/// What a pass shows, and after going back from a weighted loss, every gradient: of `variables`, then of the weights.
fn all(field: &Field, out: &PassLoss, variables: &[Var]) -> Vec<Vec<u32>> {
    let store = (&out.loss * 0.37).unwrap().backward().unwrap();
    let composite = &out.composite;
    let mut found: Vec<Vec<u32>> = [
        &out.loss,
        &composite.rgb,
        &composite.depth,
        &composite.acc,
        &composite.weights,
        &out.t_vals,
        &out.raw_density,
    ]
    .map(bits)
    .to_vec();
    found.extend(variables.iter().map(|variable| store.get(variable).map_or(Vec::new(), bits)));
    found.extend(field.recorded().unwrap().iter().flatten().map(bits));
    found.extend(field.table_gradient(&field.table_records()).unwrap().iter().map(bits));
    found
}

/// Fields of every activation, at points and at Gaussians, and on a grid that ends; poor settings and rich ones.
fn settings(norm: Norm) -> Vec<(String, Setting)> {
    let of = |rich: bool| {
        let new = |method| Setting::new(method, rich, norm);
        let points = new(Method::AugNerf);
        let [exp, grid] = [new(Method::AugNerf).in_exp(), new(Method::AugMipNerf).on_a_grid()];
        [("ReLU", points), ("softplus", new(Method::AugMipNerf)), ("exp", exp), ("grid", grid)]
            .map(|(name, setting)| (format!("{name}, rich: {rich}"), setting))
    };
    [false, true].into_iter().flat_map(of).collect()
}

#[test]
fn a_clean_pass_is_lit_by_one_operation() {
    for (name, setting) in settings(Norm::Linf) {
        let (one, many) = (setting.field.recording().unwrap(), setting.field.recording().unwrap());
        let lit = clean_pass_loss(&one, setting.pass(), &setting.target).unwrap();
        let plain = PassLoss::of(clean_pass(&many, setting.pass()).unwrap(), &setting.target).unwrap();
        assert!(!lit.composite.rgb.track_op() && plain.composite.rgb.track_op(), "one of two ways");
        let found = all(&one, &lit, &[]);
        assert!(found.iter().flatten().any(|&bits| bits != 0));
        assert_eq!(found, all(&many, &plain, &[]), "{name}");
    }
}

#[test]
fn a_perturbed_pass_is_lit_by_one_operation() {
    for off in [None, Some(Site::Rgb), Some(Site::Density)] {
        for (name, mut setting) in settings(Norm::Linf) {
            if let Some(off) = off {
                let mut kept = Sets::default();
                let sites = setting.sets.iter().filter(|(site, _)| *site != off);
                sites.for_each(|(site, set)| kept.set(site, set.clone()));
                setting.sets = kept;
            }
            let (one, many) = (setting.field.recording().unwrap(), setting.field.recording().unwrap());
            let perturb = &setting.config.perturb;
            let (deltas, variables) = setting.deltas();
            let perturbation = |deltas| Perturbation {
                deltas,
                sets: &setting.sets,
                injection_layer: perturb.injection_layer,
                output: perturb.output,
            };
            let (lit, used) =
                perturbed_pass_loss(&one, setting.pass(), perturbation(&deltas), &setting.target).unwrap();
            let plain = perturbed_pass(&many, setting.pass(), perturbation(&deltas)).unwrap();
            for (site, _) in setting.sets.iter() {
                let (found, expected) = (used.get(site).unwrap(), plain.used.deltas.get(site).unwrap());
                assert_eq!(bits(found), bits(expected), "{name}: delta of {}", site.name());
            }
            let plain = PassLoss::of(plain.pass, &setting.target).unwrap();
            assert!(!lit.composite.rgb.track_op() && plain.composite.rgb.track_op(), "one of two ways");
            let (found, expected) = (all(&one, &lit, &variables), all(&many, &plain, &variables));
            let equal: Vec<bool> = found.iter().zip(&expected).map(|(found, expected)| found == expected).collect();
            assert!(equal.iter().all(|equal| *equal), "{name} {off:?}: {equal:?}");
        }
    }
}

/// On a grid that ends rays have samples on both sides, of which those outside add nothing and learn nothing.
#[test]
fn samples_outside_a_grid_are_empty() {
    let setting = Setting::new(Method::AugMipNerf, true, Norm::Linf).on_a_grid();
    let field = setting.field.recording().unwrap();
    let lit = clean_pass_loss(&field, setting.pass(), &setting.target).unwrap();
    let (raw, weights) = (flat(&lit.raw_density), flat(&lit.composite.weights));
    let outside: Vec<usize> = (0..raw.len()).filter(|&i| raw[i] == -1e4).collect();
    assert!((5..raw.len() - 5).contains(&outside.len()), "{raw:?}");
    assert!(outside.iter().all(|&i| weights[i] == 0.0) && weights.iter().any(|weight| *weight > 0.01), "{weights:?}");
    lit.loss.backward().unwrap();
    let records = field.table_records();
    assert_eq!(records.iter().map(|record| record.count()).sum::<usize>(), raw.len());
    assert!(flat(&field.table_gradient(&records).unwrap().unwrap()).iter().any(|gradient| *gradient != 0.0));
}

/// What it cannot do goes the long way: a ball of colours.
#[test]
fn other_sets_go_the_long_way() {
    let setting = Setting::new(Method::AugNerf, true, Norm::L2);
    let (deltas, _) = setting.deltas();
    let perturb = &setting.config.perturb;
    let (injection_layer, output) = (perturb.injection_layer, perturb.output);
    let perturbation = Perturbation { deltas: &deltas, sets: &setting.sets, injection_layer, output };
    let recording = setting.field.recording().unwrap();
    let (out, _) = perturbed_pass_loss(&recording, setting.pass(), perturbation, &setting.target).unwrap();
    assert!(out.composite.rgb.track_op());
}

/// A NaN in the weights reaches the loss.
#[test]
fn nan_is_not_swallowed() {
    let setting = Setting::new(Method::AugNerf, true, Norm::Linf);
    let names: Vec<String> = setting.field.variables().iter().map(|(name, _)| name.clone()).collect();
    for broken in ["rgb.bias", "density.bias"] {
        let values = setting.field.variables().iter().zip(&names).map(|((_, var), name)| {
            if name == broken { (var.as_tensor() * f64::NAN).unwrap() } else { var.as_tensor().clone() }
        });
        let field = Field::from_parameters(setting.field.config(), values.collect()).unwrap().recording().unwrap();
        let out = clean_pass_loss(&field, setting.pass(), &setting.target).unwrap();
        assert!(out.loss.to_scalar::<f32>().unwrap().is_nan(), "{broken}");
    }
}
