//! Image metrics against closed forms, slow references, another implementation and the paper.
//!
//! Some tests need files that are not in the repository: real photographs from the folder in `AUGNERF_DATA` and LPIPS
//! weights from the folder in `AUGNERF_LPIPS_WEIGHTS`.

use std::collections::HashMap;
use std::path::Path;

use crate::common::files::{fixture, json, rows};
use crate::common::needs;
use crate::common::program::{Place, set};
use augnerf::base::Image;
use augnerf::base::rng::{Random, Stream};
use augnerf::metrics::{self, Backbone, Lpips, MeanMetrics, ViewMetrics};
use augnerf::metrics::{MSE, PSNR, PSNR_FLOAT, PSNR_OF_MEAN, SSIM};
use augnerf::run::columns;
use candle_core::{DType, Device, Result, Tensor};

/// PSNR and SSIM are computed in f64 here and there; images are 8-bit.
const PSNR_SSIM_TOLERANCE: f64 = 1e-4;
/// LPIPS runs in f32 through up to 26 convolutions.
const LPIPS_TOLERANCE: f64 = 1e-3;
/// The same f32 network against f64, relative.
const NETWORK_TOLERANCE: f64 = 1e-4;
/// Closed forms in f64 of f32 pixels.
const CLOSED_FORM_TOLERANCE: f64 = 1e-6;

fn noise(width: usize, height: usize, channels: usize, seed: u64) -> Image {
    let pixels = Random::new(seed, Stream::Search, 0).uniform_values(width * height * channels);
    Image { width, height, channels, pixels }
}

fn constant(width: usize, height: usize, value: f32) -> Image {
    Image { width, height, channels: 3, pixels: vec![value; width * height * 3] }
}

fn assert_close(what: &str, found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{what}: found {found}, expected {expected} within {tolerance}");
}

#[test]
fn psnr_of_a_constant_offset_is_its_closed_form() {
    let (a, b) = (constant(7, 5, 0.25), constant(7, 5, 0.35));
    let found = metrics::psnr_float(&a, &b).unwrap().unwrap();
    assert_close("psnr_float", found, 20.0, CLOSED_FORM_TOLERANCE);
    // 63.75 and 89.25 of 255 round to 64 and 89.
    let found = metrics::measure("view", &a, &b, &[]).unwrap().get(&PSNR).unwrap();
    assert_close("psnr", found, -20.0 * (25.0f64 / 255.0).log10(), CLOSED_FORM_TOLERANCE);
}

#[test]
fn quantise_clamps_and_rounds_to_multiples_of_one_255th() {
    let image = Image { width: 5, height: 1, channels: 1, pixels: vec![-0.5, 1.5, 0.0019, 0.002, 0.5] };
    let expected = vec![0.0, 1.0, 0.0, 1.0 / 255.0, 128.0 / 255.0];
    assert_eq!(metrics::quantise(&image).pixels, expected);
    assert_eq!(metrics::quantise(&metrics::quantise(&image)).pixels, expected);
}

#[test]
fn equal_images_have_no_psnr_and_an_ssim_of_one() {
    let image = noise(23, 19, 3, 1);
    let view = metrics::measure("view", &image, &image, &[]).unwrap();
    assert_eq!((view.get(&PSNR), view.get(&PSNR_FLOAT), view.get(&MSE)), (None, None, Some(0.0)));
    assert_close("ssim", view.get(&SSIM).unwrap(), 1.0, 1e-12);
    let black = constant(11, 11, 0.0);
    assert_eq!(metrics::ssim(&black, &black).unwrap(), Some(1.0));
}

#[test]
fn ssim_equals_the_window_by_window_definition() {
    for (width, height, channels) in [(11, 11, 3), (17, 13, 3), (12, 24, 1)] {
        let (a, b) = (noise(width, height, channels, 2), noise(width, height, channels, 3));
        let found = metrics::ssim(&a, &b).unwrap().unwrap();
        assert_close("ssim", found, slow_ssim(&a, &b), 1e-10);
    }
}

/// SSIM with one two-dimensional window per position and centred moments.
fn slow_ssim(a: &Image, b: &Image) -> f64 {
    let of_window = |(c, x, y): (usize, usize, usize)| {
        let offsets = (-5..6i32).flat_map(|dy| (-5..6i32).map(move |dx| (dx, dy)));
        let window = offsets.map(|(dx, dy)| {
            let i = ((y as i32 + dy) as usize * a.width + (x as i32 + dx) as usize) * a.channels + c;
            let weight = (-f64::from(dx * dx + dy * dy) / (2.0 * 1.5 * 1.5)).exp();
            (weight, f64::from(a.pixels[i]), f64::from(b.pixels[i]))
        });
        let window: Vec<(f64, f64, f64)> = window.collect();
        let total: f64 = window.iter().map(|w| w.0).sum();
        let mean = |f: &dyn Fn(f64, f64) -> f64| window.iter().map(|(w, p, q)| w * f(*p, *q)).sum::<f64>() / total;
        let (ma, mb) = (mean(&|p, _| p), mean(&|_, q| q));
        let (va, vb) = (mean(&|p, _| (p - ma).powi(2)), mean(&|_, q| (q - mb).powi(2)));
        let cov = mean(&|p, q| (p - ma) * (q - mb));
        (2.0 * ma * mb + 1e-4) * (2.0 * cov + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4))
    };
    let row = |(c, y): (usize, usize)| (5..a.width - 5).map(move |x| (c, x, y));
    let rows = (0..a.channels).flat_map(|c| (5..a.height - 5).map(move |y| (c, y)));
    let values: Vec<f64> = rows.flat_map(row).map(of_window).collect();
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn images_below_the_window_have_no_ssim() {
    for (width, height) in [(10, 11), (11, 10), (1, 1)] {
        let [a, b] = [0.2, 0.3].map(|value| constant(width, height, value));
        let view = metrics::measure("small", &a, &b, &[]).unwrap();
        assert_eq!(view.get(&SSIM), None);
        assert!(view.get(&PSNR).is_some());
    }
}

#[test]
fn images_that_cannot_be_compared_are_errors() {
    let image = noise(12, 12, 3, 4);
    let error = metrics::measure("v", &image, &noise(12, 13, 3, 4), &[]).unwrap_err();
    assert!(error.to_string().contains("12x12 with 3 channels") && error.to_string().contains("12x13"), "{error}");
    let short = Image { pixels: vec![0.0; 5], ..image.clone() };
    assert_eq!(metrics::ssim(&short, &short).unwrap_err().exit_code(), 3);
    let empty = Image { width: 0, height: 0, channels: 3, pixels: Vec::new() };
    assert_eq!(metrics::mse(&empty, &empty).unwrap_err().exit_code(), 3);
    let mut broken = image.clone();
    broken.pixels[7] = f32::NAN;
    let error = metrics::measure("v", &broken, &image, &[]).unwrap_err();
    assert!(error.to_string().contains("1 values"), "{error}");
}

fn view(psnr: Option<f64>, mse: f64, lpips_squeeze: Option<f64>) -> ViewMetrics {
    let mut view = ViewMetrics::new("v");
    view.values.set(&PSNR, psnr);
    view.values.set(&PSNR_FLOAT, psnr);
    view.values.set(&MSE, Some(mse));
    view.values.set(&SSIM, Some(0.5));
    view.values.set(Backbone::Squeeze.lpips(), lpips_squeeze);
    view
}

#[test]
fn means_are_over_all_views_or_missing() {
    let views = [view(Some(20.0), 0.01, Some(0.2)), view(Some(10.0), 0.1, Some(0.4))];
    let means = MeanMetrics::from_views(&views);
    let of_lpips =
        |means: &MeanMetrics, backbone: Backbone| (means.get(backbone.lpips()), means.get(backbone.average()));
    assert_eq!((means.get(&PSNR), means.get(&SSIM)), (Some(15.0), Some(0.5)));
    assert_eq!(of_lpips(&means, Backbone::Alex), (None, None));
    assert_close("psnr_of_mean", means.get(&PSNR_OF_MEAN).unwrap(), -10.0 * 0.055f64.log10(), 1e-12);
    let average = means.get(Backbone::Squeeze.average()).unwrap();
    assert_close("average", average, metrics::average(15.0, 0.5, 0.3), 1e-12);

    let partly = MeanMetrics::from_views(&[views[0].clone(), view(None, 0.0, None)]);
    assert_eq!((partly.get(&PSNR), of_lpips(&partly, Backbone::Squeeze)), (None, (None, None)));
    assert_close("psnr_of_mean", partly.get(&PSNR_OF_MEAN).unwrap(), -10.0 * 0.005f64.log10(), 1e-12);
    assert_eq!(MeanMetrics::from_views(&[]), MeanMetrics::default());
}

#[test]
fn missing_metrics_are_null_in_json_and_empty_in_csv() {
    let views = [view(None, 0.0, Some(0.25))];
    let json = serde_json::to_value(MeanMetrics::from_views(&views)).unwrap();
    for name in ["psnr", "psnr_float", "psnr_of_mean", "lpips_alex", "lpips_vgg", "average_vgg", "average_squeeze"] {
        assert_eq!(json.get(name), Some(&serde_json::Value::Null), "{name}");
    }
    assert_eq!((&json["ssim"], &json["lpips_squeeze"]), (&0.5.into(), &0.25.into()));
    let text = serde_json::to_string(&views[0]).unwrap();
    assert_eq!(serde_json::from_str::<ViewMetrics>(&text).unwrap(), views[0]);

    let row: Vec<String> = columns(&views[0]).into_iter().map(|(name, value)| format!("{name}={value}")).collect();
    let first = ["name=v", "psnr=", "psnr_float=", "mse=0.0", "floor_psnr=", "ssim=0.5"];
    assert_eq!(row[..6], first);
    assert_eq!(row[6..9], ["lpips_alex=", "lpips_vgg=", "lpips_squeeze=0.25"]);
    assert!(row.len() > 9 && row[9..].iter().all(|cell| cell.ends_with('=')), "geometry was not measured: {row:?}");

    // Files of programs that measured no geometry.
    let old = r#"{"name":"v","psnr":null,"psnr_float":null,"mse":0.0,"ssim":0.5,"lpips_alex":null,"lpips_vgg":null,
        "lpips_squeeze":0.25}"#;
    assert_eq!(serde_json::from_str::<ViewMetrics>(old).unwrap(), views[0]);
}

/// Rows of the paper whose average is cut off instead of rounded.
const TRUNCATED: [&str; 2] = ["tabA1 width_256_half_res Aug-NeRF", "tabA2 pepper_noise Aug-NeRF"];

#[test]
fn average_gives_every_published_average() {
    let rows = rows(include_str!("../../crates/report/src/report/published.csv"));
    assert_eq!(rows.len(), 57);
    let mut truncated = Vec::new();
    for row in &rows {
        let number = |name: &str| row[name].parse::<f64>().unwrap();
        let average = metrics::average(number("psnr"), number("ssim"), number("lpips"));
        if format!("{average:.3}") != row["average"] {
            assert_eq!(format!("{:.3}", (average * 1000.0).floor() / 1000.0), row["average"], "{row:?}");
            truncated.push(format!("{} {} {}", row["table"], row["condition"], row["method"]));
        }
    }
    assert_eq!(truncated, TRUNCATED);
}

fn read_png(path: &Path) -> Image {
    let image = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgb8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let pixels = image.into_raw().into_iter().map(|v| f32::from(v) / 255.0).collect();
    Image { width, height, channels: 3, pixels }
}

/// Of the pictures in `tests/fixtures/metrics.json` scenes lie below the data folder, the corrupted one among the fixtures.
#[test]
#[ignore = "needs AUGNERF_DATA and AUGNERF_LPIPS_WEIGHTS"]
fn photographs_give_the_numbers_of_other_implementations() {
    let lpips = Lpips::load(&needs::lpips_weights(), Backbone::Squeeze, &Device::Cpu).unwrap();
    let lpips = [lpips.expect("the weights folder lacks the squeeze backbone")];
    let read = |name: &str| match name.strip_prefix("data/") {
        Some(relative) => read_png(&needs::scene(relative)),
        None => read_png(&fixture(Path::new(name).file_name().unwrap().to_str().unwrap())),
    };
    let references = json(&fixture("metrics.json"));
    let references = references.as_array().unwrap();
    assert_eq!(references.len(), 3);
    for reference in references {
        let [a, b] = ["a", "b"].map(|name| read(reference[name].as_str().unwrap()));
        let view = metrics::measure("view", &a, &b, &lpips).unwrap();
        let close = |name: &str, found: f64, tolerance: f64| {
            assert_close(name, found, reference[name].as_f64().unwrap(), tolerance);
        };
        let (psnr, ssim) = (view.get(&PSNR).unwrap(), view.get(&SSIM).unwrap());
        close("psnr", psnr, PSNR_SSIM_TOLERANCE);
        close("psnr", view.get(&PSNR_FLOAT).unwrap(), PSNR_SSIM_TOLERANCE);
        close("ssim_gaussian_11_sigma_1_5_valid_crop", ssim, PSNR_SSIM_TOLERANCE);
        let lpips = "lpips_squeeze_v0_1";
        close("average", metrics::average(psnr, ssim, reference[lpips].as_f64().unwrap()), PSNR_SSIM_TOLERANCE);
        close(lpips, view.get(Backbone::Squeeze.lpips()).unwrap(), LPIPS_TOLERANCE);
    }
}

/// A table's LPIPS column says with which weights it was measured.
#[test]
#[ignore = "needs AUGNERF_LPIPS_WEIGHTS"]
fn the_protocol_names_the_weights_that_lpips_was_measured_with() {
    let place = Place::new();
    std::fs::create_dir(place.at("weights")).unwrap();
    for file in ["squeeze_lin_v0.1.pth", "squeezenet1_1_features.pth"] {
        place.write(&format!("weights/{file}"), std::fs::read(needs::lpips_weights().join(file)).unwrap());
    }
    let small = set("data.width=16 train.steps=1 train.rays=64 train.chunk=32");
    place.run(&format!("train --quiet --out run{small}"), 0);
    let protocol = || place.json("run/metrics.json")["protocol"]["lpips_weights"].clone();
    assert!(protocol().is_null());
    let measured_with = || {
        place.run("eval --quiet run --lpips-weights weights", 0);
        protocol().as_str().unwrap().strip_prefix("squeeze ").unwrap().to_string()
    };
    let released = measured_with();
    assert!(released.len() == 12 && released.chars().all(|digit| digit.is_ascii_hexdigit()), "{released}");
    // One bit of one weight.
    let file = place.at("weights/squeezenet1_1_features.pth");
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    assert_ne!(measured_with(), released);
}

fn load_error(dir: &Path) -> String {
    let error = Lpips::load(dir, Backbone::Squeeze, &Device::Cpu).err().expect("must be refused");
    assert_eq!(error.exit_code(), 3, "{error}");
    error.to_string()
}

// Synthetic networks: every backbone with random weights, against candle's operations in f64.

type Tensors = HashMap<String, Tensor>;

/// A network in torchvision's order of modules: `conv index outputs kernel stride padding`, `fire index squeeze expand`, `pool
/// kernel`, `poolceil kernel` and `tap`.
fn modules(backbone: Backbone) -> &'static str {
    match backbone {
        Backbone::Alex => {
            "conv 0 64 11 4 2|tap|pool 3|conv 3 192 5 1 2|tap|pool 3|conv 6 384 3 1 1|tap|conv 8 256 3 1 1|tap|\
             conv 10 256 3 1 1|tap"
        }
        Backbone::Vgg => {
            "conv 0 64 3 1 1|conv 2 64 3 1 1|tap|pool 2|conv 5 128 3 1 1|conv 7 128 3 1 1|tap|pool 2|\
             conv 10 256 3 1 1|conv 12 256 3 1 1|conv 14 256 3 1 1|tap|pool 2|conv 17 512 3 1 1|conv 19 512 3 1 1|\
             conv 21 512 3 1 1|tap|pool 2|conv 24 512 3 1 1|conv 26 512 3 1 1|conv 28 512 3 1 1|tap"
        }
        Backbone::Squeeze => {
            "conv 0 64 3 2 0|tap|poolceil 3|fire 3 16 64|fire 4 16 64|tap|poolceil 3|fire 6 32 128|fire 7 32 128|tap|\
             poolceil 3|fire 9 48 192|tap|fire 10 48 192|tap|fire 11 64 256|tap|fire 12 64 256|tap"
        }
    }
}

/// Random weights of a backbone, made as they are first asked for, and its plain operations in f64.
struct Plain {
    backbone: Backbone,
    features: Tensors,
    linear: Tensors,
    random: Random,
}

impl Plain {
    fn new(backbone: Backbone) -> Plain {
        let (features, linear, random) = (Tensors::new(), Tensors::new(), Random::new(5, Stream::Search, 0));
        let mut plain = Plain { backbone, features, linear, random };
        let any = noise(backbone.min_side(), backbone.min_side(), 3, 1);
        plain.distance(&any, &any).unwrap();
        plain
    }

    fn weights(random: &mut Random, tensors: &mut Tensors, name: String, shape: &[usize], range: [f32; 2]) -> Tensor {
        let make = || {
            let values = random.uniform_map(shape.iter().product(), |share| range[0] + (range[1] - range[0]) * share);
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        tensors.entry(name).or_insert_with(make).to_dtype(DType::F64).unwrap()
    }

    fn conv(&mut self, x: &Tensor, name: &str, [out, side, stride, padding]: [usize; 4]) -> Result<Tensor> {
        let channels = x.dim(1)?;
        let bound = (6.0 / (channels * side * side) as f32).sqrt();
        let mut of = |part: &str, shape: &[usize], bound: f32| {
            Plain::weights(&mut self.random, &mut self.features, format!("{name}.{part}"), shape, [-bound, bound])
        };
        let (weight, bias) = (of("weight", &[out, channels, side, side], bound), of("bias", &[out], 0.1));
        x.conv2d(&weight, padding, stride, 1, 1)?.broadcast_add(&bias.reshape((1, (), 1, 1))?)?.relu()
    }

    /// The compared feature maps.
    fn taps(&mut self, image: &Image) -> Result<Vec<Tensor>> {
        let (shift, scale) = ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]);
        let count = image.width * image.height;
        let pixel = |i: usize| {
            (2.0 * f64::from(image.pixels[i % count * 3 + i / count]) - 1.0 - shift[i / count]) / scale[i / count]
        };
        let pixels: Vec<f64> = (0..3 * count).map(pixel).collect();
        let mut x = Tensor::from_vec(pixels, (1, 3, image.height, image.width), &Device::Cpu)?;
        let mut taps = Vec::new();
        for module in modules(self.backbone).split('|') {
            let mut words = module.split_whitespace();
            let (kind, n) = (words.next().unwrap(), words.map(|word| word.parse().unwrap()).collect::<Vec<usize>>());
            match kind {
                "conv" => x = self.conv(&x, &n[0].to_string(), [n[1], n[2], n[3], n[4]])?,
                "fire" => {
                    let mut part = |x: &Tensor, name: &str, out: usize, side: usize| {
                        self.conv(x, &format!("{}.{name}", n[0]), [out, side, 1, side / 2])
                    };
                    x = part(&x, "squeeze", n[1], 1)?;
                    x = Tensor::cat(&[part(&x, "expand1x1", n[2], 1)?, part(&x, "expand3x3", n[2], 3)?], 1)?;
                }
                "tap" => taps.push(x.clone()),
                pool => {
                    // Rounding up, the last window is filled up with zeros, below which no ReLU is.
                    let is_up = usize::from(pool == "poolceil");
                    let lacking = |size: usize| is_up * if size < n[0] { n[0] - size } else { (size - n[0]) % 2 };
                    let (_, _, height, width) = x.dims4()?;
                    let padded = x.pad_with_zeros(2, 0, lacking(height))?.pad_with_zeros(3, 0, lacking(width))?;
                    x = padded.max_pool2d_with_stride(n[0], 2)?;
                }
            }
        }
        Ok(taps)
    }

    fn distance(&mut self, a: &Image, b: &Image) -> Result<f64> {
        let unit = |x: &Tensor| x.broadcast_div(&(x.sqr()?.sum_keepdim(1)?.sqrt()? + 1e-10)?);
        let pairs = self.taps(a)?.into_iter().zip(self.taps(b)?);
        let of_tap = |(i, (a, b)): (usize, (Tensor, Tensor))| {
            let (name, shape) = (format!("lin{i}.model.1.weight"), [1, a.dim(1)?, 1, 1]);
            let weights = Plain::weights(&mut self.random, &mut self.linear, name, &shape, [0.0, 1.0]);
            let difference = (unit(&a)? - unit(&b)?)?.sqr()?;
            difference.broadcast_mul(&weights)?.sum(1)?.mean_all()?.to_scalar::<f64>()
        };
        pairs.enumerate().map(of_tap).sum()
    }
}

fn feature_file(backbone: Backbone) -> &'static str {
    match backbone {
        Backbone::Alex => "alexnet-owt-7be5be79.safetensors",
        Backbone::Vgg => "vgg16-397923af.safetensors",
        Backbone::Squeeze => "squeezenet1_1_features.safetensors",
    }
}

fn write(dir: &Path, backbone: Backbone, features: &Tensors, linear: &Tensors) {
    candle_core::safetensors::save(features, dir.join(feature_file(backbone))).unwrap();
    let name = format!("{}_lin_v0.1.safetensors", backbone.name());
    candle_core::safetensors::save(linear, dir.join(name)).unwrap();
}

fn check_network(backbone: Backbone, sizes: &[(usize, usize)]) {
    let dir = tempfile::tempdir().unwrap();
    let mut plain = Plain::new(backbone);
    write(dir.path(), backbone, &plain.features, &plain.linear);
    assert_eq!(Lpips::available(dir.path()).unwrap(), [backbone]);
    let lpips = Lpips::load(dir.path(), backbone, &Device::Cpu).unwrap().unwrap();
    for (width, height) in sizes {
        let (a, b) = (noise(*width, *height, 3, 6), noise(*width, *height, 3, 7));
        let found = lpips.distance(&a, &b).unwrap();
        let expected = plain.distance(&a, &b).unwrap();
        eprintln!("{} {width}x{height}: {found} {expected}", backbone.name());
        assert_close(backbone.name(), found, expected, expected * NETWORK_TOLERANCE);
        assert_eq!(lpips.distance(&a, &a).unwrap(), 0.0);
    }
    let side = backbone.min_side();
    let small = noise(side - 1, side, 3, 8);
    let error = lpips.distance(&small, &small).unwrap_err();
    assert!(error.exit_code() == 3 && error.to_string().contains(&format!("{side}x{side}")), "{error}");
    assert_eq!(metrics::measure("v", &small, &small, &[lpips]).unwrap().get(Backbone::Squeeze.lpips()), None);
}

#[test]
fn every_backbone_equals_plain_operations_also_where_pooling_rounds_up() {
    check_network(Backbone::Alex, &[(31, 31), (43, 36)]);
    check_network(Backbone::Vgg, &[(19, 16)]);
    check_network(Backbone::Squeeze, &[(17, 17), (21, 23), (26, 29), (33, 19)]);
}

#[test]
#[ignore = "slow"]
fn convolutions_in_strips_of_rows_give_the_same_distance() {
    let dir = tempfile::tempdir().unwrap();
    let mut plain = Plain::new(Backbone::Vgg);
    let features = plain.features.iter().map(|(name, weights)| (format!("features.{name}"), weights.clone())).collect();
    write(dir.path(), Backbone::Vgg, &features, &plain.linear);
    let lpips = Lpips::load(dir.path(), Backbone::Vgg, &Device::Cpu).unwrap().unwrap();
    // The second convolution unfolds 64 * 9 * 700 values a row: two strips.
    let (a, b) = (noise(700, 48, 3, 9), noise(700, 48, 3, 10));
    let expected = plain.distance(&a, &b).unwrap();
    assert_close("vgg in strips", lpips.distance(&a, &b).unwrap(), expected, expected * NETWORK_TOLERANCE);
}

#[test]
fn weight_folders_that_lack_something_are_told_apart() {
    let dir = tempfile::tempdir().unwrap();
    assert!(Lpips::load(dir.path(), Backbone::Squeeze, &Device::Cpu).unwrap().is_none());
    assert_eq!(Lpips::available(dir.path()).unwrap(), []);
    let missing = dir.path().join("missing");
    assert_eq!(Lpips::available(&missing).unwrap_err().exit_code(), 3);
    assert!(load_error(&missing).contains("missing"));

    let Plain { features, linear, .. } = Plain::new(Backbone::Squeeze);
    let mut wrong = features.clone();
    wrong.insert("3.squeeze.weight".into(), features["4.squeeze.weight"].clone());
    write(dir.path(), Backbone::Squeeze, &wrong, &linear);
    let error = load_error(dir.path());
    for part in ["squeezenet1_1_features.safetensors", "3.squeeze.weight", "[16, 128, 1, 1]", "[16, 64, 1, 1]"] {
        assert!(error.contains(part), "{error}");
    }
    wrong.remove("3.squeeze.weight");
    write(dir.path(), Backbone::Squeeze, &wrong, &linear);
    let error = load_error(dir.path());
    assert!(error.contains("lacks the tensor 3.squeeze.weight"), "{error}");

    std::fs::write(dir.path().join(feature_file(Backbone::Squeeze)), b"not a weight file").unwrap();
    assert!(load_error(dir.path()).contains("not a readable weight file"));
}
