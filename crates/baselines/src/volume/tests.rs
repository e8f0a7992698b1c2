#![allow(clippy::needless_range_loop, reason = "rows of several tables are counted")]

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};

use super::cube::Cube;
use super::decoder::{Decoded, rotations};
use super::learner::{divergence, drawn, losses};
use super::parameters::{NeuralVolume, Sizes, WarpSizes, channels};
use crate::field::Density;
use crate::grids::conv3d::Conv3d;
use crate::grids::march::tests::check_samples;
use crate::grids::march::{Line, March, Pace};
use crate::grids::reference::{channels_last, error, fixture, on_any_threads, ramp, values, with_gradients};
use crate::grids::trilinear::{Outside, trilinear};
use crate::settings::{Config, VolumeCode, VolumeConfig, build, parse_assignment};

const CUBE: Cube = Cube { middle: [0.0; 3], half: 1.0 };

/// The original's decoder with the reference's sizes: what `part` of the fixture says of each parameter.
fn of_reference(part: &str) -> Vec<Tensor> {
    let read = |name: String| fixture(&format!("{part}.{name}"));
    let mut all = vec![read("mu".into()), read("logstd".into())];
    let product = Conv3d::transposed([1, 1, 1]);
    let order: Vec<u32> = product.kernel().iter().map(|[z, y, x]| ((z * 4 + y) * 4 + x) as u32).collect();
    let order = Tensor::new(order, &Device::Cpu).unwrap();
    for layer in 0..4 {
        let weight = read(format!("template.{layer}.weight"));
        all.push(if layer == 0 {
            weight
        } else {
            let flat = weight.flatten(2, 4).unwrap().permute([2, 0, 1]).unwrap().contiguous().unwrap();
            flat.index_select(&order, 0).unwrap()
        });
        all.push(read(format!("template.{layer}.bias")));
    }
    for head in ["scale", "quaternion", "translation", "weights"] {
        for (layer, what) in [(0, "weight"), (0, "bias"), (2, "weight"), (2, "bias")] {
            all.push(read(format!("warp.{head}.{layer}.{what}")));
        }
    }
    all
}

fn reference_volume(dtype: DType) -> NeuralVolume {
    let warp = Some(WarpSizes { maps: 2, hidden: [6, 4], side: 8 });
    let sizes = Sizes { code: 12, channels: vec![10, 5, 5, 4], warp };
    let values = of_reference("nv.full").iter().map(|tensor| tensor.to_dtype(dtype).unwrap()).collect();
    NeuralVolume::over(sizes, VolumeCode::Variational, CUBE, values).unwrap()
}

fn reference_march() -> March {
    let rows = |name: &str| fixture(name).to_vec2::<f64>().unwrap().into_iter().map(|row| [row[0], row[1], row[2]]);
    let lines: Arc<[Line]> =
        rows("nv.full.o").zip(rows("nv.full.u")).map(|(origin, direction)| Line { origin, direction }).collect();
    March { lines, step: values(&fixture("nv.full.dt"))[0], pace: Pace::Even }
}

#[test]
fn channels_are_the_originals() {
    for resolution in [32, 64, 128] {
        let expected = values(&fixture(&format!("nv.channels.{resolution}")));
        let found: Vec<f64> = channels(resolution, 1).into_iter().map(|count| count as f64).collect();
        assert_eq!(found, expected);
    }
    assert_eq!(channels(64, 4), [256, 128, 128, 64, 64, 32, 4]);
}

/// 66.4 million numbers of the template and 34.2 million of the warp.
#[test]
fn the_original_has_as_many_parameters() {
    let names = NeuralVolume::parameter_names(&Config { nv: VolumeConfig::default(), ..Config::default() });
    let count = |part: &str| -> usize {
        let of_part = names.iter().filter(|(name, _)| name.starts_with(part));
        of_part.map(|(_, shape)| shape.iter().product::<usize>()).sum()
    };
    assert!((count("volume.template.") as f64 / 66.36e6 - 1.0).abs() < 1e-3, "{}", count("volume.template."));
    assert!((count("volume.warp.") as f64 / 34.21e6 - 1.0).abs() < 1e-3, "{}", count("volume.warp."));
    assert_eq!(count("volume.code"), 256);
}

#[test]
fn rotations_are_the_originals() {
    let [quaternions, cotangent] = ["q", "cotangent"].map(|name| fixture(&format!("nv.quaternion.{name}")));
    let found = with_gradients(&[quaternions], &cotangent, |[quaternions]| rotations(quaternions));
    assert!(error(&found[0], &fixture("nv.quaternion.out")) < 1e-14);
    assert!(error(&found[1], &fixture("nv.quaternion.grad.q")) < 1e-13);
}

/// The decoded grids in f64 (rounded in the fixture) and f32.
#[test]
fn decoded_volumes_are_the_originals() {
    for (dtype, tolerance) in [(DType::F64, 2e-7), (DType::F32, 2e-6)] {
        let volume = reference_volume(dtype);
        let code = fixture("nv.decoder.in").to_dtype(dtype).unwrap();
        let found = on_any_threads(|| {
            let Decoded { template, warp } = volume.decode(&code, true).unwrap();
            vec![template, warp.unwrap()]
        });
        for (found, name) in found.iter().zip(["nv.decoder.template", "nv.decoder.warp"]) {
            let error = error(found, &channels_last(&fixture(name)));
            assert!(error < tolerance, "{name}: {error}");
        }
    }
}

/// Rays, the four losses and the gradients of all parameters, of the decoded grids and of the code's distribution; in f64 and in
/// f32.
#[test]
fn losses_and_gradients_are_the_originals() {
    for (dtype, tolerance) in [(DType::F64, 1e-11), (DType::F32, 2e-4)] {
        let volume = reference_volume(dtype);
        let read = |name: &str| fixture(&format!("nv.full.{name}")).to_dtype(dtype).unwrap();
        let (mean, log_deviation) = volume.code();
        let log_deviation = log_deviation.unwrap();
        let code = drawn(&mean, &log_deviation, &read("noise")).unwrap();
        assert!(error(&code, &read("code")) < 1e-6);
        let decoded = volume.decode(&code, false).unwrap();
        let (march, background) = (reference_march(), read("bg").relu().unwrap());
        let total = |decoded: &Decoded| {
            let terms = losses(decoded, &march, &background, &read("target")).unwrap();
            let code = divergence(&mean, &log_deviation).unwrap();
            let priors = ((&terms.alpha_prior + &terms.variation).unwrap() * 0.01).unwrap();
            let loss = ((&terms.image + priors).unwrap() + (&code * 0.001).unwrap()).unwrap();
            (terms, code, loss)
        };
        let (terms, code, loss) = total(&decoded);
        let found = [(&terms.image, "irgbmse"), (&terms.alpha_prior, "alphapr"), (&terms.variation, "tvl1")];
        let rays = [(&terms.acc, "acc"), (&terms.rgb, "rgb")];
        for (found, name) in found.into_iter().chain([(&code, "kldiv"), (&loss, "loss")]).chain(rays) {
            let expected = read(name);
            let error = error(found, &expected.reshape(found.dims()).unwrap());
            assert!(error < tolerance, "{name}: {error}");
        }
        let gradients = loss.backward().unwrap();
        for ((name, var), expected) in volume.parameters.variables.iter().zip(of_reference("nv.full.grad")) {
            let error = error(gradients.get(var).unwrap_or_else(|| panic!("{name}: none")), &expected);
            assert!(error < tolerance.max(2e-7), "{name}: {error}");
        }
        // The same of the grids alone, and the samples.
        let cut = |tensor: &Tensor| Var::from_tensor(&tensor.detach()).unwrap();
        let (template, warp) = (cut(&decoded.template), cut(decoded.warp.as_ref().unwrap()));
        let alone = Decoded { template: template.as_tensor().clone(), warp: Some(warp.as_tensor().clone()) };
        let gradients = total(&alone).2.backward().unwrap();
        for (var, name) in [(&template, "grad.out.template"), (&warp, "grad.out.warp")] {
            let error = error(gradients.get(var).unwrap(), &channels_last(&read(name)));
            assert!(error < tolerance.max(2e-7), "{name}: {error}");
        }
        if dtype == DType::F64 {
            check_samples(&march, &template, &warp, "nv.full");
        }
    }
}

fn small(settings: &[&str]) -> Config {
    let own =
        ["method=nv", "nv.resolution=8", "nv.divide=16", "nv.warp_resolution=4", "nv.bounds=[[-1,-1,-1],[1,3,1]]"];
    let assignments: Vec<_> = own.iter().chain(settings).map(|text| parse_assignment(text).unwrap()).collect();
    build(None, None, &assignments).unwrap()
}

/// Xavier's deviation, blocks of 2 x 2 x 2 equal taps, biases of 0, and outputs that are constant in blocks.
#[test]
fn first_values_are_xaviers_in_blocks() {
    let volume = NeuralVolume::init(&small(&[]), DType::F64, &Device::Cpu).unwrap();
    for (name, var) in &volume.parameters.variables {
        let numbers = values(var);
        if name.ends_with("bias") {
            assert!(numbers.iter().all(|value| *value == 0.0), "{name}");
        } else if name == "volume.template.1.weight" {
            let (taps, inputs, outputs) = var.dims3().unwrap();
            let expected = 2.0 / 1.04 * 2.0 / ((inputs + outputs) * 8) as f64;
            let found = numbers.iter().map(|value| value * value).sum::<f64>() / numbers.len() as f64;
            assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
            let kernel = Conv3d::transposed([1; 3]).kernel().to_vec();
            let of = |tap: usize| &numbers[tap * inputs * outputs..(tap + 1) * inputs * outputs];
            for (a, b) in (0..taps).flat_map(|a| (0..taps).map(move |b| (a, b))) {
                let same = (0..3).all(|axis| kernel[a][axis] / 2 == kernel[b][axis] / 2);
                assert_eq!(of(a) == of(b), same, "{:?} {:?}", kernel[a], kernel[b]);
            }
        }
    }
    let product = Conv3d::transposed([2, 2, 2]);
    let find = |name: &str| &volume.parameters.variables.iter().find(|(own, _)| own == name).unwrap().1;
    let (weight, bias) = (find("volume.template.1.weight"), find("volume.template.1.bias"));
    let x = ramp(&[2, 2, 2, weight.dim(1).unwrap()], 0.2);
    let out = product.forward(&x, weight, bias).unwrap();
    // Outputs 1 and 2 along each axis share a block.
    let block = out.narrow(0, 1, 2).unwrap().narrow(1, 1, 2).unwrap().narrow(2, 1, 2).unwrap().flatten(0, 2).unwrap();
    let rows = block.to_vec2::<f64>().unwrap();
    rows.iter().for_each(|row| row.iter().zip(&rows[0]).for_each(|(a, b)| assert!((a - b).abs() < 1e-12)));
}

/// Density is the template's opacity through the warp over half the cube's side, and nothing outside the cube; its gradient is
/// that of differences.
#[test]
fn density_is_opacity_in_the_scenes_units() {
    let config = small(&[]);
    let volume = NeuralVolume::init(&config, DType::F64, &Device::Cpu).unwrap();
    assert_eq!(volume.cube, Cube { middle: [0.0, 1.0, 0.0], half: 2.0 });
    let density = super::VolumeDensity::new(&volume).unwrap();
    let points =
        Tensor::new(&[[0.3, 0.9, -0.4], [1.1, 2.0, 0.7], [0.0, 3.1, 0.0], [-2.1, 0.0, 0.0]], &Device::Cpu).unwrap();
    let found = values(&density.density(&points, [0.0; 3]).unwrap());
    assert!(found[0] > 0.0 && found[1] > 0.0 && found[2..] == [0.0, 0.0], "{found:?}");
    // The cube is 4 scene units wide and the volume 2.
    let decoded = volume.decode(&volume.code().0, true).unwrap();
    let at = Tensor::new(&[[0.15, -0.05, -0.2]], &Device::Cpu).unwrap();
    let warped = trilinear(decoded.warp.as_ref().unwrap(), &at, Outside::Zeros).unwrap();
    let opacity = values(&trilinear(&decoded.template, &warped, Outside::Zeros).unwrap())[3];
    assert!((found[0] - opacity / 2.0).abs() < 1e-12, "{} {opacity}", found[0]);
    let step = 1e-4;
    let gradient = density.gradient(&points, [0.0; 3]).unwrap().to_vec2::<f64>().unwrap();
    for axis in 0..3 {
        let mut by = [0.0; 3];
        by[axis] = step;
        let by = Tensor::new(&by, &Device::Cpu).unwrap();
        let at = |points: Tensor| values(&density.density(&points, [0.0; 3]).unwrap());
        let (ahead, behind) = (at(points.broadcast_add(&by).unwrap()), at(points.broadcast_sub(&by).unwrap()));
        for row in 0..2 {
            let slope = (ahead[row] - behind[row]) / (2.0 * step);
            assert!((slope - gradient[row][axis]).abs() < 1e-6 * slope.abs().max(1.0), "{slope} {gradient:?}");
        }
    }
    let open = Config { nv: VolumeConfig::default(), ..Config::default() };
    let said = NeuralVolume::init(&open, DType::F32, &Device::Cpu).err().unwrap().to_string();
    assert!(said.contains("nv.bounds"), "{said}");
}
