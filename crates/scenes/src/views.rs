//! Choices among a scene's views: held-out views, validation views, training views, and training views that are also
//! measured.

use super::{Scene, View};
use crate::settings::{DataConfig, EvalSplit, RuledViews, TrainViews, ViewsRule};
use augnerf_base::rng::{Random, Stream};
use augnerf_base::{Error, Result};

/// Indices of the stream of choices.
const TRAINED: u64 = 0;
const SEEN: u64 = 1;

/// Splits views, in their order, into training and evaluation views: see `data.holdout`, `data.holdout_offset`,
/// `data.validation`, `data.eval_split` and `data.test_skip`. Held-out and validation views are in neither unless they
/// are evaluated.
pub(super) fn split<T>(views: Vec<T>, config: &DataConfig) -> (Vec<T>, Vec<T>) {
    let DataConfig { holdout, holdout_offset, validation, eval_split, test_skip, .. } = *config;
    let (held_out, rest) = part(views, |place| place % holdout.max(1) == holdout_offset);
    // The middle one of every N, because neighbours of held-out views tell less.
    let (kept, train) = part(rest, |place| validation > 0 && place % validation == validation / 2);
    let evaluated = match eval_split {
        EvalSplit::Test => held_out,
        EvalSplit::Val => kept,
    };
    (train, evaluated.into_iter().step_by(test_skip.max(1)).collect())
}

/// Separates the views whose index `holds` accepts from the others.
fn part<T>(views: Vec<T>, holds: impl Fn(usize) -> bool) -> (Vec<T>, Vec<T>) {
    let (picked, others): (Vec<_>, Vec<_>) = views.into_iter().enumerate().partition(|(place, _)| holds(*place));
    let views = |placed: Vec<(usize, T)>| placed.into_iter().map(|(_, view)| view).collect();
    (views(picked), views(others))
}

/// Keeps the training views that `data.train_views` names, in their order.
pub(super) fn keep_training_views(scene: &mut Scene, config: &DataConfig) -> Result<()> {
    let all = scene.train.len();
    let kept = match &config.train_views {
        None => return Ok(()),
        Some(TrainViews::Number(count) | TrainViews::Ruled(RuledViews { count, .. })) if *count > all => {
            return Err(Error::Config(format!(
                "data.train_views = {count} asks for more views than {} has to train on ({all}): give at most {all}, or \
                 leave it empty for all",
                scene.name
            )));
        }
        Some(TrainViews::Ruled(RuledViews { count, rule: ViewsRule::Even })) => even(*count, all),
        Some(TrainViews::Ruled(RuledViews { count, rule: ViewsRule::Disjoint })) => {
            disjoint(*count, all, config.views_seed)?
        }
        Some(TrainViews::Number(number)) => draw(*number, all, config.views_seed, TRAINED),
        Some(TrainViews::Named(names)) => named(&scene.train, names)?,
    };
    let mut place = 0..;
    scene.train.retain(|_| kept.contains(&place.next().expect("endless")));
    Ok(())
}

/// Returns `count` of `all` indices from the first to the last, as even as they can be.
fn even(count: usize, all: usize) -> Vec<usize> {
    let step = (all - 1) as f64 / (count.max(2) - 1) as f64;
    (0..count).map(|i| (i as f64 * step).round_ties_even() as usize).collect()
}

/// Returns part number `part` of a fixed order of `all` indices, each of `count`, in their order.
fn disjoint(count: usize, all: usize, part: u64) -> Result<Vec<usize>> {
    let order = Random::new(0, Stream::Views, TRAINED).distinct(all, all as u32);
    let start = usize::try_from(part).ok().and_then(|part| part.checked_mul(count));
    let Some(start) = start.filter(|start| start.checked_add(count).is_some_and(|end| end <= all)) else {
        return Err(Error::Config(format!(
            "data.train_views = \"{count} disjoint\" with data.views_seed = {part}: {all} views to train on have {} parts of \
             {count}, numbered from 0; lower data.views_seed or the number of views",
            all / count
        )));
    };
    let mut places: Vec<usize> = order[start..start + count].iter().map(|place| *place as usize).collect();
    places.sort_unstable();
    Ok(places)
}

/// Returns the indices of the views of these names.
fn named(views: &[View], names: &[String]) -> Result<Vec<usize>> {
    let place = |name: &String| {
        views.iter().position(|view| view.name == *name).ok_or_else(|| {
            let known: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
            Error::Config(format!(
                "data.train_views names {name:?}, which is no view to train on; these are: {}",
                known.join(", ")
            ))
        })
    };
    names.iter().map(place).collect()
}

/// Returns the indices of the training views that evaluations also measure: so many (`eval.train_views`; `None` is as many as
/// are held out), drawn with `data.views_seed` only. A smaller number gives a subset of a larger one.
pub fn seen_views(scene: &Scene, number: Option<usize>, views_seed: u64) -> Vec<usize> {
    draw(number.unwrap_or(scene.test.len()), scene.train.len(), views_seed, SEEN)
}

/// Returns `number` of `all` indices, or all of them, in their order.
fn draw(number: usize, all: usize, seed: u64, index: u64) -> Vec<usize> {
    let drawn = Random::new(seed, Stream::Views, index).distinct(number.min(all), all as u32);
    let mut places: Vec<usize> = drawn.into_iter().map(|place| place as usize).collect();
    places.sort_unstable();
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::DataKind;

    fn forward() -> DataConfig {
        DataConfig { kind: DataKind::BuiltinForward, width: 8, ..DataConfig::default() }
    }

    fn load(config: &DataConfig) -> Scene {
        crate::load(config, 0, &()).unwrap()
    }

    fn names(views: &[View]) -> Vec<String> {
        views.iter().map(|view| view.name.clone()).collect()
    }

    #[test]
    fn every_offset_holds_out_other_views_and_all_of_them_once() {
        let mut all: Vec<String> = Vec::new();
        for holdout_offset in 0..8 {
            let scene = load(&DataConfig { holdout_offset, ..forward() });
            assert!(names(&scene.train).iter().all(|name| !names(&scene.test).contains(name)));
            assert_eq!(scene.train.len() + scene.test.len(), 20);
            all.extend(names(&scene.test));
        }
        all.sort();
        all.dedup();
        assert_eq!(all.len(), 20);
        assert_eq!(load(&DataConfig { holdout_offset: 0, ..forward() }).hash(), load(&forward()).hash());
    }

    #[test]
    fn a_validation_split_is_disjoint_and_training_is_the_same_whichever_is_evaluated() {
        let test = DataConfig { validation: 4, holdout_offset: 3, ..forward() };
        let val = DataConfig { eval_split: EvalSplit::Val, ..test.clone() };
        let (test, val) = (load(&test), load(&val));
        assert_eq!(names(&test.train), names(&val.train));
        assert_eq!((test.train.len(), test.test.len(), val.test.len()), (13, 3, 4));
        for name in names(&val.test) {
            assert!(!names(&test.train).contains(&name) && !names(&test.test).contains(&name), "{name}");
        }
        // Without one, none is taken from training.
        assert_eq!(load(&DataConfig { holdout_offset: 3, ..forward() }).train.len(), 17);
    }

    #[test]
    fn few_views_are_drawn_by_their_own_seed_or_named() {
        let few = |number, views_seed| {
            let train_views = Some(TrainViews::Number(number));
            names(&load(&DataConfig { train_views, views_seed, ..forward() }).train)
        };
        let (four, eight) = (few(4, 0), few(8, 0));
        assert_eq!((four.len(), eight.len()), (4, 8));
        assert!(four.iter().all(|name| eight.contains(name)), "{four:?} {eight:?}");
        assert_ne!(few(4, 1), four);
        assert_eq!(few(17, 0), names(&load(&forward()).train));
        let train_views = Some(TrainViews::Named(four.iter().rev().cloned().collect()));
        let scene = load(&DataConfig { train_views, ..forward() });
        assert_eq!(names(&scene.train), four);
        assert_ne!(scene.hash(), load(&forward()).hash());
        let refused = |train_views| {
            let config = DataConfig { train_views: Some(train_views), ..forward() };
            crate::load(&config, 0, &()).unwrap_err().to_string()
        };
        assert!(refused(TrainViews::Number(18)).contains("at most 17"));
        let held_out = names(&load(&forward()).test)[0].clone();
        let said = refused(TrainViews::Named(vec![held_out.clone()]));
        assert!(said.contains(&held_out) && said.contains(&four[0]), "{said}");
    }

    /// The places that the released RegNeRF takes of fern's 17 views to train on, from NumPy's linspace and round.
    #[test]
    fn even_views_are_the_few_view_protocol_s() {
        assert_eq!(even(3, 17), [0, 8, 16]);
        assert_eq!(even(6, 17), [0, 3, 6, 10, 13, 16]);
        assert_eq!(even(9, 17), [0, 2, 4, 6, 8, 10, 12, 14, 16]);
        assert_eq!((even(1, 17), even(17, 17)), (vec![0], (0..17).collect()));
        let ruled = |rule, count, views_seed| {
            let train_views = Some(TrainViews::Ruled(RuledViews { count, rule }));
            crate::load(&DataConfig { train_views, views_seed, ..forward() }, 0, &())
        };
        let all = names(&load(&forward()).train);
        assert_eq!(names(&ruled(ViewsRule::Even, 3, 5).unwrap().train), [0, 8, 16].map(|place| all[place].clone()));
        let mut seen: Vec<String> =
            (0..2).flat_map(|part| names(&ruled(ViewsRule::Disjoint, 8, part).unwrap().train)).collect();
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), 16);
        let said = ruled(ViewsRule::Disjoint, 8, 2).unwrap_err().to_string();
        assert!(said.contains("2 parts of 8") && said.contains("views_seed"), "{said}");
        // The largest seed, whose part would end beyond the largest number.
        let said = ruled(ViewsRule::Disjoint, 2, i64::MAX as u64).unwrap_err().to_string();
        assert!(said.contains("data.views_seed = 9223372036854775807") && said.contains("8 parts of 2"), "{said}");
    }

    #[test]
    fn seen_views_are_as_many_as_are_held_out() {
        let scene = load(&forward());
        let views_seed = forward().views_seed;
        let seen = |number, views_seed| seen_views(&scene, number, views_seed);
        let usual = seen(None, views_seed);
        assert_eq!(usual.len(), scene.test.len());
        assert!(usual.is_sorted() && usual.iter().all(|&place| place < scene.train.len()));
        assert_ne!(seen(None, views_seed + 7), usual);
        assert!(seen(Some(0), views_seed).is_empty());
        assert_eq!(seen(Some(99), views_seed), (0..17).collect::<Vec<usize>>());
    }
}
