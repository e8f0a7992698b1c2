//! Each site of a perturbed pass alone: what its deltas gain.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::base::rng::Stream;
use crate::methods::diagnostics::{SiteEffect, SiteSums, colour_shift};
use crate::perturb::{Deltas, Distribution, PaperSite, UsedDeltas};
use crate::render::{perturbed_pass, photometric_loss};

use super::step::PerturbedPass;

/// Measures each site of a perturbed pass separately: with the deltas that it used, and with random ones.
pub(super) fn diagnose(perturbed: &PerturbedPass, used: &UsedDeltas, sums: &mut SiteSums) -> Result<()> {
    let random_deltas = perturbed.draw(Distribution::Uniform, Stream::Diagnostics)?;
    let (fraction, numbers) = (perturbed.chunk.fraction, &perturbed.learner.config.numbers);
    let frozen = perturbed.field.frozen()?;
    // The loss, with its weight in the pass, and the rays' colours.
    let render = |deltas: &Deltas| -> Result<(f64, Tensor)> {
        let rgb = perturbed_pass(&frozen, perturbed.pass, perturbed.perturbation(deltas))?.composite.rgb;
        let loss = photometric_loss(&rgb, perturbed.target)?.to_dtype(DType::F64)?.to_scalar::<f64>()?;
        Ok((perturbed.plan.weight * loss, rgb))
    };
    let (clean_loss, clean_rgb) = render(&Deltas::default())?;
    let sites_on = numbers.iter().filter(|(_, numbers)| numbers.on()).map(|(site, _)| site.name());
    for name in sites_on.chain(perturbed.delta_plan.user_sites().map(|site| site.name())) {
        let (Some(set), Some(delta)) = (used.sets.get(name), used.deltas.get(name)) else {
            // Switched on with a set of size 0: there is no perturbation, and no gain.
            if PaperSite::of_name(name).is_some_and(|site| !numbers[site].perturbs()) {
                sums.add(name, SiteEffect { fraction, ..SiteEffect::default() });
            }
            continue;
        };
        let at_bound = set.share_at_bound(delta)?;
        let ((loss, rgb), (random_loss, _)) = (render(&used.deltas.only(name))?, render(&random_deltas.only(name))?);
        let shift = colour_shift(&rgb, &clean_rgb)?;
        let (gain, gain_over_random) = (loss - clean_loss, loss - random_loss);
        sums.add(name, SiteEffect { fraction, gain, gain_over_random, shift, at_bound });
    }
    Ok(())
}
