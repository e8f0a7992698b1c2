//! The list of sites: the points of the perturbed pass at which a delta is added.
//!
//! A new site is a file here, two lines below, and the code that adds it to the pass: the compiler names the matches in
//! `render` (and those of the GPU). It is off by default. This list reads and writes its section `perturb.NAME`. Its
//! random numbers are its own: `the_first_six_keep_their_numbers` says which keys are taken.

use std::ops::{Index, IndexMut};

use crate::augment::site::SiteSpec;

mod density;
mod feature;
mod rgb;
mod t;
mod view;
mod xyz;

macro_rules! sites {
    ($($(#[$doc:meta])* $site:ident in $file:ident,)*) => {
        /// A point of the pass at which a delta is added.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Site {
            $($(#[$doc])* $site,)*
        }

        impl Site {
            /// All sites, in the order of columns and of all other lists.
            pub const ALL: [Site; [$(Site::$site),*].len()] = [$(Site::$site),*];

            /// Returns its specification.
            pub fn about(self) -> &'static SiteSpec {
                match self {
                    $(Site::$site => &$file::SITE,)*
                }
            }
        }
    };
}

sites! {
    /// Shift along the ray.
    T in t,
    /// Shift of a sample's point.
    Xyz in xyz,
    /// Tilt of the viewing direction.
    View in view,
    /// Added to a trunk layer's output.
    Feature in feature,
    /// Added to the colour.
    Rgb in rgb,
    /// Added to the density.
    Density in density,
}

/// Number of keys below which parts of a step are numbered directly. Other keys use the bits above.
const KEYS: u64 = 8;
/// Parts of a step are far fewer than 2 to this.
const PART_BITS: u32 = 48;

impl Site {
    /// Returns the name in settings, logs and tables.
    pub fn name(self) -> &'static str {
        self.about().name
    }

    /// Returns the site of a name.
    pub fn of_name(name: &str) -> Option<Site> {
        Site::ALL.into_iter().find(|site| site.name() == name)
    }

    /// Returns the part of a step's random numbers that is this site's own in the step's pass number `pass`.
    pub fn part(self, pass: u64) -> u64 {
        part(self.about().key, pass)
    }
}

/// Returns the part of a step's random numbers that is an own site's in the step's pass number `pass`.
pub(crate) fn own_part(name: &str, pass: u64) -> u64 {
    part(crate::augment::own::key(name), pass)
}

/// Injective in both if `pass` is below 2^45.
fn part(key: u64, pass: u64) -> u64 {
    ((key / KEYS) << PART_BITS) + KEYS * pass + key % KEYS
}

/// One value per site.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PerSite<T>([T; Site::ALL.len()]);

impl<T> PerSite<T> {
    /// Creates the values with `value` of each site.
    pub fn from_fn(value: impl FnMut(Site) -> T) -> PerSite<T> {
        PerSite(Site::ALL.map(value))
    }

    /// Iterates over the sites with their values, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Site, &T)> {
        Site::ALL.into_iter().zip(&self.0)
    }

    /// Iterates over the sites with their values, mutably.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = (Site, &mut T)> {
        Site::ALL.into_iter().zip(&mut self.0)
    }
}

impl<T> Index<Site> for PerSite<T> {
    type Output = T;

    fn index(&self, site: Site) -> &T {
        &self.0[site as usize]
    }
}

impl<T> IndexMut<Site> for PerSite<T> {
    fn index_mut(&mut self, site: Site) -> &mut T {
        &mut self.0[site as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::augment::site::Passes;
    use std::collections::HashSet;

    /// Runs of every earlier program drew the numbers of site k in pass p from part 8 p + k of their step.
    #[test]
    fn the_first_six_keep_their_numbers() {
        let first = [Site::T, Site::Xyz, Site::View, Site::Feature, Site::Rgb, Site::Density];
        for (k, site) in first.into_iter().enumerate() {
            assert_eq!((site.part(0), site.part(77)), (k as u64, 8 * 77 + k as u64));
        }
    }

    #[test]
    fn no_two_sites_share_a_name_or_random_numbers_and_a_younger_one_is_off() {
        let names: HashSet<&str> = Site::ALL.iter().map(|site| site.name()).collect();
        let keys: HashSet<u64> = Site::ALL.iter().map(|site| site.about().key).collect();
        assert_eq!((names.len(), keys.len()), (Site::ALL.len(), Site::ALL.len()));
        for site in Site::ALL {
            assert_eq!(Site::of_name(site.name()), Some(site));
            assert_eq!(site.about().passes, if site.about().key < 6 { Passes::Both } else { Passes::Off }, "{site:?}");
        }
        let parts: Vec<u64> = (0..40).flat_map(|key| (0..1000).map(move |pass| part(key, pass))).collect();
        assert_eq!(parts.iter().collect::<HashSet<_>>().len(), parts.len());
    }
}
