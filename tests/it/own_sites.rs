//! Sites of one's own in the perturbed pass.

use augnerf::base::Result;
use augnerf::perturb::{DeltaSet, Norm, PaperSite, PassGeometry, Passes, Pgd, Site, StepUnit};
use augnerf::runtime::Runtime;
use augnerf::settings::{Config, Core, Method, Resolved, SecondPass};
use augnerf::train::{StepStats, Trainer};
use candle_core::DType;

use crate::common::{tiny_config, tiny_scene, trained};

/// One number for each ray, spread over its samples, channels or units at any place; or a delta of the place's own shape.
struct OfRays {
    name: &'static str,
    spreads: bool,
    at: PaperSite,
    radius: f64,
    steps: usize,
    width: usize,
}

impl Site for OfRays {
    fn name(&self) -> &str {
        self.name
    }

    fn at(&self) -> PaperSite {
        self.at
    }

    fn pgd(&self) -> Pgd {
        Pgd { steps: self.steps, step_size: 0.5, unit: StepUnit::Relative }
    }

    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let (rays, samples, columns) = (pass.rays()?, pass.samples, pass.t_vals.dim(1)?);
        let shape = match self.at {
            PaperSite::T => vec![rays, columns],
            PaperSite::View => vec![rays, 2],
            PaperSite::Density => vec![rays, samples],
            PaperSite::Feature => vec![rays, samples, self.width],
            PaperSite::Xyz | PaperSite::Rgb => vec![rays, samples, 3],
        };
        let of_ray: Vec<usize> =
            shape.iter().enumerate().map(|(axis, size)| if axis == 0 || !self.spreads { *size } else { 1 }).collect();
        let radius = pass.scalar(self.radius)?.reshape(vec![1; of_ray.len()])?;
        let set = DeltaSet::new(Norm::Linf, radius, &of_ray);
        if !self.spreads {
            return Ok(set);
        }
        Ok(set.spread_by(move |delta| Ok(delta.broadcast_as(shape.clone())?.contiguous()?)))
    }
}

/// A configuration whose own sites are off, but for `view`, which gives rays their tangents.
fn alone(change: impl FnOnce(&mut Config)) -> Resolved {
    tiny_config(Method::AugNerf, |config| {
        for site in PaperSite::ALL {
            config.perturb[site].passes = if site == PaperSite::View { Passes::Fine } else { Passes::Off };
        }
        change(config);
    })
}

fn of_rays(at: PaperSite, radius: f64, steps: usize) -> OfRays {
    OfRays { name: "of_rays", spreads: true, at, radius, steps, width: 16 }
}

/// The last of some steps, all logged, with the parameters after it.
fn steps(config: &Resolved, site: Option<OfRays>, threads: usize) -> (StepStats, Vec<f32>) {
    let runtime = Runtime::new("cpu", Some(threads)).unwrap();
    let mut trainer = Trainer::new(config, &tiny_scene(), DType::F32, &runtime).unwrap();
    site.into_iter().for_each(|site| trainer.add_site(site).unwrap());
    let stats = (0..5).map(|_| trainer.step(true).unwrap()).last().unwrap();
    let columns = trainer.columns().further;
    for site in &stats.sites {
        assert!(site.columns().iter().all(|(name, _)| columns.contains(name)), "{columns:?}");
    }
    let values = trainer.model().unwrap().variables();
    (stats, values.iter().flat_map(|(_, var)| var.flatten_all().unwrap().to_vec1::<f32>().unwrap()).collect())
}

#[test]
fn a_site_of_ones_own_raises_the_loss_at_every_place_and_moves_colours() {
    for place in PaperSite::ALL {
        let radius = if place == PaperSite::View { 0.3 } else { 0.1 };
        let (stats, one) = steps(&alone(|_| {}), Some(of_rays(place, radius, 3)), 1);
        let found = stats.sites.iter().find(|site| site.site == "of_rays").unwrap();
        assert!(found.gain > 0.0 && found.gain_over_random > 0.0 && found.shift > 0.0, "{place:?}: {found:?}");
        assert!(found.share_at_bound.unwrap() > 0.5, "{place:?}: {found:?}");
        let (_, two) = steps(&alone(|_| {}), Some(of_rays(place, radius, 3)), 2);
        assert!(one.iter().zip(&two).all(|(a, b)| a.to_bits() == b.to_bits()), "{place:?}: threads");
    }
}

/// A site that the fused core does not know, or one that moves samples while no site of the paper's does, counts all the same,
/// and each step of its search. Steps without a log add output deltas in one operation where they can.
#[test]
fn a_seventh_site_raises_the_loss_of_both_cores_at_every_place() {
    let each = PaperSite::ALL.into_iter().flat_map(|place| [(place, true), (place, false)]);
    let wrong = each.filter_map(|(place, spreads)| {
        let radius = if place == PaperSite::View { 0.3 } else { 0.1 };
        // The losses of two steps without a log and one with it, and how far that one's deltas move colours.
        let losses = |core: Core, steps: Option<usize>| {
            let mut trainer = trained(&alone(|config| config.field.core = core), 0);
            let site = |steps| OfRays { spreads, ..of_rays(place, radius, steps) };
            steps.into_iter().for_each(|steps| trainer.add_site(site(steps)).unwrap());
            let stats = [false, false, true].map(|log| trainer.step(log).unwrap());
            let shift = stats[2].sites.iter().find(|site| site.site == "of_rays").map_or(0.0, |site| site.shift);
            (stats.map(|stats| stats.loss), shift)
        };
        let [(without, _), (one, _), (three, shift)] = [None, Some(1), Some(3)].map(|steps| losses(Core::Fused, steps));
        let (plain, plain_shift) = losses(Core::Plain, Some(3));
        // The first step is of equal weights.
        let raises = without[0] < one[0] && one[0] < three[0];
        let agrees = three.iter().zip(&plain).all(|(fused, plain)| (fused - plain).abs() < 1e-4 * plain)
            && (shift - plain_shift).abs() < 0.02 * plain_shift;
        (!raises || !agrees)
            .then(|| format!("{place:?} {spreads}: {without:?} {one:?} {three:?} {plain:?} {shift} {plain_shift}"))
    });
    assert_eq!(wrong.collect::<Vec<_>>(), Vec::<String>::new());
}

/// With a set that is a point nothing changes, not even the other sites' random numbers.
#[test]
fn a_site_of_no_size_changes_nothing() {
    let config = tiny_config(Method::AugNerf, |_| {});
    let (without, plain) = steps(&config, None, 2);
    for place in [PaperSite::T, PaperSite::Xyz, PaperSite::Feature] {
        let (with, same) = steps(&config, Some(of_rays(place, 0.0, 1)), 2);
        assert_eq!((with.loss, with.sites.len()), (without.loss, without.sites.len() + 1), "{place:?}");
        assert!(plain.iter().zip(&same).all(|(a, b)| a.to_bits() == b.to_bits()), "{place:?}");
    }
}

#[test]
fn sites_that_cannot_be_are_refused_in_words() {
    let refused = |config: &Resolved, sites: Vec<OfRays>| {
        let mut trainer = trained(config, 0);
        let added: Vec<_> = sites.into_iter().map(|site| trainer.add_site(site)).collect();
        added.into_iter().last().unwrap().unwrap_err().to_string()
    };
    let plain = || of_rays(PaperSite::Xyz, 0.1, 1);
    let named = |name| OfRays { name, ..plain() };
    let augmented = alone(|_| {});
    for (found, words) in [
        (refused(&tiny_config(Method::Nerf, |_| {}), vec![plain()]), "no pass of this training is perturbed"),
        (
            refused(&alone(|config| config.perturb.second = SecondPass::FreshJitter), vec![plain()]),
            "no pass of this training is perturbed",
        ),
        (refused(&alone(|config| config.perturb.second = SecondPass::Permuted), vec![plain()]), "permuted"),
        (refused(&augmented, vec![plain(), plain()]), "there is a site of that name"),
        (refused(&augmented, vec![named("xyz")]), "there is a site of that name"),
        (refused(&augmented, vec![named("a,b")]), "lower-case letters"),
        (
            refused(
                &tiny_config(Method::AugNerf, |config| config.perturb[PaperSite::View].passes = Passes::Off),
                vec![of_rays(PaperSite::View, 0.1, 1)],
            ),
            "perturb.view.passes",
        ),
    ] {
        assert!(found.contains(words), "{words}: {found}");
    }
}
