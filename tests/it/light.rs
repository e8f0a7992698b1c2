//! One operation from raw output to the loss gives the numbers of many, to the bit: forward and back.

use crate::common::flat;
use crate::common::pass::Setting;
use augnerf::base::rng::{Random, Stream};
use augnerf::field::Field;
use augnerf::perturb::{Deltas, Draw, Norm, PaperSite, SiteSet};
use augnerf::render::{PassLoss, clean_pass, clean_pass_loss, perturbed_pass, perturbed_pass_loss};
use augnerf::settings::{Contraction, DensityActivation, Encoding, FieldConfig, HashConfig, Method};
use candle_core::{DType, Device, Tensor, Var};

const CPU: Device = Device::Cpu;

/// A pass of a small f32 field, with density noise and a background, or with neither.
fn small(method: Method, rich: bool, norm: Norm) -> Setting {
    let setting = Setting::new(method, 5, (5, 7), DType::F32, |config| {
        config[PaperSite::Rgb].epsilon = Some(0.1.into());
        config[PaperSite::Rgb].norm = Some(norm);
        config[PaperSite::Density].epsilon = Some(0.3.into());
    });
    let noise = setting.noise.clone().filter(|_| rich);
    Setting { noise, background: rich.then_some([0.9, 0.2, 0.4]), ..setting }
}

/// The same of a field of another kind.
fn of(setting: Setting, config: FieldConfig) -> Setting {
    let field = Field::init(&config, 1, 0, DType::F32, &CPU).unwrap();
    Setting { field, ..setting }
}

fn in_exp(setting: Setting) -> Setting {
    let config = FieldConfig { density_activation: DensityActivation::Exp, ..setting.field.config().clone() };
    of(setting, config)
}

/// On a hash grid as training makes them, in a box that rays enter and leave; of a method with intervals, as grids
/// have them.
fn on_a_grid(setting: Setting) -> Setting {
    let hash = HashConfig {
        levels: 4,
        log2_table: 8,
        coarsest: 3,
        finest: Some(14),
        bounds: Some([[-1.2; 3], [1.4; 3]]),
        contraction: Some(Contraction::None),
        ..HashConfig::default()
    };
    let density_activation = DensityActivation::Exp;
    let config = FieldConfig { encoding: Encoding::Hash, hash, density_activation, ..setting.field.config().clone() };
    let setting = of(setting, config);
    let mut values: Vec<Tensor> = setting.field.variables().iter().map(|(_, var)| var.as_tensor().clone()).collect();
    values[0] = (&values[0] * 1e4).unwrap();
    let field = Field::from_parameters(setting.field.config(), values).unwrap();
    Setting { field, ..setting }
}

/// A random delta of each site, tracked.
fn deltas(setting: &Setting) -> (Deltas, Vec<Var>) {
    let mut deltas = setting.sets.draw(Draw::Uniform, 0, |part| Random::part(3, Stream::Search, 0, part)).unwrap();
    let mut variables = Vec::new();
    for SiteSet { site, .. } in setting.sets.iter() {
        let site = site.name();
        // Beyond the set's end, too: what is used is projected.
        let variable = Var::from_tensor(&(deltas.get(site).unwrap() * 1.3).unwrap()).unwrap();
        deltas.set(site, variable.as_tensor().clone());
        variables.push(variable);
    }
    (deltas, variables)
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
        let new = |method| small(method, rich, norm);
        let points = new(Method::AugNerf);
        let [exp, grid] = [in_exp(new(Method::AugNerf)), on_a_grid(new(Method::AugMipNerf))];
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
    for off in [None, Some(PaperSite::Rgb), Some(PaperSite::Density)] {
        for (name, mut setting) in settings(Norm::Linf) {
            if let Some(off) = off {
                setting.sets = setting.sets.iter().filter(|entry| entry.site.at() != off).cloned().collect();
            }
            let (one, many) = (setting.field.recording().unwrap(), setting.field.recording().unwrap());
            let (deltas, variables) = deltas(&setting);
            let (lit, used) =
                perturbed_pass_loss(&one, setting.pass(), setting.perturbation(&deltas), &setting.target).unwrap();
            let plain = perturbed_pass(&many, setting.pass(), setting.perturbation(&deltas)).unwrap();
            for SiteSet { site, .. } in setting.sets.iter() {
                let site = site.name();
                let (found, expected) = (used.get(site).unwrap(), plain.used.deltas.get(site).unwrap());
                assert_eq!(bits(found), bits(expected), "{name}: delta of {site}");
            }
            let plain = PassLoss::of(plain.pass, &setting.target).unwrap();
            assert!(!lit.composite.rgb.track_op() && plain.composite.rgb.track_op(), "one of two ways");
            let (found, expected) = (all(&one, &lit, &variables), all(&many, &plain, &variables));
            let equal: Vec<bool> = found.iter().zip(&expected).map(|(found, expected)| found == expected).collect();
            assert!(equal.iter().all(|equal| *equal), "{name} {off:?}: {equal:?}");
        }
    }
}

/// A NaN in the weights reaches the loss.
#[test]
fn nan_is_not_swallowed() {
    let setting = small(Method::AugNerf, true, Norm::Linf);
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
