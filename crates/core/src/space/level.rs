//! The level set of a trained density on a lattice, slab by slab.

use std::io::Write;

use serde::Serialize;

use crate::base::{Error, Result};
use crate::field::Density;
use crate::settings::MESH_SIDES;
use crate::space::{Lattice, densities};

use super::{Marcher, Mesh};

/// Bytes that a finished mesh takes with colours, normals and the search for its open edges, over those
/// of its bare vertices and triangles.
const WORKING_SHARE: f64 = 6.0;
const MIB: f64 = 1024.0 * 1024.0;
/// What a mesh takes over what the lattice's planes do: both grow with the square of the resolution. Surfaces of the embedded
/// scene take 15 to 30 times as much; some room is added.
const MESH_OVER_PLANES: f64 = 40.0;
/// The least resolution that can be asked for.
const LEAST_SIDE: usize = *MESH_SIDES.start();

/// How densities are distributed over a lattice's midpoints, 1 / length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DensityRange {
    /// Least one.
    pub least: f32,
    /// Half of all are at most this; this and the next are exact to 1 %.
    pub median: f32,
    /// 90 % of all are.
    pub percentile_90: f32,
    /// 99 % of all are.
    pub percentile_99: f32,
    /// Largest one.
    pub largest: f32,
    /// Share of midpoints at or above the threshold.
    pub inside: f64,
}

/// Counts densities by the upper half of their bits: 128 steps an octave, in ascending order.
struct Histogram {
    counts: Vec<u64>,
    total: u64,
    inside: u64,
    range: (f32, f32),
}

impl Histogram {
    fn new() -> Histogram {
        let range = (f32::INFINITY, f32::NEG_INFINITY);
        Histogram { counts: vec![0; 1 << 15], total: 0, inside: 0, range }
    }

    /// Densities are not negative.
    fn add(&mut self, densities: &[f32], threshold: f32) {
        for &density in densities {
            self.counts[(density.abs().to_bits() >> 16) as usize] += 1;
            self.inside += u64::from(density >= threshold);
            self.range = (self.range.0.min(density), self.range.1.max(density));
        }
        self.total += densities.len() as u64;
    }

    /// The middle of the step that a share of all densities reaches up to.
    fn percentile(&self, share: f64) -> f32 {
        let wanted = (share * self.total as f64).ceil() as u64;
        let mut seen = 0;
        let reached = |&count: &u64| {
            seen += count;
            seen >= wanted.max(1)
        };
        let step = self.counts.iter().position(reached).unwrap_or(0) as u32;
        let middle = if step == 0 { 0.0 } else { f32::from_bits(step << 16 | 1 << 15) };
        middle.clamp(self.range.0, self.range.1)
    }

    fn range(&self) -> DensityRange {
        DensityRange {
            least: self.range.0,
            median: self.percentile(0.5),
            percentile_90: self.percentile(0.9),
            percentile_99: self.percentile(0.99),
            largest: self.range.1,
            inside: self.inside as f64 / self.total as f64,
        }
    }
}

/// A level set and what it was drawn through.
pub struct LevelSet {
    /// In the units that density is queried in, without normals and colours; has triangles.
    pub mesh: Mesh,
    /// The densities on the lattice.
    pub range: DensityRange,
}

/// How a level set is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Drawing {
    /// Where density is queried: at its cells' midpoints.
    pub lattice: Lattice,
    /// Density of the surface, 1 / length.
    pub threshold: f64,
    /// The outermost midpoints count as empty, which closes the surface where it would leave the box.
    pub cap: bool,
    /// Memory that lattice and mesh may take.
    pub most_mib: f64,
}

/// Draws a level set of density. Memory is bounded by some planes of the lattice and the mesh. `volume` gets all
/// densities as little-endian f32, z fastest; `advance` is called after each plane, and its error ends the drawing.
///
/// # Errors
/// A density that is not finite; a level set that is empty, with a threshold that gives one, or that outgrows the
/// memory, with a resolution that may fit.
pub fn level_set(
    density: &dyn Density,
    drawing: &Drawing,
    mut volume: Option<&mut dyn Write>,
    mut advance: impl FnMut() -> Result<()>,
) -> Result<LevelSet> {
    let Drawing { lattice, threshold, cap, .. } = *drawing;
    let (side, threshold) = (lattice.side, threshold as f32);
    drawing.check_planes()?;
    let mut marcher = Marcher::new([side, side], threshold);
    let mut histogram = Histogram::new();
    let mut plane: Vec<f32> = Vec::with_capacity(side * side);
    let (mut planes, mut largest) = (0, f32::NEG_INFINITY);
    densities(density, &lattice, |mut part| {
        if let Some(at) = part.iter().position(|density| !density.is_finite()) {
            let point = lattice.point(planes * side * side + plane.len() + at, [0.5; 3]);
            return Err(Error::Diverged(format!(
                "the density at {point:.3?} is {}: the weights are broken; delete the newest checkpoint to fall back on the \
                 one before it",
                part[at]
            )));
        }
        histogram.add(&part, threshold);
        if let Some(volume) = &mut volume {
            let bytes: Vec<u8> = part.iter().flat_map(|density| density.to_le_bytes()).collect();
            volume.write_all(&bytes).map_err(|e| Error::Output(format!("cannot write the densities: {e}")))?;
        }
        // A part may end one plane and begin the next.
        while !part.is_empty() {
            let rest = part.split_off(part.len().min(side * side - plane.len()));
            plane.append(&mut part);
            part = rest;
            if plane.len() == side * side {
                let mut full = std::mem::replace(&mut plane, Vec::with_capacity(side * side));
                if cap {
                    clear_border(&mut full, side, planes);
                }
                largest = full.iter().copied().fold(largest, f32::max);
                marcher.push(full);
                planes += 1;
                drawing.check_mesh(&marcher, planes)?;
                advance()?;
            }
        }
        Ok(())
    })?;
    let Marcher { vertices, triangles, .. } = marcher;
    if triangles.is_empty() {
        return Err(drawing.no_surface([histogram.range.0, largest]));
    }
    let [lower, upper] = lattice.domain;
    let place = |vertex: [f32; 3]| {
        std::array::from_fn(|axis| {
            let share = (f64::from(vertex[axis]) + 0.5) / side as f64;
            (lower[axis] + share * (upper[axis] - lower[axis])) as f32
        })
    };
    let vertices = vertices.into_iter().map(place).collect();
    Ok(LevelSet { mesh: Mesh { vertices, triangles, ..Mesh::default() }, range: histogram.range() })
}

/// Empties the points of plane `x` that lie on the border of the lattice.
fn clear_border(plane: &mut [f32], side: usize, x: usize) {
    let on_border = |i: usize| i == 0 || i + 1 == side;
    for (at, value) in plane.iter_mut().enumerate() {
        if on_border(x) || on_border(at / side) || on_border(at % side) {
            *value = 0.0;
        }
    }
}

/// What the planes of a lattice take.
fn planes_mib(side: usize) -> f64 {
    Marcher::plane_bytes([side, side]) as f64 / MIB
}

/// What a lattice and its mesh usually take.
fn usual_mib(side: usize) -> f64 {
    (1.0 + MESH_OVER_PLANES) * planes_mib(side)
}

fn mib(amount: f64) -> String {
    let digits = if amount < 10.0 { 3 } else { 0 };
    format!("{amount:.digits$} MiB")
}

impl Drawing {
    fn check_planes(&self) -> Result<()> {
        let side = self.lattice.side;
        if planes_mib(side) <= self.most_mib {
            return Ok(());
        }
        let advice = match self.largest_side(usual_mib) {
            Some(fits) => format!("with its mesh, a resolution of about {fits} may fit"),
            None => format!("with its mesh, even {LEAST_SIDE} would take about {}", mib(usual_mib(LEAST_SIDE))),
        };
        Err(Error::Config(format!(
            "a resolution of {side} takes {} for the lattice's planes alone, and {} (a half of what is free, or `augnerf mesh \
             --memory`) may be taken: {advice}",
            mib(planes_mib(side)),
            mib(self.most_mib)
        )))
    }

    /// Refuses a mesh that outgrows the memory while it grows, with a resolution that may fit.
    fn check_mesh(&self, marcher: &Marcher, planes: usize) -> Result<()> {
        let side = self.lattice.side;
        let mesh = WORKING_SHARE * marcher.mesh_bytes() as f64 / MIB;
        if mesh + planes_mib(side) <= self.most_mib && marcher.vertices.len() < u32::MAX as usize {
            return Ok(());
        }
        // A surface grows with the square of the resolution. Its first planes tell little of the whole: they are in the box's
        // outer part, before the object or at its rim. So twice what they say, and no less than usual.
        let whole = 2.0 * mesh * side as f64 / planes as f64;
        let estimate = |fewer: usize| planes_mib(fewer) + whole * (fewer as f64 / side as f64).powi(2);
        let needed = |fewer: usize| estimate(fewer).max(usual_mib(fewer));
        let advice = match self.largest_side(needed) {
            Some(fits) => format!("a resolution of about {fits} may fit"),
            None => format!("even {LEAST_SIDE} would take about {}", mib(needed(LEAST_SIDE))),
        };
        Err(Error::Config(format!(
            "the level set at resolution {side} outgrows {} (a half of what is free, or `augnerf mesh --memory`) after \
             {planes} of {side} planes, with {} triangles: {advice}; a higher threshold may help, too, for a low one also \
             draws what the training views left undecided",
            mib(self.most_mib),
            marcher.triangles.len()
        )))
    }

    /// The largest resolution below this one that takes no more than the memory.
    fn largest_side(&self, needed_mib: impl Fn(usize) -> f64) -> Option<usize> {
        (LEAST_SIDE..self.lattice.side).rev().find(|&side| needed_mib(side) <= self.most_mib)
    }

    /// Why there is no surface among densities that count from `least` to `largest`, and what threshold would give one.
    fn no_surface(&self, [least, largest]: [f32; 2]) -> Error {
        let Drawing { threshold, lattice: Lattice { domain, .. }, cap, .. } = self;
        let within = if *cap { "within the capped box" } else { "in the box" };
        let range = format!("density {within} from {:?} to {:?} runs from {least} to {largest}", domain[0], domain[1]);
        let advice = if least < largest {
            format!("a threshold of {} would give one", 0.5 * (least + largest))
        } else {
            "no threshold gives one: choose another box, or train longer".into()
        };
        Error::Config(format!("the level set {threshold} is empty: {range}; {advice}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_numbers() {
        let values: Vec<f32> = (0..10_000).map(|i| i as f32 * 0.01).collect();
        let mut histogram = Histogram::new();
        values.chunks(77).for_each(|part| histogram.add(part, 75.0));
        let range = histogram.range();
        assert_eq!((range.least, range.largest), (0.0, 99.99));
        for (found, exact) in [(range.median, 50.0), (range.percentile_90, 90.0), (range.percentile_99, 99.0)] {
            assert!((found / exact - 1.0).abs() < 0.01, "{found} for {exact}");
        }
        assert!((range.inside - 0.25).abs() < 1e-3);
    }

    #[test]
    fn a_cap_empties_the_border_alone() {
        let mut plane = vec![1.0; 9];
        clear_border(&mut plane, 3, 1);
        assert_eq!(plane, [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        clear_border(&mut plane, 3, 2);
        assert_eq!(plane, [0.0; 9]);
    }
}
