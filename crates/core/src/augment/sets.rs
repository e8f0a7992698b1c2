//! The deltas of a pass, and the sets that they live in.

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
    /// The delta of a site, where it is on.
    pub fn get(&self, site: Site) -> Option<&Tensor> {
        self.0[site].as_ref()
    }

    /// Puts a site's delta in place.
    pub fn set(&mut self, site: Site, delta: Tensor) {
        self.0[site] = Some(delta);
    }

    /// This delta of `site` alone, all other sites off.
    pub fn only(&self, site: Site) -> Deltas {
        let mut alone = Deltas::default();
        alone.0[site].clone_from(&self.0[site]);
        alone
    }
}

/// The sets of one pass; a site that is off, or whose set is a point, has none.
#[derive(Clone, Default)]
pub struct Sets(PerSite<Option<DeltaSet>>);

impl Sets {
    /// The sets that an experiment's numbers describe for a pass.
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

    /// The set of a site, where it is on.
    pub fn get(&self, site: Site) -> Option<&DeltaSet> {
        self.0[site].as_ref()
    }

    /// Puts a site's set in place.
    pub fn set(&mut self, site: Site, set: DeltaSet) {
        self.0[site] = Some(set);
    }

    /// The sites that are on with their sets, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Site, &DeltaSet)> {
        self.0.iter().filter_map(|(site, set)| set.as_ref().map(|set| (site, set)))
    }

    /// A random point of every set. Each site has numbers of its own, so that switching one on or
    /// off leaves the others' as they were.
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
