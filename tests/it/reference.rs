//! The numeric core against numbers of independent implementations: nerf-pytorch 63a5a63 in f32
//! (`numeric_core`) and an f64 implementation of the perturbed pass and two search steps
//! (`attack`).

use crate::common::flat;
use crate::common::reference::Reference;
use augnerf::data::Rays;
use augnerf::field::{Field, encode};
use augnerf::perturb::{AttackGeometry, DeltaSet, Deltas, Norm, PaperSite, PassGeometry, PixelScale, Sets, worst_case};
use augnerf::render::sampling::inverse_cdf;
use augnerf::render::{Pass, PassOutput, Perturbation, PlacedSamples, perturbed_pass, photometric_loss, volume};
use augnerf::settings::{FieldConfig, OutputPlace, PerturbConfig};
use candle_core::{DType, Device, Tensor, Var};

/// Relative tolerance of sums in f32: a few hundred terms of relative error 6e-8.
const F32: f64 = 2e-5;
/// The fixture's sites.
const SITES: [PaperSite; 6] =
    [PaperSite::T, PaperSite::Xyz, PaperSite::View, PaperSite::Feature, PaperSite::Rgb, PaperSite::Density];
/// f64 against f64: only the order of sums differs.
const F64: f64 = 1e-10;

/// A field with the reference's weights.
fn field(reference: &Reference, config: &FieldConfig, rename: impl Fn(&str) -> String) -> Field {
    let names = Field::parameter_names(config);
    let values = names.iter().map(|(name, _)| reference.get(&rename(name))).collect();
    Field::from_parameters(config, values).unwrap()
}

/// Largest difference, relative to the largest magnitude of the expected tensor.
fn assert_close(what: &str, found: &Tensor, expected: &Tensor, tolerance: f64) {
    assert_eq!(found.dims(), expected.dims(), "{what}: shapes differ");
    let (found, expected) = (flat(found), flat(expected));
    let scale = expected.iter().fold(0f64, |m, v| m.max(v.abs())).max(1e-30);
    let worst = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0f64, f64::max);
    assert!(found.iter().all(|v| v.is_finite()), "{what}: not finite");
    assert!(worst <= tolerance * scale, "{what}: differs by {worst:e} at scale {scale:e}");
}

fn width(width: usize) -> FieldConfig {
    FieldConfig { width, ..FieldConfig::default() }
}

#[test]
fn encoding() {
    let r = Reference::load("numeric_core");
    // Angles reach 2^9: an ulp of the angle moves the sine by 512 * 6e-8.
    assert_close("position", &encode(&r.get("encode.x"), 10).unwrap(), &r.get("encode.x_out"), 1e-4);
    assert_close("direction", &encode(&r.get("encode.d"), 4).unwrap(), &r.get("encode.d_out"), 1e-5);
}

fn nerf_pytorch_name(ours: &str) -> String {
    let (layer, kind) = ours.rsplit_once('.').unwrap();
    let theirs = match layer {
        "density" => "alpha_linear".to_string(),
        "feature" => "feature_linear".to_string(),
        "rgb" => "rgb_linear".to_string(),
        "view" => "views_linears.0".to_string(),
        trunk => trunk.replace("trunk.", "pts_linears."),
    };
    format!("{theirs}.{kind}")
}

#[test]
fn field_output_and_weight_gradients() {
    let r = Reference::load("numeric_core");
    let field = field(&r, &width(64), |name| format!("mlp.{}", nerf_pytorch_name(name)));
    let (x, d) = (r.get("encode.x"), r.get("encode.d"));
    let raw = field.forward(&x, &d, None).unwrap();
    let out = Tensor::cat(&[&raw.rgb, &raw.density.unsqueeze(1).unwrap()], 1).unwrap();
    // The encoding's error (see above) passes through ten layers of gain about 1; gradients sum it
    // over 64 points.
    assert_close("raw", &out, &r.get("mlp.raw_out"), 1e-4);
    let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    for (name, var) in field.variables() {
        let expected = r.get(&format!("mlp.grad.{}", nerf_pytorch_name(name)));
        assert_close(name, gradients.get(var).unwrap(), &expected, 1e-3);
    }
}

#[test]
fn volume_rendering_and_its_gradients() {
    let r = Reference::load("numeric_core");
    for (name, background) in [("white0", None), ("white1", Some([1.0; 3]))] {
        let raw = Var::from_tensor(&r.get("render.raw")).unwrap();
        let z = Var::from_tensor(&r.get("render.z")).unwrap();
        let norm = r.get("render.rays_d").sqr().unwrap().sum_keepdim(1).unwrap().sqrt().unwrap();
        let rgb = candle_nn::ops::sigmoid(&raw.narrow(2, 0, 3).unwrap()).unwrap();
        let density = raw.narrow(2, 3, 1).unwrap().squeeze(2).unwrap().relu().unwrap();
        let out = volume::composite(&rgb, &density, &z, &norm, background).unwrap();
        let expected = |what: &str| r.get(&format!("render.{name}.{what}"));
        assert_close("rgb", &out.rgb, &expected("rgb"), F32);
        assert_close("depth", &out.depth, &expected("depth"), F32);
        assert_close("acc", &out.acc, &expected("acc"), F32);
        assert_close("weights", &out.weights, &expected("weights"), F32);
        let disparity = (&out.acc / &out.depth).unwrap();
        assert_close("disp", &disparity, &expected("disp"), F32);
        let gradients = out.rgb.sqr().unwrap().sum_all().unwrap().backward().unwrap();
        // The reference adds 1e-10 to each factor of the transmittance, and its last interval is
        // 1e10 long: their product is an error of order 1 in places where the gradient is large.
        assert_close("gradient in raw", gradients.get(&raw).unwrap(), &expected("grad_raw"), 1e-4);
        assert_close("gradient in z", gradients.get(&z).unwrap(), &expected("grad_z"), 1e-4);
    }
}

#[test]
fn inverse_cdf_samples() {
    let r = Reference::load("numeric_core");
    let rows = |name: &str| r.get(name).to_dtype(DType::F64).unwrap().to_vec2::<f64>().unwrap();
    let u: Vec<f64> = (0..48).map(|i| i as f64 / 47.0).collect();
    let mut found = Vec::new();
    for (bins, weights) in rows("pdf.bins").iter().zip(rows("pdf.weights")) {
        let mut out = vec![0.0; 48];
        inverse_cdf(bins, &weights, &u, &mut out);
        found.extend(out);
    }
    let expected = r.get("pdf.samples_det_48");
    let found = Tensor::from_vec(found, (16, 48), &Device::Cpu).unwrap();
    // Errors of an f32 CDF are divided by the bin's share.
    assert_close("samples", &found, &expected, 1e-4);
}

/// The fixture's pass: a field of width 16, five rays, seven samples.
struct Attack {
    reference: Reference,
    field: Field,
    rays: Rays,
    samples: PlacedSamples,
    target: Tensor,
    sets: Sets,
}

impl Attack {
    fn load() -> Attack {
        let reference = Reference::load("attack");
        let input = |name: &str| reference.get(&format!("in.{name}"));
        let field = field(&reference, &width(16), |name| format!("net.{name}"));
        let rays = Rays::new(input("origins"), input("directions"), input("viewdirs")).unwrap();
        let rays = Rays { tangents: Some([input("tangent_u"), input("tangent_w")]), ..rays };
        let (t_vals, target) = (input("t_vals"), input("target"));
        // Radii and step sizes of attack.json.
        let mut config = PerturbConfig::default();
        let numbers = [(0.5, 0.03), (1.0, 0.015), (1.0, 0.008), (0.05, 0.04), (0.03, 0.025), (0.4, 0.3)];
        for (site, (epsilon, step_size)) in SITES.into_iter().zip(numbers) {
            let delta = &mut config[site];
            (delta.steps, delta.step_size, delta.epsilon) = (Some(2), Some(step_size), Some(epsilon.into()));
        }
        let numbers = config.fill(1.0, 1, 16);
        // A focal length of 50 pixels makes the view's half pixel 0.01; the position's radius
        // (0.02 for every ray) is given outright.
        let pixel = PixelScale { width: 100.0, height: 100.0, focal: 50.0, ndc: false };
        let mut sets = Sets::new(
            config.sites_of_pass(&numbers, true),
            &PassGeometry {
                run: AttackGeometry {
                    bounds: (0.2, 1.8),
                    pixel,
                    coarse_samples: 7,
                    are_even: false,
                    width: 16,
                    paper: None,
                },
                is_coarse: true,
                t_vals: &t_vals,
                samples: 7,
                direction_norm: &rays.direction_norm,
            },
        )
        .unwrap();
        let radius = Tensor::new(&[[[0.02f64]]], &Device::Cpu).unwrap();
        let xyz = sets.iter_mut().find(|entry| entry.site.at() == PaperSite::Xyz).unwrap();
        xyz.set = DeltaSet::new(Norm::L2, radius, &[5, 7, 3]);
        Attack { reference, field, rays, samples: PlacedSamples::all(t_vals), target, sets }
    }

    fn pass(&self) -> Pass<'_> {
        Pass::noiseless(&self.rays, &self.samples, None)
    }

    fn perturbed(&self, field: &Field, deltas: &Deltas) -> PassOutput {
        let perturbation = Perturbation { deltas, sets: &self.sets, injection_layer: 4, output: OutputPlace::After };
        perturbed_pass(field, self.pass(), perturbation).unwrap()
    }

    fn deltas(&self, stage: &str) -> Deltas {
        let mut deltas = Deltas::default();
        for site in SITES {
            deltas.insert(site, self.reference.get(&format!("{stage}.{}", site.name())));
        }
        deltas
    }

    fn expected_loss(&self, name: &str) -> f64 {
        match name {
            "before_step_1" => 0.1221281423138489,
            "before_step_2" => 0.11055762901491999,
            "final" => 0.1290640610967148,
            _ => unreachable!(),
        }
    }
}

#[test]
fn gradients_of_the_perturbed_loss_in_every_delta() {
    let a = Attack::load();
    for (stage, gradient, loss_name) in [("start", "grad1", "before_step_1"), ("step1", "grad2", "before_step_2")] {
        let values = a.deltas(stage);
        let mut tracked = Deltas::default();
        let variables = SITES.map(|site| Var::from_tensor(values.get(site).unwrap()).unwrap());
        for site in SITES {
            tracked.insert(site, variables[site as usize].as_tensor().clone());
        }
        let out = a.perturbed(&a.field.frozen().unwrap(), &tracked);
        let loss = photometric_loss(&out.composite.rgb, &a.target).unwrap();
        assert!((loss.to_scalar::<f64>().unwrap() - a.expected_loss(loss_name)).abs() < 1e-12, "{stage}");
        let gradients = loss.backward().unwrap();
        for site in SITES {
            let expected = a.reference.get(&format!("{gradient}.{}", site.name()));
            let found = gradients.get(&variables[site as usize]).unwrap();
            assert_close(&format!("{gradient}.{}", site.name()), found, &expected, 1e-9);
        }
    }
}

#[test]
fn two_search_steps_and_the_final_pass() {
    let a = Attack::load();
    let frozen = a.field.frozen().unwrap();
    let mut iterates = Vec::new();
    // The fixture's start is projected already: densities on the floor are 0 there and an ulp above
    // it here, which decides whether a colour's gradient is 0 or has a sign. A start that lies
    // 1e-12 lower is projected onto the same floor exactly.
    let mut start = a.deltas("start");
    start.insert(PaperSite::Density, (start.get(PaperSite::Density).unwrap() - 1e-12).unwrap());
    let found = worst_case(&a.sets, start, |deltas, _| {
        let out = a.perturbed(&frozen, deltas);
        iterates.push(out.used.deltas.clone());
        Ok((photometric_loss(&out.composite.rgb, &a.target)?, out.used.deltas))
    })
    .unwrap();
    let last = a.perturbed(&a.field, &found);
    iterates.push(last.used.deltas.clone());
    for (stage, deltas) in ["start", "step1", "step2"].into_iter().zip(&iterates) {
        for site in SITES {
            let what = format!("{stage}.{}", site.name());
            assert_close(&what, &deltas.get(site).unwrap().detach(), &a.reference.get(&what), F64);
        }
    }
    let expected = |what: &str| a.reference.get(&format!("final.{what}"));
    let t_vals = (&a.samples.t_vals + found.get(PaperSite::T).unwrap()).unwrap();
    assert_close("t_vals", &t_vals, &expected("t_vals"), F64);
    let points = t_vals.unsqueeze(2).unwrap().broadcast_mul(&a.rays.directions.unsqueeze(1).unwrap()).unwrap();
    let points = points.broadcast_add(&a.rays.origins.unsqueeze(1).unwrap()).unwrap();
    assert_close("points", &(points + found.get(PaperSite::Xyz).unwrap()).unwrap(), &expected("points"), F64);
    assert_close("rgb", &last.rgb, &expected("rgb"), F64);
    assert_close("density", &last.density, &expected("density"), F64);
    assert_close("weights", &last.composite.weights, &expected("weights"), F64);
    assert_close("colour", &last.composite.rgb, &expected("colour"), F64);
    let view = found.get(PaperSite::View).unwrap();
    let along = |axis: usize, tangent: &Tensor| view.narrow(1, axis, 1).unwrap().broadcast_mul(tangent).unwrap();
    let [u, w] = a.rays.tangents.as_ref().unwrap();
    let moved = ((&a.rays.viewdirs + along(0, u)).unwrap() + along(1, w)).unwrap();
    let norm = moved.sqr().unwrap().sum_keepdim(1).unwrap().sqrt().unwrap();
    assert_close("view", &moved.broadcast_div(&norm).unwrap(), &expected("view"), F64);
    let loss = photometric_loss(&last.composite.rgb, &a.target).unwrap();
    assert!((loss.to_scalar::<f64>().unwrap() - a.expected_loss("final")).abs() < 1e-12);
    let gradients = loss.backward().unwrap();
    for (name, var) in a.field.variables() {
        assert_close(name, gradients.get(var).unwrap(), &a.reference.get(&format!("final.grad_net.{name}")), 1e-9);
    }
}

#[test]
fn spatial_derivatives_and_regularizers() {
    use augnerf::losses::{L1, Laplacian, SpaceTerm, Tv, regularize_at};
    let a = Attack::load();
    let points = a.reference.get("space.x");
    let spatial = a.field.spatial(&points).unwrap().at;
    assert_close("density", &spatial.density, &a.reference.get("space.density"), 1e-10);
    assert_close("gradient", &spatial.gradient, &a.reference.get("space.gradient"), 1e-10);
    assert_close("laplacian", &spatial.laplacian, &a.reference.get("space.laplacian"), 1e-10);
    let expected: [(&dyn SpaceTerm, f64); 3] =
        [(&L1, 0.5225246464423859), (&Tv, 95.72237654143709), (&Laplacian, 39850.54949532178)];
    for (term, value) in expected {
        let found = regularize_at(&a.field, &points, &[(term, 1.0)], 1.0 / 12.0).unwrap();
        let of_term = found.values.to_vec1::<f64>().unwrap()[0];
        assert!((of_term / value - 1.0).abs() < 1e-10, "{}: {of_term}", term.name());
        let mut compared = 0;
        for ((name, _), gradient) in a.field.variables().iter().zip(&found.gradients) {
            let key = format!("space.{}.grad_net.{name}", term.name());
            match (gradient, a.reference.find(&key)) {
                (Some(gradient), Some(expected)) => assert_close(&key, gradient, &expected, 1e-9),
                (None, None) => continue,
                // Biases do not reach the derivatives: absent here, 0 there.
                (None, Some(expected)) => assert_close(&key, &expected.zeros_like().unwrap(), &expected, 0.0),
                (Some(_), None) => panic!("{key} is not in the reference"),
            }
            compared += 1;
        }
        assert_eq!(compared, 18);
    }
}
