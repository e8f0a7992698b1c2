//! The deltas of a pass, and their constraint sets.

use candle_core::Tensor;

use crate::augment::flat;
use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Draw};
use crate::augment::site::{SetChoices, SiteNumbers};
use crate::augment::sites::{PerSite, Site};
use crate::base::Result;
use crate::base::rng::Random;

/// The deltas of one pass, in the shapes that the sites' files give. A site that is off has none.
#[derive(Clone, Default)]
pub struct Deltas(PerSite<Option<Tensor>>);

impl Deltas {
    /// Returns the delta of a site that is on.
    pub fn get(&self, site: Site) -> Option<&Tensor> {
        self.0[site].as_ref()
    }

    /// Sets a site's delta.
    pub fn set(&mut self, site: Site, delta: Tensor) {
        self.0[site] = Some(delta);
    }

    /// Returns the delta of `site` only, with all other sites off.
    pub fn only(&self, site: Site) -> Deltas {
        let mut alone = Deltas::default();
        alone.0[site].clone_from(&self.0[site]);
        alone
    }
}

/// The constraint sets of one pass. A site that is off, or whose set is a point, has none.
#[derive(Clone, Default)]
pub struct Sets(PerSite<Option<DeltaSet>>);

impl Sets {
    /// Creates the sets of a pass from an experiment's numbers.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(numbers: &PerSite<SiteNumbers>, choices: &SetChoices, pass: &PassGeometry) -> Result<Sets> {
        let mut sets = Sets::default();
        for (site, numbers) in numbers.iter() {
            if numbers.passes.include(pass.is_coarse) && numbers.perturbs() {
                sets.set(site, (site.about().set)(numbers, choices, pass)?);
            }
        }
        Ok(sets)
    }

    /// Returns the set of a site that is on.
    pub fn get(&self, site: Site) -> Option<&DeltaSet> {
        self.0[site].as_ref()
    }

    /// Sets a site's set.
    pub fn set(&mut self, site: Site, set: DeltaSet) {
        self.0[site] = Some(set);
    }

    /// Iterates over the sites that are on, with their sets, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Site, &DeltaSet)> {
        self.0.iter().filter_map(|(site, set)| set.as_ref().map(|set| (site, set)))
    }

    /// Returns a random point of every set. Each site has its own random numbers. Switching one on or off leaves the
    /// others' as they were.
    ///
    /// # Errors
    /// Those of candle.
    pub fn draw(&self, draw: Draw, random: impl Fn(Site) -> Random) -> Result<Deltas> {
        let mut deltas = Deltas::default();
        for (site, set) in self.iter() {
            deltas.set(site, flat::draw(set, draw, &mut random(site))?);
        }
        Ok(deltas)
    }
}
