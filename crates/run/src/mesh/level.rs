//! The level set of a trained density on a sampling grid, plane by plane.

use std::io::Write;

use serde::Serialize;

use super::{Marcher, Mesh};
use crate::base::{Error, Result, number_text};
use crate::field::Density;
use crate::space::{Lattice, densities};

/// Memory of a finished mesh with colours, normals and the search for its open edges, over that of its bare vertices
/// and triangles.
const WORKING_SHARE: f64 = 6.0;
const MIB: f64 = 1024.0 * 1024.0;

/// The densities at a grid's midpoints, 1 / length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DensityRange {
    /// Smallest density.
    pub least: f32,
    /// Largest density.
    pub largest: f32,
    /// Fraction of midpoints at or above the threshold.
    pub inside: f64,
}

/// A level set, and the densities around it.
pub struct LevelSet {
    /// In the units in which density is queried, without normals and colours. It has at least one triangle.
    pub mesh: Mesh,
    /// The densities on the sampling grid.
    pub range: DensityRange,
}

/// How a level set is computed.
#[derive(Clone, Copy, Debug)]
pub struct Drawing {
    /// The grid at whose cells' midpoints density is queried.
    pub lattice: Lattice,
    /// Density of the surface, 1 / length.
    pub threshold: f64,
    /// Whether the outermost midpoints count as empty. That closes the surface where it would leave the box.
    pub cap: bool,
    /// Memory that grid and mesh may take.
    pub most_mib: f64,
}

/// Computes a level set of density. Memory is bounded by some planes of the grid and the mesh. `volume` gets all
/// densities as little-endian f32, z fastest. `advance` is called after each plane, and its error ends the work.
///
/// # Errors
/// If a density is not finite, if it needs too much memory, or if the level set is empty; the last names a threshold that
/// may work.
pub fn level_set(
    density: &dyn Density,
    drawing: &Drawing,
    mut volume: Option<&mut dyn Write>,
    mut advance: impl FnMut() -> Result<()>,
) -> Result<LevelSet> {
    let Drawing { lattice, threshold, cap, .. } = *drawing;
    let (side, threshold) = (lattice.side, threshold as f32);
    let mut marcher = Marcher::new([side, side], threshold);
    drawing.check_memory(&marcher, 0)?;
    let (mut least, mut greatest, mut inside) = (f32::INFINITY, f32::NEG_INFINITY, 0);
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
        for &density in &part {
            (least, greatest) = (least.min(density), greatest.max(density));
            inside += usize::from(density >= threshold);
        }
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
                drawing.check_memory(&marcher, planes)?;
                advance()?;
            }
        }
        Ok(())
    })?;
    let Marcher { vertices, triangles, .. } = marcher;
    if triangles.is_empty() {
        return Err(drawing.no_surface([least, largest]));
    }
    let [lower, upper] = lattice.domain;
    let place = |vertex: [f32; 3]| {
        std::array::from_fn(|axis| {
            let share = (f64::from(vertex[axis]) + 0.5) / side as f64;
            (lower[axis] + share * (upper[axis] - lower[axis])) as f32
        })
    };
    let vertices = vertices.into_iter().map(place).collect();
    let range = DensityRange { least, largest: greatest, inside: inside as f64 / lattice.cells() as f64 };
    Ok(LevelSet { mesh: Mesh { vertices, triangles, ..Mesh::default() }, range })
}

/// Empties the points of plane `x` that are on the border of the grid.
fn clear_border(plane: &mut [f32], side: usize, x: usize) {
    let on_border = |i: usize| i == 0 || i + 1 == side;
    for (at, value) in plane.iter_mut().enumerate() {
        if on_border(x) || on_border(at / side) || on_border(at % side) {
            *value = 0.0;
        }
    }
}

fn mib(amount: f64) -> String {
    let digits = if amount < 10.0 { 3 } else { 0 };
    format!("{amount:.digits$} MiB")
}

impl Drawing {
    /// Returns an error if the grid's planes and the growing mesh take too much memory.
    fn check_memory(&self, marcher: &Marcher, planes: usize) -> Result<()> {
        let side = self.lattice.side;
        let grid = Marcher::plane_bytes([side, side]) as f64;
        let needed = (grid + WORKING_SHARE * marcher.mesh_bytes() as f64) / MIB;
        if needed <= self.most_mib && marcher.vertices.len() < u32::MAX as usize {
            return Ok(());
        }
        let (most, triangles) = (mib(self.most_mib), marcher.triangles.len());
        let when = match planes {
            0 => "before its first triangle: choose a lower resolution or allow more memory".into(),
            _ => format!(
                "after {planes} of {side} planes, with {triangles} triangles: choose a lower resolution or a higher threshold, \
                 for a low one also draws what the training views left undecided"
            ),
        };
        Err(Error::Config(format!(
            "the level set at resolution {side} outgrows {most} (a half of what is free, or `augnerf mesh --memory`) {when}"
        )))
    }

    /// Returns the error for an empty surface. `least` and `largest` are the smallest and the largest density that
    /// count.
    fn no_surface(&self, [least, largest]: [f32; 2]) -> Error {
        let Drawing { threshold, lattice: Lattice { domain, .. }, cap, .. } = self;
        let within = if *cap { "within the capped box" } else { "in the box" };
        // Four digits are enough for a choice.
        let short = |number: f64| number_text(format!("{number:.3e}").parse().unwrap_or(number));
        let (from, to) = (short(f64::from(least)), short(f64::from(largest)));
        let range = format!("density {within} from {:?} to {:?} runs from {from} to {to}", domain[0], domain[1]);
        let advice = if least < largest {
            let between = short(f64::from(0.5 * (least + largest)));
            format!("choose a threshold between, such as {between}, or train longer")
        } else {
            "no threshold gives one: choose another box, or train longer".into()
        };
        let threshold = short(*threshold);
        Error::Config(format!("there is no surface at density {threshold}: {range}; {advice}"))
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};

    use super::*;

    /// Density is y.
    struct Ramp;

    impl Density for Ramp {
        fn density(&self, points: &Tensor, _: [f64; 3]) -> Result<Tensor> {
            Ok(points.narrow(1, 1, 1)?.squeeze(1)?)
        }

        fn gradient(&self, _: &Tensor, _: [f64; 3]) -> Result<Tensor> {
            unreachable!("a level set needs density alone")
        }

        fn rgb(&self, _: &Tensor, _: [f64; 3], _: &Tensor) -> Result<Tensor> {
            unreachable!("a level set needs density alone")
        }

        fn dtype(&self) -> DType {
            DType::F32
        }

        fn device(&self) -> &Device {
            &Device::Cpu
        }
    }

    /// Midpoints are at y = 0.5, 1.5, 2.5 and 3.5.
    #[test]
    fn the_surface_of_a_linear_density_is_the_plane_of_the_threshold() {
        let lattice = Lattice { domain: [[-1.0, 0.0, -1.0], [1.0, 4.0, 1.0]], side: 4 };
        let drawing = Drawing { lattice, threshold: 2.25, cap: false, most_mib: 100.0 };
        let LevelSet { mesh, range } = level_set(&Ramp, &drawing, None, || Ok(())).unwrap();
        assert!(mesh.vertices.iter().all(|[_, y, _]| (y - 2.25).abs() < 1e-6), "{:?}", mesh.vertices);
        assert_eq!(mesh.vertices.len(), 16, "one for each column of midpoints");
        assert_eq!(range, DensityRange { least: 0.5, largest: 3.5, inside: 0.5 });
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
