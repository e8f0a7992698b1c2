//! The deltas of a pass, and their constraint sets.

use std::sync::Arc;

use candle_core::Tensor;

use crate::augment::flat;
use crate::augment::geometry::PassGeometry;
use crate::augment::own::{OwnDelta, OwnEntry, OwnSite};
use crate::augment::set::{DeltaSet, Draw};
use crate::augment::site::{Level, SetChoices, SiteNumbers};
use crate::augment::sites::{PerSite, Site, own_part};
use crate::base::Result;
use crate::base::rng::Random;

/// The deltas of one pass, in the shapes that the sites' files give. A site that is off has none.
#[derive(Clone, Default)]
pub struct Deltas {
    of_sites: PerSite<Option<Tensor>>,
    own: Vec<OwnDelta>,
}

impl Deltas {
    /// Returns the delta of a site that is on.
    pub fn get(&self, site: Site) -> Option<&Tensor> {
        self.of_sites[site].as_ref()
    }

    /// Sets a site's delta.
    pub fn set(&mut self, site: Site, delta: Tensor) {
        self.of_sites[site] = Some(delta);
    }

    /// Returns the delta of `site` only, with all other sites off.
    pub fn only(&self, site: Site) -> Deltas {
        let mut alone = Deltas::default();
        alone.of_sites[site].clone_from(&self.of_sites[site]);
        alone
    }

    /// Returns the delta of the own site `name`, if it is on.
    pub fn own(&self, name: &str) -> Option<&Tensor> {
        self.own.iter().find(|own| own.name() == name).map(|own| &own.delta)
    }

    /// Sets an own site's delta.
    pub(crate) fn set_own(&mut self, entry: &OwnEntry, delta: Tensor) {
        let own = OwnDelta::new(entry, delta);
        match self.own.iter_mut().find(|known| known.name() == own.name()) {
            Some(known) => *known = own,
            None => self.own.push(own),
        }
    }

    /// Returns the delta of the own site `name` only, with all other sites off.
    pub(crate) fn only_own(&self, name: &str) -> Deltas {
        let own = self.own.iter().filter(|own| own.name() == name).cloned().collect();
        Deltas { own, ..Deltas::default() }
    }

    /// Returns what own sites add at the place of `site`, or `None` if there are none.
    ///
    /// # Errors
    /// Those of the sites' own functions.
    pub(crate) fn spread(&self, site: Site) -> Result<Option<Tensor>> {
        let mut sum: Option<Tensor> = None;
        for own in self.own.iter().filter(|own| own.place() == site) {
            let spread = own.spread()?;
            sum = Some(match sum {
                Some(sum) => (sum + spread)?,
                None => spread,
            });
        }
        Ok(sum)
    }

    /// Returns all that is added at the place of `site`: its own delta, and what own sites add.
    ///
    /// # Errors
    /// Those of the sites' own functions.
    pub(crate) fn at(&self, site: Site) -> Result<Option<Tensor>> {
        Ok(match (self.get(site), self.spread(site)?) {
            (Some(delta), Some(own)) => Some((delta + own)?),
            (delta, own) => delta.cloned().or(own),
        })
    }
}

/// The constraint sets of one pass. A site that is off, or whose set is a point, has none.
#[derive(Clone, Default)]
pub struct Sets {
    of_sites: PerSite<Option<DeltaSet>>,
    own: Vec<OwnEntry>,
}

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
        self.of_sites[site].as_ref()
    }

    /// Sets a site's set.
    pub fn set(&mut self, site: Site, set: DeltaSet) {
        self.of_sites[site] = Some(set);
    }

    /// Adds the sets of own sites in a pass.
    ///
    /// # Errors
    /// Those of the sites' own functions.
    pub fn add_own(&mut self, sites: &[Arc<dyn OwnSite>], pass: &PassGeometry) -> Result<()> {
        for site in sites {
            self.own.push(OwnEntry { site: site.clone(), own: site.in_pass(pass)? });
        }
        Ok(())
    }

    /// Returns the own sites that are on, with their sets, in the order in which they were added.
    pub(crate) fn own(&self) -> &[OwnEntry] {
        &self.own
    }

    /// Returns whether own sites are on at a place of `level`.
    pub(crate) fn has_own_at(&self, level: Level) -> bool {
        self.own.iter().any(|entry| entry.site.place().about().level == level)
    }

    /// Iterates over the sites that are on, with their sets, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Site, &DeltaSet)> {
        self.of_sites.iter().filter_map(|(site, set)| set.as_ref().map(|set| (site, set)))
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

    /// Draws own sites' deltas as [`Sets::draw`] draws the others'. `random` returns the numbers of a part of the step, in
    /// which this is pass number `pass`.
    ///
    /// # Errors
    /// Those of candle.
    pub(crate) fn draw_own(
        &self,
        deltas: &mut Deltas,
        draw: Draw,
        pass: u64,
        random: impl Fn(u64) -> Random,
    ) -> Result<()> {
        for entry in &self.own {
            let drawn = flat::draw(&entry.own.set, draw, &mut random(own_part(entry.site.name(), pass)))?;
            deltas.set_own(entry, drawn);
        }
        Ok(())
    }
}
