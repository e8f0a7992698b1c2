//! Controls of the worst case: the best case, other rays' worst case, and hash grids whose second pass changes clean entries alone.

use crate::common::{assert_refused, assert_same_bytes, parameters, put_on_grid, tiny_config, trained};
use augnerf::perturb::{Epsilon, PaperSite};
use augnerf::settings::{ChangedEntries, Config, Method, Resolved, SecondPass, Sizes};

fn config(on_grid: bool, second: SecondPass, set: impl Fn(&mut Config)) -> Resolved {
    tiny_config(Method::AugNerf, |config| {
        if on_grid {
            put_on_grid(config, 11);
        }
        config.perturb.second = second;
        config.perturb.sizes = Sizes::Calibrated;
        config.perturb.lambda = 1.0;
        set(config);
    })
}

fn of(on_grid: bool, source: SecondPass) -> Resolved {
    config(on_grid, source, |_| {})
}

/// PGD goes up, down, or up for another ray: the sum of the sites' gains says so after some training.
#[test]
fn each_source_moves_the_loss_its_own_way() {
    for on_grid in [false, true] {
        let gains = |source: SecondPass| -> f64 {
            let mut trainer = trained(&of(on_grid, source), 30);
            let stats = trainer.step(true).unwrap();
            stats.sites.iter().map(|site| site.gain).sum()
        };
        let [worst, best, permuted, uniform] =
            [SecondPass::WorstCase, SecondPass::BestCase, SecondPass::Permuted, SecondPass::Uniform].map(gains);
        assert!(worst > 0.0 && best < 0.0, "on a grid ({on_grid}): {worst} {best}");
        assert!(permuted < 0.5 * worst && uniform < 0.5 * worst, "{permuted} {uniform} {worst}");
    }
}

#[test]
fn controls_have_the_same_bytes_on_threads_and_after_a_stop() {
    for on_grid in [false, true] {
        let roles = if on_grid { &["coarse"][..] } else { &["coarse", "fine"][..] };
        let mut all: Vec<Vec<f32>> = Vec::new();
        for source in [SecondPass::WorstCase, SecondPass::BestCase, SecondPass::Permuted] {
            all.push(assert_same_bytes(&of(on_grid, source), roles));
        }
        if on_grid {
            let masked = |config: &mut Config| config.perturb.entries = ChangedEntries::Clean;
            let worst = SecondPass::WorstCase;
            all.push(assert_same_bytes(&config(true, worst, masked), roles));
        }
        assert!((0..all.len()).all(|i| all[..i].iter().all(|other| *other != all[i])));
    }
}

/// After one step, the entries that moved are those of NeRF's step, and fewer than without the mask. The log has the share of
/// the others.
#[test]
fn a_masked_second_pass_changes_the_entries_of_the_clean_pass() {
    let worst = SecondPass::WorstCase;
    let moved = |config: &Resolved| -> Vec<bool> {
        let [before, after] = [0, 1].map(|steps| parameters(&trained(config, steps), &["coarse.table"]));
        before.chunks(2).zip(after.chunks(2)).map(|(a, b)| a != b).collect()
    };
    let plain = tiny_config(Method::Nerf, |config| put_on_grid(config, 11));
    let far = |config: &mut Config| config.perturb[PaperSite::Xyz].epsilon = Some(Epsilon::Units(8.0));
    let masked = config(true, worst, |config| {
        far(config);
        config.perturb.entries = ChangedEntries::Clean;
    });
    let unmasked = config(true, worst, far);
    let (of_nerf, of_masked, of_all) = (moved(&plain), moved(&masked), moved(&unmasked));
    let count = |moved: &[bool]| moved.iter().filter(|moved| **moved).count();
    assert_eq!(of_nerf, of_masked);
    assert!(count(&of_all) > count(&of_nerf), "{} {}", count(&of_all), count(&of_nerf));
    let logged = |config: &Resolved, log: bool| {
        let stats = trained(config, 0).step(log).unwrap();
        stats.weight_columns.iter().find(|(name, _)| name == "only_second.entries").map(|(_, share)| *share)
    };
    let share = logged(&unmasked, true).unwrap();
    let expected = (count(&of_all) - count(&of_nerf)) as f64 / count(&of_all) as f64;
    // An entry whose two gradients cancel out, or whose step is too small for f32, is counted and does not move.
    assert!((share - expected).abs() < 0.02 && share > 0.0, "{share} {expected}");
    assert_eq!(logged(&masked, true), Some(share));
    assert_eq!(logged(&unmasked, false), None);
}

#[test]
fn a_mask_without_a_shared_grid_is_refused() {
    let on_grid = "method=aug-nerf; field.encoding=hash; perturb.entries=clean";
    let permuted = "method=aug-nerf; perturb.kind=permuted";
    assert_refused(&[
        ("method=aug-nerf; perturb.entries=clean", &["perturb.entries", "field.encoding = \"hash\""]),
        (&format!("{on_grid}; field.core=plain"), &["perturb.entries", "field.core", "perturb.field"]),
        (&format!("{on_grid}; perturb.field=separate"), &["perturb.entries", "field.core", "perturb.field"]),
        (&format!("{permuted}; train.chunk=1"), &["permuted", "train.chunk = 1"]),
        (&format!("{permuted}; train.rays=65; train.chunk=32"), &["permuted", "65 rays in a step"]),
    ]);
}
