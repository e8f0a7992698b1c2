//! The sizes of sets: in the run's own samples and pixels, in the paper's, and as far as an ascent reaches.

use augnerf::base::rng::{Random, Stream};
use augnerf::methods::step_over_radius;
use augnerf::perturb::{
    AttackGeometry, DeltaSet, Epsilon, Geometry, Norm, PaperPass, PaperSite, PassGeometry, PerSite, PixelScale,
    SampleDensity, Sets, SiteNumbers,
};
use augnerf::run::load_scene;
use augnerf::settings::{Config, PerturbConfig, Preset, Sizes};
use candle_core::{DType, Device, Tensor};

use crate::common::built;
use crate::common::pass::geometry;

const CPU: Device = Device::Cpu;
const LLFF: bool = true;

/// A picture of fern's view that is so wide, in NDC.
fn fern(width: f64) -> PixelScale {
    PixelScale { width, height: width * 0.75, focal: width * 0.8079, ndc: true }
}

fn values(set: &DeltaSet) -> Vec<f64> {
    set.radius.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Which pass it is of, seen from the front or not, and of so many coarse samples.
#[derive(Clone, Copy)]
struct Of {
    is_coarse: bool,
    forward: bool,
    coarse: usize,
}

/// A coarse pass of so many samples.
fn coarse(samples: usize) -> Of {
    Of { is_coarse: true, forward: LLFF, coarse: samples }
}

/// All sites' sets of a pass, in the run's geometry and in the paper's.
fn sets((perturb, numbers): &Attack, t_vals: &Tensor, of: Of, width: usize, pixel: PixelScale) -> [Sets; 2] {
    let direction_norm = Tensor::full(2.1, (t_vals.dims()[0], 1), &CPU).unwrap().to_dtype(t_vals.dtype()).unwrap();
    let Of { is_coarse, coarse, .. } = of;
    let pass = geometry(t_vals, &direction_norm);
    let own = AttackGeometry { coarse_samples: coarse, width, pixel, ..pass.run };
    [own, own.of_paper(PaperPass::of_scenes(of.forward))].map(|run| {
        Sets::new(perturb.sites_of_pass(numbers, is_coarse), &PassGeometry { run, is_coarse, ..pass }).unwrap()
    })
}

fn even(samples: usize) -> Tensor {
    let at = |i: usize| i as f64 / (samples - 1) as f64;
    Tensor::from_vec((0..samples).map(at).collect(), (1, samples), &CPU).unwrap()
}

/// Section `perturb` with its numbers filled in, and the sites' numbers.
type Attack = (PerturbConfig, PerSite<SiteNumbers>);

/// Those of a field so wide.
fn numbers(change: impl FnOnce(&mut PerturbConfig), coarse: usize, width: usize) -> Attack {
    let mut config = PerturbConfig::default();
    change(&mut config);
    let numbers = config.fill(1.0, coarse, width);
    (config, numbers)
}

fn paper(config: &mut PerturbConfig) {
    config.geometry = Geometry::Paper;
}

#[test]
fn the_paper_s_own_runs_have_the_paper_s_geometry_to_the_last_bit() {
    let mut random = Random::new(5, Stream::Jitter, 0);
    for (samples, forward) in [(64, LLFF), (64, !LLFF), (128, LLFF), (192, !LLFF)] {
        let of = Of { is_coarse: samples == 64, forward, coarse: 64 };
        let pixel =
            if forward { fern(504.0) } else { PixelScale { width: 400.0, height: 400.0, focal: 555.0, ndc: false } };
        let mut t: Vec<f32> = (0..samples).map(|_| random.uniform() as f32).collect();
        t.sort_by(f32::total_cmp);
        let t_vals = Tensor::from_vec(t, (1, samples), &CPU).unwrap();
        let [own, of_paper] = sets(&numbers(paper, 64, 256), &t_vals, of, 256, pixel);
        let [before, _] = sets(&numbers(|_| (), 64, 256), &t_vals, of, 256, pixel);
        for site in PaperSite::ALL {
            let radii = [&own, &of_paper, &before].map(|sets| values(sets.get(site).unwrap()));
            assert!(radii.iter().all(|radius| *radius == radii[0]), "{}", site.name());
        }
    }
}

/// What it is for: half the samples doubled the set of `t`, and the step of 1e-2 no longer reached its ends.
#[test]
fn a_coarse_pass_of_any_samples_pictures_and_width_has_the_paper_s_radii() {
    let expected = |site: PaperSite, width: usize| match site {
        PaperSite::T => 0.5 / 63.0,
        PaperSite::Xyz => 2.0 / 504.0,
        PaperSite::View => 1.0 / (2.0 * 504.0 * 0.8079),
        PaperSite::Feature => 1e-3 * (256.0 / width as f64).sqrt(),
        PaperSite::Rgb | PaperSite::Density => 1e-5,
    };
    for (samples, width, pixels) in [(64, 256, 504.0), (32, 64, 504.0), (24, 64, 100.0), (16, 512, 126.0)] {
        let [own, of_paper] =
            sets(&numbers(paper, samples, width), &even(samples), coarse(samples), width, fern(pixels));
        for site in PaperSite::ALL {
            for radius in values(of_paper.get(site).unwrap()) {
                let expected = expected(site, width);
                assert!((radius / expected - 1.0).abs() < 1e-12, "{} {samples} {width} {pixels}", site.name());
            }
        }
        let t = values(own.get(PaperSite::T).unwrap())[0];
        assert!((t - 0.5 / (samples - 1) as f64).abs() < 1e-12);
        assert_eq!(samples == 64, (t - 0.5 / 63.0).abs() < 1e-12);
    }
}

/// In closed form: between evenly spaced coarse samples lies one more here, so that half of the samples are coarse ones.
#[test]
fn the_paper_s_gap_counts_coarse_and_drawn_samples_by_themselves() {
    for (forward, drawn) in [(LLFF, 64.0), (!LLFF, 128.0)] {
        let of = Of { is_coarse: false, forward, coarse: 17 };
        let [own, of_paper] = sets(&numbers(paper, 17, 256), &even(33), of, 256, fern(504.0));
        let [own, of_paper] = [own, of_paper].map(|sets| values(sets.get(PaperSite::T).unwrap())[7]);
        let density = 0.5 * 63.0 / 16.0 + 0.5 * drawn / 16.0;
        assert!((own - 0.5 / 32.0).abs() < 1e-12 && (of_paper * density / own - 1.0).abs() < 1e-12, "{own} {of_paper}");
        // A gap wider than a coarse one is all coarse samples'.
        let wide = Tensor::new(&[[0.0, 0.3, 0.6, 1.0]], &CPU).unwrap();
        let density = SampleDensity { coarse: 63.0 / 16.0, drawn };
        assert_eq!(density.around(&wide, 0.01).unwrap().to_vec2::<f64>().unwrap()[0][1..], [63.0 / 16.0; 3]);
    }
}

/// More samples than the paper's lie closer than its set is wide: order comes first.
#[test]
fn the_paper_s_set_never_reaches_beyond_half_a_gap() {
    let [_, of_paper] = sets(&numbers(paper, 200, 256), &even(200), coarse(200), 256, fern(504.0));
    let t = values(of_paper.get(PaperSite::T).unwrap());
    assert!(t.iter().all(|radius| (radius * 199.0 / 0.5 - 1.0).abs() < 1e-9), "{t:?}");
    // A smaller epsilon is the paper's length again.
    let small = |config: &mut PerturbConfig| {
        paper(config);
        config[PaperSite::T].epsilon = Some(0.1.into());
    };
    let [_, of_paper] = sets(&numbers(small, 128, 256), &even(128), coarse(128), 256, fern(504.0));
    assert!((values(of_paper.get(PaperSite::T).unwrap())[0] * 63.0 / 0.1 - 1.0).abs() < 1e-12);
}

#[test]
fn boxes_over_features_keep_the_norm_of_their_corners_and_balls_theirs() {
    let feature = |change: fn(&mut PerturbConfig), width: usize| -> SiteNumbers {
        let change = |config: &mut PerturbConfig| {
            paper(config);
            change(config);
        };
        numbers(change, 32, width).1[PaperSite::Feature]
    };
    let size = |numbers: SiteNumbers| numbers.radius(|epsilon| epsilon);
    for width in [64, 128, 256, 512] {
        let corner = |side: f64| side * (width as f64).sqrt();
        let narrow = feature(|_| (), width);
        assert!(
            (corner(size(narrow)) - 1e-3 * 16.0).abs() < 1e-15
                && (narrow.pgd.step_size / size(narrow) - 1.0).abs() < 1e-12
        );
        let ball = feature(|config| config[PaperSite::Feature].norm = Some(Norm::L2), width);
        assert_eq!((size(ball), ball.pgd.step_size), (1e-3, 1e-3));
        // Steps in radii are scaled with them.
        let calibrated = feature(|config| config.sizes = Sizes::Calibrated, width);
        assert!(
            (corner(size(calibrated)) - 1e-2 * 16.0).abs() < 1e-14 && calibrated.pgd.step_size == 2.5,
            "{calibrated:?}"
        );
    }
}

#[test]
fn the_calibrated_density_follows_the_samples_but_in_the_paper_s_geometry() {
    let density = |change: fn(&mut PerturbConfig), coarse: usize| {
        let change = |config: &mut PerturbConfig| {
            config.sizes = Sizes::Calibrated;
            change(config);
        };
        numbers(change, coarse, 256).1[PaperSite::Density].radius(|epsilon| epsilon)
    };
    assert_eq!(density(|_| (), 32) * 2.0, density(|_| (), 64));
    assert_eq!((density(paper, 32), density(paper, 24)), (density(|_| (), 64), density(|_| (), 64)));
}

/// What the protocol says of a run on the embedded scene whose pictures are so wide.
fn described(preset: Preset, kind: &str, width: f64, texts: &[&str]) -> String {
    let kind = format!("data.kind={kind}");
    let own = ["method=aug-nerf", "data.width=16", kind.as_str()];
    let settings = own.iter().chain(texts).copied().collect::<Vec<_>>().join("; ");
    let (config, mut scene) = load_scene(built(Some(preset), &settings).unwrap(), &()).unwrap();
    // The sets know the first training camera alone; pictures of that size would take a minute to render.
    let camera = &mut scene.train[0].camera;
    let scale = width / camera.width as f64;
    camera.focal = camera.focal.map(|focal| focal * scale);
    (camera.width, camera.height) = (width as usize, (camera.height as f64 * scale).round() as usize);
    let three = |ratio: f64| format!("{ratio:.2e}").parse::<f64>().unwrap();
    let ratios = step_over_radius(&config, &scene).unwrap();
    ratios.iter().map(|(site, ratio)| format!("{} {}", site.name(), three(*ratio))).collect::<Vec<_>>().join(", ")
}

#[test]
fn the_protocol_s_ratio_tells_small_presets_from_the_paper_s_attack() {
    let forward = |preset, width, texts: &[&str]| described(preset, "builtin-forward", width, texts);
    let paper = forward(Preset::PaperLlff, 504.0, &[]);
    assert!(paper.starts_with("t 1.26, xyz 2.52, view ") && paper.ends_with("feature 1, rgb 1, density 1"), "{paper}");
    // Half the samples at the same resolution; a tenth of that, where half the samples' distance is under a pixel.
    assert_eq!(forward(Preset::Cpu, 504.0, &[]), paper.replace("t 1.26", "t 0.62"));
    assert!(forward(Preset::Cpu, 48.0, &[]).starts_with("t 0.62, xyz 0.31, "));
    for (preset, width) in
        [(Preset::Cpu, 504.0), (Preset::Cpu, 126.0), (Preset::Smoke, 100.0), (Preset::PaperLlff, 48.0)]
    {
        assert_eq!(forward(preset, width, &["perturb.geometry=paper"]), paper, "{preset:?} {width}");
    }
    let around = |preset, width, texts: &[&str]| described(preset, "builtin-blender", width, texts);
    let blender = around(Preset::PaperBlender, 400.0, &[]);
    assert!(blender.starts_with("t 0.315, xyz "), "{blender}");
    assert_eq!(around(Preset::Smoke, 100.0, &["perturb.geometry=paper"]), blender);
    assert_ne!(around(Preset::Smoke, 100.0, &[]), blender);
    // Of a field on a hash grid the fine pass alone is perturbed: 32 intervals where the paper's has 191.
    let hash = around(Preset::Fast, 100.0, &[]);
    assert!(hash.starts_with("t 0.955, xyz ") && hash.ends_with("feature 1, rgb 1, density 1"), "{hash}");
    // Steps in radii, and a site of the fine pass alone.
    let output = ["perturb.attack=calibrated", "perturb.levels=[\"output\"]"];
    assert_eq!(forward(Preset::Smoke, 100.0, &output), "rgb 2.5, density 2.5");
    let fine = ["perturb.t.passes=fine", "perturb.xyz.passes=off", "perturb.view.passes=off"];
    let fine = [&["perturb.levels=[\"input\"]"], &fine[..]].concat();
    assert_eq!(forward(Preset::PaperLlff, 504.0, &fine), "t 2.54");
}

fn config(texts: &[&str]) -> augnerf::base::Result<Config> {
    built(None, &texts.join("; "))
}

#[test]
fn a_set_as_far_as_the_ascent_reaches_follows_steps_and_step_size() {
    for steps in [1, 3, 10] {
        let reach = |config: &mut PerturbConfig| {
            for site in PaperSite::ALL {
                let site = &mut config[site];
                (site.steps, site.step_size, site.epsilon) = (Some(steps), Some(4e-4), Some(Epsilon::Reach));
            }
        };
        let [own, _] = sets(&numbers(reach, 64, 256), &even(64), coarse(64), 256, fern(504.0));
        for site in PaperSite::ALL {
            let radius = values(own.get(site).unwrap());
            assert!(
                radius.iter().all(|radius| (radius - 4e-4 * steps as f64).abs() < 1e-15),
                "{} {radius:?}",
                site.name()
            );
        }
    }
    // t keeps the order of samples; no step reaches nowhere.
    let far = |steps: usize| {
        move |config: &mut PerturbConfig| {
            let t = &mut config[PaperSite::T];
            (t.steps, t.step_size, t.epsilon) = (Some(steps), Some(0.1), Some(Epsilon::Reach));
        }
    };
    let [own, _] = sets(&numbers(far(3), 64, 256), &even(64), coarse(64), 256, fern(504.0));
    assert!(values(own.get(PaperSite::T).unwrap()).iter().all(|radius| (radius * 63.0 / 0.5 - 1.0).abs() < 1e-9));
    let [own, _] = sets(&numbers(far(0), 64, 256), &even(64), coarse(64), 256, fern(504.0));
    assert!(own.get(PaperSite::T).is_none());
}

#[test]
fn reach_is_a_word_of_files_and_needs_steps_of_a_length() {
    let reach = config(&["method=aug-nerf", "perturb.feature.epsilon=reach"]).unwrap();
    assert_eq!(reach.perturb[PaperSite::Feature].epsilon, Some(Epsilon::Reach));
    assert_eq!(Config::from_toml(&reach.to_toml(), "file").unwrap(), reach);
    let json = serde_json::to_string(&reach).unwrap();
    assert_eq!(serde_json::from_str::<Config>(&json).unwrap(), reach);
    let plain = config(&["method=aug-nerf"]).unwrap();
    assert_eq!(reach.step_shape(), plain.step_shape());
    for relative in ["perturb.attack=calibrated", "perturb.step_unit=relative"] {
        let refused = config(&["method=aug-nerf", "perturb.feature.epsilon=reach", relative]).unwrap_err().to_string();
        assert!(refused.contains("perturb.feature.epsilon") && refused.contains("radii"), "{refused}");
    }
    for wrong in ["perturb.feature.epsilon=rich", "perturb.feature.epsilon=true", "perturb.feature.epsilon=-1"] {
        let refused = config(&[wrong]).unwrap_err().to_string();
        assert!(refused.contains("feature.epsilon") || refused.contains("reach"), "{wrong}: {refused}");
    }
}
