//! Sites of your own: deltas of any shape, spread over the samples of a pass at the place of a built-in site.

use std::sync::Arc;

use candle_core::Tensor;

use crate::augment::geometry::PassGeometry;
use crate::augment::set::DeltaSet;
use crate::augment::sites::Site;
use crate::base::Result;

/// Keys of own sites begin here, above all built-in ones.
const FIRST_KEY: u64 = 1 << 18;

/// A site of your own.
///
/// Its delta can have any shape: one number a ray, or six numbers of a camera. [`OwnSite::in_pass`] says which deltas are allowed
/// and how one is spread over the pass, where it is added to what the built-in site of the same place adds. The search moves it
/// with all other sites.
pub trait OwnSite: Send + Sync {
    /// Returns its name, which no other site has. Its diagnostics are logged as `gain.NAME`, `shift.NAME`, and so on.
    fn name(&self) -> &str;

    /// Returns the place at which it is added: that of a built-in site.
    fn place(&self) -> Site;

    /// Returns its set and how a delta is spread, in a pass. A pass has the rays of one part of a step (`train.chunk`).
    ///
    /// # Errors
    /// Those of candle.
    fn in_pass(&self, pass: &PassGeometry) -> Result<OwnSet>;

    /// Returns the number of PGD steps.
    fn steps(&self) -> usize {
        3
    }

    /// Returns the length of a PGD step in radii of its set.
    fn step_size(&self) -> f64 {
        0.5
    }
}

/// Maps a delta to what is added at its place, differentiably.
pub type Spread = Arc<dyn Fn(&Tensor) -> Result<Tensor> + Send + Sync>;

/// An own site in one pass.
#[derive(Clone)]
pub struct OwnSet {
    /// The allowed deltas.
    pub set: DeltaSet,
    /// Returns what a delta adds: `t_vals`' shape at [`Site::T`], `[rays, samples, 3]` at [`Site::Xyz`] and [`Site::Rgb`],
    /// `[rays, 2]` at [`Site::View`], `[rays, samples, width]` at [`Site::Feature`], `[rays, samples]` at [`Site::Density`].
    pub spread: Spread,
}

impl OwnSet {
    /// Creates one from a function that spreads a delta.
    pub fn new(set: DeltaSet, spread: impl Fn(&Tensor) -> Result<Tensor> + Send + Sync + 'static) -> OwnSet {
        OwnSet { set, spread: Arc::new(spread) }
    }
}

/// An own site's set in a pass, with its place and search.
#[derive(Clone)]
pub(crate) struct OwnEntry {
    pub(crate) site: Arc<dyn OwnSite>,
    pub(crate) own: OwnSet,
}

/// An own site's delta.
#[derive(Clone)]
pub(crate) struct OwnDelta {
    pub(crate) delta: Tensor,
    entry: OwnEntry,
}

impl OwnDelta {
    pub(crate) fn new(entry: &OwnEntry, delta: Tensor) -> OwnDelta {
        OwnDelta { delta, entry: entry.clone() }
    }

    pub(crate) fn place(&self) -> Site {
        self.entry.site.place()
    }

    pub(crate) fn name(&self) -> &str {
        self.entry.site.name()
    }

    pub(crate) fn spread(&self) -> Result<Tensor> {
        (self.entry.own.spread)(&self.delta)
    }
}

/// Returns the key of an own site's random numbers, which follows from its name alone (FNV-1a).
pub(crate) fn key(name: &str) -> u64 {
    let hash = name
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    FIRST_KEY + hash % FIRST_KEY
}
