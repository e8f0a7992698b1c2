//! The deltas of a pass, and their constraint sets.

use std::sync::Arc;

use candle_core::Tensor;

use crate::base::Result;
use crate::base::rng::Random;
use crate::perturb::geometry::PassGeometry;
use crate::perturb::set::{DeltaSet, Distribution};
use crate::perturb::site::{PaperSite, Site, part_of};

/// The deltas of one pass by the names of their sites. A site that is off has none.
#[derive(Clone, Default)]
pub struct Deltas(Vec<(String, Tensor)>);

impl Deltas {
    /// Returns the delta of a site that is on.
    pub fn get(&self, site: impl AsRef<str>) -> Option<&Tensor> {
        self.0.iter().find(|(name, _)| name == site.as_ref()).map(|(_, delta)| delta)
    }

    /// Gives a site its delta.
    pub fn insert(&mut self, site: impl AsRef<str>, delta: Tensor) {
        match self.0.iter_mut().find(|(name, _)| name == site.as_ref()) {
            Some((_, entry)) => *entry = delta,
            None => self.0.push((site.as_ref().to_string(), delta)),
        }
    }

    /// Returns the delta of `site` only, with all other sites off.
    pub fn only(&self, site: impl AsRef<str>) -> Deltas {
        Deltas(self.0.iter().filter(|(name, _)| name == site.as_ref()).cloned().collect())
    }

    /// Returns all that is added at a site of the paper.
    ///
    /// # Errors
    /// Those of the functions of [`DeltaSet::spread_by`].
    pub fn at(&self, sets: &Sets, paper_site: PaperSite) -> Result<Option<Tensor>> {
        self.sum(sets, |entry| entry.site.at() == paper_site)
    }

    /// Returns what deltas of other shapes than the site's add there.
    pub(super) fn spread(&self, sets: &Sets, paper_site: PaperSite) -> Result<Option<Tensor>> {
        self.sum(sets, |entry| entry.site.at() == paper_site && entry.set.spreads())
    }

    fn sum(&self, sets: &Sets, chosen: impl Fn(&SiteSet) -> bool) -> Result<Option<Tensor>> {
        let mut sum: Option<Tensor> = None;
        for entry in sets.iter().filter(|entry| chosen(entry)) {
            let Some(delta) = self.get(entry.site.name()) else { continue };
            let added = entry.set.spread(delta)?;
            sum = Some(match sum {
                Some(sum) => (sum + added)?,
                None => added,
            });
        }
        Ok(sum)
    }
}

/// A site and the set of its deltas in a pass.
#[derive(Clone)]
pub struct SiteSet {
    /// The site.
    pub site: Arc<dyn Site>,
    /// Its deltas' set.
    pub set: DeltaSet,
}

/// The constraint sets of one pass.
#[derive(Clone, Default)]
pub struct Sets(Vec<SiteSet>);

impl FromIterator<SiteSet> for Sets {
    fn from_iter<I: IntoIterator<Item = SiteSet>>(sets: I) -> Sets {
        Sets(sets.into_iter().collect())
    }
}

impl Sets {
    /// Creates the sets of sites in a pass.
    ///
    /// # Errors
    /// Those of the sites.
    pub fn new(sites: impl IntoIterator<Item = Arc<dyn Site>>, pass: &PassGeometry) -> Result<Sets> {
        let sets = sites.into_iter().map(|site| Ok(SiteSet { set: site.set(pass)?, site }));
        sets.collect()
    }

    /// Iterates over the sites that are on, in order.
    pub fn iter(&self) -> impl Iterator<Item = &SiteSet> {
        self.0.iter()
    }

    /// Iterates over them, mutably.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut SiteSet> {
        self.0.iter_mut()
    }

    /// Returns the set of a site that is on.
    pub fn get(&self, site: impl AsRef<str>) -> Option<&DeltaSet> {
        self.0.iter().find(|entry| entry.site.name() == site.as_ref()).map(|entry| &entry.set)
    }

    /// Returns a random point of every set in pass number `pass` of a step. `random` returns the numbers of a part of the
    /// step. Each site has a part of its own: switching one on or off leaves the others' numbers as they were.
    ///
    /// # Errors
    /// Those of candle.
    pub fn draw(&self, distribution: Distribution, pass: u64, random: impl Fn(u64) -> Random) -> Result<Deltas> {
        let mut deltas = Deltas::default();
        for SiteSet { site, set } in &self.0 {
            deltas.insert(site.name(), set.draw(distribution, &mut random(part_of(site.name(), pass)))?);
        }
        Ok(deltas)
    }

    /// Gives each of so many rays the deltas of another one, as far as its own sets allow: that of the next ray on a random
    /// circle.
    ///
    /// # Errors
    /// Those of candle.
    pub fn permuted(&self, deltas: &Deltas, rays: usize, random: &mut Random) -> Result<Deltas> {
        let circle = random.distinct(rays, rays as u32);
        let mut order = vec![0u32; rays];
        (0..rays).for_each(|i| order[circle[i] as usize] = circle[(i + 1) % rays]);
        let mut permuted = Deltas::default();
        for SiteSet { site, set } in &self.0 {
            if let Some(delta) = deltas.get(site.name()) {
                let order = Tensor::from_slice(&order, rays, delta.device())?;
                permuted.insert(site.name(), set.project(&delta.detach().contiguous()?.index_select(&order, 0)?)?);
            }
        }
        Ok(permuted)
    }
}
