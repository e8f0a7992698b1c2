//! Terms in space and of few-view training, on training rays, unseen rays, points and tables: each is descended, on networks and
//! on hash grids, and costs no reproducibility.

use super::*;
use crate::common::{assert_refused, assert_same_bytes, put_on_grid};
use augnerf::methods::Learner;
use augnerf::settings::{DataKind, LatticePoints, TermRays, WeightSchedule};

/// The paper's three in space.
const IN_SPACE: [(Regularizer, f64); 3] =
    [(Regularizer::L1, 5e-3), (Regularizer::Tv, 5e-4), (Regularizer::Laplacian, 5e-6)];

/// Terms on rays, in space and on tables that are not the paper's, with weights that show.
const FEW_VIEWS: [(Regularizer, f64); 11] = [
    (Regularizer::Distortion, 0.3),
    (Regularizer::Occlusion, 0.1),
    (Regularizer::Entropy, 0.1),
    (Regularizer::Cauchy, 0.1),
    (Regularizer::OpacityPrior, 0.3),
    (Regularizer::OpacitySparsity, 1.0),
    (Regularizer::HashDecay, 1e4),
    (Regularizer::DepthSmoothness, 1.0),
    (Regularizer::InformationGain, 1.0),
    (Regularizer::Orientation, 0.3),
    (Regularizer::SparseDepth, 0.3),
];

fn with(on_grid: bool, set: impl Fn(&mut RegularizerConfig)) -> augnerf::settings::Resolved {
    tiny_config(Method::Nerf, |config| {
        if on_grid {
            put_on_grid(config, 9);
        }
        config.regularizer.lattice = 8;
        config.regularizer.points_per_step = 64;
        config.regularizer.unseen_rays = Some(128);
        set(&mut config.regularizer);
    })
}

fn terms_of(on_grid: bool) -> impl Iterator<Item = (Regularizer, f64)> {
    FEW_VIEWS.into_iter().filter(move |(term, _)| on_grid || *term != Regularizer::HashDecay)
}

/// The first step reports a term's value and adds weight times it to the loss. Trained for some steps with a weight, the
/// term is smaller than without. Those in space are computed at all points of the lattice or, on a grid, at some.
#[test]
fn each_term_is_reported_and_descended() {
    for (on_grid, rays) in
        [(false, TermRays::Training), (true, TermRays::Training), (false, TermRays::Unseen), (true, TermRays::Unseen)]
    {
        // A trilinear grid has no second derivatives.
        let in_space = IN_SPACE.into_iter().filter(|(term, _)| !on_grid || *term != Regularizer::Laplacian);
        let may_be_unseen = [Regularizer::Occlusion, Regularizer::Entropy, Regularizer::Orientation];
        let is_tried = |(term, _): &(Regularizer, f64)| rays == TermRays::Training || may_be_unseen.contains(term);
        let all: Vec<(Regularizer, f64)> = terms_of(on_grid).chain(in_space).filter(is_tried).collect();
        let of = |terms: &[(Regularizer, f64)]| {
            with(on_grid, |config| {
                (config.kind, config.weight) = terms.iter().copied().unzip();
                config.rays = rays;
                config.points = if on_grid { LatticePoints::Sampled } else { LatticePoints::Full };
            })
        };
        // All terms are measured, and none is descended.
        let idle: Vec<(Regularizer, f64)> = all.iter().map(|(term, _)| (*term, 1e-12)).collect();
        let without = trained(&of(&idle), 60).step(false).unwrap();
        for (term, weight) in all {
            let column = format!("regularizer.{}", term.name());
            let after = |weight: f64, steps: u64| trained(&of(&[(term, weight)]), steps).step(false).unwrap();
            let (a, b) = (after(1e-12, 0), after(weight, 0));
            let value = b.term(&column).unwrap();
            assert!(value.is_finite() && a.term(&column) == Some(value), "{column} {on_grid}: {value}");
            let added = b.loss - a.loss;
            assert!(
                (added - weight * value).abs() <= 1e-6 * (1.0 + b.loss),
                "{column}: {added} for {}",
                weight * value
            );
            let [weak, strong] = [&without, &after(weight, 60)].map(|stats| stats.term(&column).unwrap());
            assert!(strong < 0.95 * weak, "{column} on a grid ({on_grid}): {strong} with the term, {weak} without");
        }
    }
}

/// Of the clean passes, whatever the method's others are.
#[test]
fn a_term_on_rays_is_added_to_the_loss_of_every_method() {
    for method in [Method::AugNerf, Method::MipNerf] {
        let step = |weight: f64| {
            let config = tiny_config(method, |config| {
                (config.regularizer.kind, config.regularizer.weight) = (vec![Regularizer::Distortion], vec![weight]);
            });
            trained(&config, 0).step(false).unwrap()
        };
        let (a, b) = (step(1e-9), step(0.3));
        let value = b.term("regularizer.distortion").unwrap();
        assert!(a.mse == b.mse && value > 0.0 && (b.loss - a.loss - 0.3 * value).abs() < 1e-6, "{a:?} {b:?}");
    }
}

/// Starts to learn with a term, from parameters that are the same in f32 and f64.
fn learner(term: Regularizer, weight: f64, on_grid: bool, dtype: DType) -> FieldLearner {
    let config = with(on_grid, |config| (config.kind, config.weight) = (vec![term], vec![weight]));
    let (learner, _) = FieldLearner::start(&config, &tiny_scene(), dtype, &CPU).unwrap();
    for (i, (_, var)) in learner.fields().variables().iter().enumerate() {
        let noise = |k: usize| 0.1 * (1.3 * (k + i) as f64).sin();
        let noise: Vec<f64> = (0..var.elem_count()).map(noise).collect();
        let noise = Tensor::from_vec(noise, var.shape(), &CPU).unwrap().to_dtype(dtype).unwrap();
        var.set(&(var.as_tensor() + noise).unwrap()).unwrap();
    }
    learner
}

/// In f64 the loss changes with the evaluated network's parameters as its gradients say. Its samples do not move with
/// them, for another network places them.
#[test]
fn the_gradients_of_a_step_with_a_term_are_those_of_differences() {
    // The opacity of a patch has no gradient, as in RegNeRF.
    for (term, weight) in terms_of(false).filter(|(term, _)| *term != Regularizer::DepthSmoothness) {
        let mut learner = learner(term, 10.0 * weight, false, DType::F64);
        let fine = learner.fields().variables().into_iter().filter(|(name, _)| name.starts_with("fine"));
        let fine: Vec<_> = fine.map(|(_, var)| var).collect();
        let mut step = || learner.step(3, false, &|| Ok(())).unwrap();
        let gradients = step().gradients.0;
        let of_fine = fine.iter().zip(&gradients[gradients.len() - fine.len()..]);
        let trained =
            of_fine.filter_map(|(var, gradient)| Some((var, var.as_tensor().copy().unwrap(), gradient.as_ref()?)));
        let trained: Vec<_> = trained.collect();
        // Along the gradient, where the loss changes most.
        let norm = trained.iter().flat_map(|(.., gradient)| flat(gradient)).map(|g| g * g).sum::<f64>().sqrt();
        let mut loss_at = |by: f64| {
            for (var, before, gradient) in &trained {
                var.set(&(before + (*gradient * (by / norm)).unwrap()).unwrap()).unwrap();
            }
            step().report.loss
        };
        let slope = (loss_at(1e-6) - loss_at(-1e-6)) / 2e-6;
        assert!((norm / slope - 1.0).abs() < 1e-5, "{}: {norm} for {slope}", term.name());
    }
}

/// The records of a hash grid in f32 make the gradients of the plain operations in f64.
#[test]
fn the_gradients_of_a_term_on_a_hash_grid_are_those_of_f64() {
    for (term, weight) in terms_of(true) {
        let of = |dtype: DType| -> Vec<f64> {
            let result = learner(term, 10.0 * weight, true, dtype).step(3, false, &|| Ok(())).unwrap();
            result.gradients.0.iter().flatten().flat_map(flat).collect()
        };
        let (single, double) = (of(DType::F32), of(DType::F64));
        let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
        let off = norm(&mut single.iter().zip(&double).map(|(a, b)| a - b)) / norm(&mut double.iter().copied());
        assert!(single.len() == double.len() && off < 2e-3, "{}: {off}", term.name());
    }
}

/// All at once, the paper's among them: the same bytes on one and two threads, and after a stop.
#[test]
fn all_terms_together_have_the_same_bytes_on_threads_and_after_a_stop() {
    let config = with(true, |config| {
        let terms: Vec<(Regularizer, f64)> = terms_of(true).chain(IN_SPACE.into_iter().take(2)).collect();
        config.kind = terms.iter().map(|(term, _)| *term).collect();
        config.weight = terms.iter().map(|(_, weight)| 0.01 * weight).collect();
        config.schedule = vec![WeightSchedule::Constant; terms.len()];
        config.schedule[0] = WeightSchedule::Linear { from: 0.2, steps: 4 };
        config.schedule[1] = WeightSchedule::Halved { every: 2 };
    });
    let roles = ["coarse", "fine"];
    let once = assert_same_bytes(&config, &roles);
    assert_ne!(once, parameters(&trained(&with(true, |_| {}), 6), &roles));
}

/// A patch is in one chunk, however small chunks are: the value is the same to rounding.
#[test]
fn patches_and_pairs_stay_together_whatever_the_chunk() {
    for (term, on_grid) in [(Regularizer::DepthSmoothness, true), (Regularizer::InformationGain, false)] {
        let of = |chunk: usize| {
            let mut config =
                with(on_grid, |config| (config.kind, config.weight) = (vec![term], vec![1.0])).into_draft();
            config.train.chunk = chunk;
            let config = config.resolve(DataKind::Blender, augnerf::bench::EXTENT).unwrap();
            let column = format!("regularizer.{}", term.name());
            trained(&config, 0).step(false).unwrap().term(&column).unwrap()
        };
        let whole = of(128);
        assert!(whole > 0.0);
        for chunk in [1, 3, 48, 100] {
            assert!((of(chunk) / whole - 1.0).abs() < 1e-5, "{chunk}: {} for {whole}", of(chunk));
        }
    }
}

/// Unseen rays have random numbers of their own: a term that weighs nothing changes no bit, and a scene whose cameras
/// look at nothing in common says what to set.
#[test]
fn unseen_rays_disturb_nothing_and_need_cameras_that_meet() {
    let roles = ["coarse", "fine"];
    let terms = [Regularizer::DepthSmoothness, Regularizer::InformationGain, Regularizer::Entropy];
    let idle = with(false, |config| {
        (config.kind, config.weight) = (terms.to_vec(), vec![1e-30; 3]);
        config.rays = TermRays::Unseen;
    });
    let without = with(false, |_| {});
    assert_eq!(parameters(&trained(&idle, 4), &roles), parameters(&trained(&without, 4), &roles));
    let mut scene = tiny_scene();
    for (i, view) in scene.train.iter_mut().enumerate() {
        view.camera.pose = [[1.0, 0.0, 0.0, i as f64], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]];
    }
    let said = Trainer::new(&idle, &scene, DType::F32, runtime()).err().unwrap().to_string();
    let to_points = with(false, |config| config.kind = vec![Regularizer::SparseDepth]);
    scene.space.sightings.clear();
    let none = Trainer::new(&to_points, &scene, DType::F32, runtime()).err().unwrap().to_string();
    assert_says(&none, &["depth at points", "COLMAP"]);
    assert_says(&said, &["unseen_poses = \"sphere\"", "no common point", "\"between\""]);
}

/// A schedule changes the weight of a step, and nothing else of it.
#[test]
fn weights_follow_their_schedule() {
    let of = |schedule: Vec<WeightSchedule>| {
        with(false, |config| {
            (config.kind, config.weight) = (vec![Regularizer::Cauchy], vec![0.02]);
            config.schedule = schedule.clone();
        })
    };
    let weights = |schedule: WeightSchedule| -> Vec<f64> {
        let mut trainer = trained(&of(vec![schedule]), 0);
        (0..5)
            .map(|_| {
                let stats = trainer.step(false).unwrap();
                stats.terms.iter().find(|term| term.name == "regularizer.cauchy").unwrap().weight
            })
            .collect()
    };
    assert_eq!(weights(WeightSchedule::Constant), [0.02; 5]);
    assert_eq!(weights(WeightSchedule::Halved { every: 2 }), [0.02, 0.02, 0.01, 0.01, 0.005]);
    let falls = weights(WeightSchedule::Linear { from: 0.1, steps: 2 });
    assert!(falls.iter().zip([0.1, 0.06, 0.02, 0.02, 0.02]).all(|(a, b)| (a - b).abs() < 1e-15), "{falls:?}");
    // Constant weights are those of a run without schedules.
    assert_eq!(of(vec![WeightSchedule::Constant]).hash(), of(Vec::new()).hash());
    assert_ne!(of(vec![WeightSchedule::Halved { every: 2 }]).hash(), of(Vec::new()).hash());
}

#[test]
fn impossible_terms_and_schedules_are_refused() {
    let two = "regularizer.kind=[\"tv\",\"l1\"]; regularizer.schedule=halved every 5 steps";
    let never = "regularizer.kind=tv; regularizer.schedule=halved every 0 steps";
    let orientation = |other: &str| format!("regularizer.kind=orientation; {other}");
    assert_refused(&[
        ("regularizer.kind=hash-decay", &["hash-decay", "field.encoding = \"hash\""]),
        (two, &["1 schedule", "2 terms"]),
        (never, &["regularizer.schedule", "halved every 0 steps", "at least 1"]),
        ("regularizer.kind=tv; regularizer.schedule=rising", &["from WEIGHT in N steps", "halved every N steps"]),
        (&orientation("method=mip-nerf"), &["orientation", "Gaussians", "nerf or aug-nerf"]),
        (&orientation("method=srn"), &["orientation", "srn"]),
        (&orientation("train.gradient_scaling=true"), &["orientation", "gradient_scaling"]),
        ("regularizer.kind=occlusion; regularizer.occlusion_share=2", &["occlusion_share", "2"]),
    ]);
}
