//! The first held-out view while training goes on, before the evaluation's images.

use std::time::Instant;

use crate::base::Result;

use super::evaluate::every;
use super::{Pictures, Viewer};

/// Shares of a session's steps after which a picture is drawn.
const AFTER: [f64; 4] = [0.1, 0.2, 0.4, 0.8];
/// The most time of one picture as a share of the session's training: all together 3 %.
const SHARE: f64 = 0.03 / AFTER.len() as f64;
/// Of every so many pixels across and down, the view is rendered first, to time it.
const COARSE: usize = 8;

/// When pictures are due in a session, and what they may take.
pub(super) struct Preview {
    /// Steps before this session and at its end.
    steps: (u64, u64),
    started: Instant,
    /// Pictures that were due so far.
    passed: usize,
    /// Sessions of fewer seconds have no pictures.
    shortest: f64,
    /// Seconds spent on pictures, with writing them. None were drawn if it is 0.
    pub(super) spent: f64,
}

impl Preview {
    pub(super) fn new(steps: (u64, u64), shortest: f64) -> Preview {
        Preview { steps, started: Instant::now(), passed: 0, shortest, spent: 0.0 }
    }

    /// Returns the seconds that a picture may take after `step`, or `None` if none is drawn there.
    pub(super) fn allowance(&mut self, step: u64) -> Option<f64> {
        let (first, last) = self.steps;
        let (done, all) = ((step - first) as f64, (last - first) as f64);
        if step >= last || AFTER.get(self.passed).is_none_or(|share| done < share * all) {
            return None;
        }
        self.passed += 1;
        let seconds = self.started.elapsed().as_secs_f64() * all / done;
        // What a picture took too long, a later one waits for.
        let left = SHARE * seconds * self.passed as f64 - self.spent;
        (seconds >= self.shortest && left > 0.0).then_some(left.min(SHARE * seconds))
    }
}

/// Draws the first held-out view within about so many seconds: every pixel of it, or every second across and down, or
/// fewer. Returns whether there is such a view.
///
/// # Errors
/// Those of rendering, of `stop_check` and of writing.
pub(super) fn draw(
    viewer: &Viewer,
    pictures: &Pictures,
    allowance: f64,
    stop_check: &mut dyn FnMut() -> Result<()>,
) -> Result<bool> {
    let Some(view) = viewer.scene.test.first() else { return Ok(false) };
    let started = Instant::now();
    let renderer = viewer.renderer()?;
    let prepared = started.elapsed();
    let coarse = viewer.render_every(&*renderer, COARSE, &view.camera, stop_check)?;
    let spent = started.elapsed();
    let stride = stride((spent - prepared).as_secs_f64(), allowance - spent.as_secs_f64());
    let rendered = match stride {
        COARSE => coarse,
        _ => viewer.render_every(&*renderer, stride, &view.camera, stop_check)?,
    };
    let (truth, mask) = every(view, stride);
    pictures.preview(truth, mask.as_deref(), &rendered)?;
    Ok(true)
}

/// Returns the smallest distance of rendered pixels that takes at most `left` seconds, if [`COARSE`] takes `coarse`.
fn stride(coarse: f64, left: f64) -> usize {
    let takes = |stride: &usize| coarse * ((COARSE * COARSE) as f64 / (stride * stride) as f64) <= left;
    (1..COARSE).find(takes).unwrap_or(COARSE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::load_scene;
    use crate::runtime::Runtime;
    use crate::settings::{Preset, build, parse_assignment};
    use crate::train::Trainer;
    use candle_core::DType;

    /// With time enough it is the picture of the evaluation, without it is coarser.
    #[test]
    fn a_picture_is_the_evaluations_if_there_is_time() {
        let small = ["data.width=16", "field.width=16", "train.rays=64"].map(|text| parse_assignment(text).unwrap());
        let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &small).unwrap(), &()).unwrap();
        let runtime = Runtime::new("cpu", Some(1)).unwrap();
        let trainer = Trainer::new(&config, &scene, DType::F32, &runtime).unwrap();
        let viewer = Viewer { model: trainer.model().unwrap(), config: &config, scene: &scene, runtime: &runtime };
        let folder = tempfile::tempdir().unwrap();
        let pictures = Pictures::new(folder.path(), &scene, 1);
        let drawn = |allowance: f64| {
            assert!(draw(&viewer, &pictures, allowance, &mut || Ok(())).unwrap());
            std::fs::read(pictures.preview_path()).unwrap()
        };
        let (fine, coarse) = (drawn(1e9), drawn(0.0));
        let view = &scene.test[0];
        pictures.write(0, view, &viewer.render(&view.camera).unwrap()).unwrap();
        let beside = std::fs::read(folder.path().join(format!("{}_beside.png", view.name))).unwrap();
        assert!(fine == beside && coarse != beside);
        pictures.finish().unwrap();
        assert!(!pictures.preview_path().exists());
    }

    #[test]
    fn pictures_are_due_after_shares_of_a_sessions_steps_and_as_fine_as_their_time_allows() {
        let due = |steps: (u64, u64), shortest: f64| -> Vec<u64> {
            let mut preview = Preview::new(steps, shortest);
            (steps.0 + 1..=steps.1).filter(|step| preview.allowance(*step).is_some()).collect()
        };
        assert_eq!(due((0, 100), 0.0), [10, 20, 40, 80]);
        assert_eq!(due((50, 100), 0.0), [55, 60, 70, 90]);
        // The last step's picture is the evaluation's.
        assert_eq!((due((0, 3), 0.0), due((0, 1), 0.0), due((0, 100), 1e9)), (vec![1, 2], vec![], vec![]));
        let mut preview = Preview::new((0, 100), 0.0);
        preview.spent = 1e9;
        assert_eq!(preview.allowance(10), None);
        assert_eq!([64.0, 63.0, 16.0, 1.4, 1.0, -1.0].map(|left| stride(1.0, left)), [1, 2, 2, 7, 8, 8]);
    }
}
