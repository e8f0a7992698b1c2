//! Samples where they count: even intervals of a ray, without those in empty cells and behind what hides them (Mueller et al. 2022,
//! appendix E).
//!
//! A grid of cells over the hash grid's cube keeps the largest optical depth that an interval lately had in each. What it calls empty
//! is not queried. The field's own density then says where the light ends.

use std::sync::{Arc, PoisonError, RwLock};

use candle_core::{DType, Device, Tensor, Var};
use rayon::prelude::*;

use crate::base::Result;
use crate::base::rng::Random;
use crate::data::Rays;
use crate::field::hash::{Contraction, Domain};
use crate::field::{Density, Field, FieldDensity, Queried};
use crate::render::settings::OccupancyConfig;

use super::pass::PlacedSamples;

/// Points of an update that are queried at once.
const AT_ONCE: usize = 4096;

/// The occupied cells of a hash grid's cube.
#[derive(Clone)]
pub struct Occupancy {
    config: OccupancyConfig,
    domain: Domain,
    /// The largest optical depth of an interval in each cell, lately, `[cells^3]`, x fastest.
    depths: Var,
    /// One bit a cell, which follows from the depths. Clones share both.
    occupied: Arc<RwLock<Bits>>,
}

/// One bit for each cell.
type Bits = Arc<[u64]>;

impl Occupancy {
    /// Returns the number of cells.
    pub fn cells(config: &OccupancyConfig) -> usize {
        config.cells.pow(3)
    }

    /// Creates it with given depths `[cells^3]`. If all are 0, all cells are occupied.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(config: &OccupancyConfig, domain: Domain, depths: &Tensor) -> Result<Occupancy> {
        let depths = Var::from_tensor(&depths.copy()?)?;
        let occupied = Arc::new(RwLock::new(occupied(&host(depths.as_tensor())?, config.threshold as f32)));
        Ok(Occupancy { config: config.clone(), domain, depths, occupied })
    }

    /// Returns the depths, which a checkpoint keeps.
    pub fn depths(&self) -> &Var {
        &self.depths
    }

    /// Returns the length in t of an interval between near and far, on average.
    fn interval(&self, (near, far): (f64, f64)) -> f64 {
        (far - near) / self.config.intervals as f64
    }

    /// Updates a sixteenth of the cells and as many occupied ones, or `all`, as always if nothing is known of any. The field is queried
    /// at a random point of each.
    ///
    /// # Errors
    /// Those of candle.
    pub fn update(&self, field: &Field, bounds: (f64, f64), all: bool, random: &mut Random) -> Result<()> {
        let mut depths = host(self.depths.as_tensor())?;
        let is_first = depths.iter().all(|depth| *depth == 0.0);
        let updated = self.cells_to_update(all || is_first, random);
        let points: Vec<f32> = updated.iter().flat_map(|cell| self.point_in(*cell, random)).collect();
        let interval = self.interval(bounds) as f32;
        let parts: Vec<&[f32]> = points.chunks(3 * AT_ONCE).collect();
        let densities: Vec<Vec<f32>> =
            parts.into_par_iter().map(|points| densities(field, points)).collect::<Result<_>>()?;
        let decay = self.config.decay as f32;
        for (cell, density) in updated.iter().zip(densities.iter().flatten()) {
            let depth = &mut depths[*cell as usize];
            *depth = (*depth * decay).max(density * interval);
        }
        let bits = occupied(&depths, self.config.threshold as f32);
        *self.occupied.write().unwrap_or_else(PoisonError::into_inner) = bits;
        let like = self.depths.as_tensor();
        self.depths.set(
            &Tensor::from_vec(depths, like.shape(), &Device::Cpu)?.to_dtype(like.dtype())?.to_device(like.device())?,
        )?;
        Ok(())
    }

    fn cells_to_update(&self, all: bool, random: &mut Random) -> Vec<u32> {
        let count = Occupancy::cells(&self.config);
        if all {
            return (0..count as u32).collect();
        }
        let bits = self.bits();
        let occupied: Vec<u32> = (0..count as u32).filter(|cell| is_set(&bits, *cell as usize)).collect();
        let share = count / 16;
        let mut any = |of: usize| (random.uniform() * of as f64) as usize;
        let mut cells: Vec<u32> = (0..share).map(|_| any(count) as u32).collect();
        match occupied.len() <= share {
            true => cells.extend(&occupied),
            false => cells.extend((0..share).map(|_| occupied[any(occupied.len())])),
        }
        cells
    }

    /// Returns a random point in a cell, in the scene.
    fn point_in(&self, cell: u32, random: &mut Random) -> [f32; 3] {
        let side = self.config.cells as u32;
        let corner = [cell % side, cell / side % side, cell / (side * side)];
        let unit = corner.map(|corner| (f64::from(corner) + random.uniform()) / f64::from(side));
        // Where there is no point of the scene, density is not a number, and no interval comes there.
        self.domain.point_at(unit).map_or([f32::NAN; 3], |point| point.map(|x| x as f32))
    }

    /// Returns 1 for points `[n, 3]` in occupied cells and 0 for others, `[n]`.
    fn mask(&self, points: &Tensor) -> Result<Tensor> {
        let scene = host(points)?;
        let (mut unit, mut inside) = (vec![0f32; scene.len()], vec![false; scene.len() / 3]);
        self.domain.map(&scene, &mut unit, &mut inside);
        let (side, bits) = (self.config.cells, self.bits());
        let is_occupied = |(unit, inside): (&[f32; 3], &bool)| {
            let [x, y, z] = unit.map(|unit| ((unit * side as f32) as usize).min(side - 1));
            u8::from(*inside && is_set(&bits, x + side * (y + side * z)))
        };
        let mask: Vec<u8> = unit.as_chunks::<3>().0.iter().zip(&inside).map(is_occupied).collect();
        Ok(Tensor::new(mask, points.device())?.to_dtype(points.dtype())?)
    }

    fn bits(&self) -> Bits {
        self.occupied.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns each ray's intervals in occupied cells, of the even ones between near and far. These begin at near plus
    /// `shift [rays, 1]` times their length, 0 without it.
    ///
    /// # Errors
    /// Those of candle.
    pub fn march(&self, rays: &Rays, bounds: (f64, f64), shift: Option<&Tensor>) -> Result<Vec<Arc<Intervals>>> {
        let (origins, directions) = (host(&rays.origins)?, host(&rays.directions)?);
        let shifts = shift.map_or_else(|| Ok(vec![0.0; rays.len()]), host)?;
        let marcher = Marcher { config: &self.config, domain: self.domain, occupied: self.bits(), bounds };
        let rays = origins.as_chunks::<3>().0.par_iter().zip(directions.as_chunks::<3>().0).zip(shifts);
        Ok(rays.map(|((origin, direction), shift)| Arc::new(marcher.march(*origin, *direction, shift))).collect())
    }

    /// Returns the samples of rays in their intervals: edges `[rays, columns]`, as many as the ray with the most needs. `field` says
    /// what is hidden.
    ///
    /// # Errors
    /// Those of candle.
    pub fn place(&self, field: &Field, rays: &Rays, intervals: &[Arc<Intervals>]) -> Result<PlacedSamples> {
        let (origins, directions) = (host(&rays.origins)?, host(&rays.directions)?);
        let mut points = Vec::new();
        for ((intervals, origin), direction) in
            intervals.iter().zip(origins.as_chunks::<3>().0).zip(directions.as_chunks::<3>().0)
        {
            for middle in intervals.middles() {
                points.extend((0..3).map(|axis| origin[axis] + middle * direction[axis]));
            }
        }
        let densities = if points.is_empty() { Vec::new() } else { densities(field, &points)? };
        let (mut rest, mut seen) = (densities.as_slice(), Vec::with_capacity(intervals.len()));
        for (intervals, norm) in intervals.iter().zip(host(&rays.direction_norm)?) {
            let (own, others) = rest.split_at(intervals.count());
            seen.push(intervals.seen(own, norm, self.config.transmittance as f32));
            rest = others;
        }
        // A pass has a sample, if only one that is empty.
        let columns = 1 + seen.iter().copied().max().unwrap_or(0).max(1);
        let (mut t_vals, mut queried) = (Vec::with_capacity(seen.len() * columns), Vec::with_capacity(densities.len()));
        for (ray, (intervals, seen)) in intervals.iter().zip(&seen).enumerate() {
            let edges = &intervals.edges[..intervals.edges.len().min(seen + 1)];
            t_vals.extend_from_slice(edges);
            // What is added goes on as the ray ended, so that its last gap is none of 0.
            let (last, gap) = match edges {
                [.., before, last] => (*last, last - before),
                _ => (0.0, 1.0),
            };
            let added = (ray + 1) * columns - t_vals.len();
            t_vals.extend((1..=added).map(|i| last + i as f32 * gap));
            let first = (ray * (columns - 1)) as u32;
            queried.extend(
                (first..).zip(&intervals.queried[..*seen]).filter(|(_, queried)| **queried).map(|(sample, _)| sample),
            );
        }
        let like = &rays.origins;
        let t_vals = Tensor::from_vec(t_vals, (seen.len(), columns), &Device::Cpu)?;
        let t_vals = t_vals.to_dtype(like.dtype())?.to_device(like.device())?;
        Ok(PlacedSamples { t_vals, queried: Some(Queried::new(queried, seen.len() * (columns - 1))) })
    }
}

/// The intervals of a ray: those in occupied cells, and what is empty between them, each in one.
#[derive(Default)]
pub struct Intervals {
    edges: Vec<f32>,
    /// Which are in occupied cells.
    queried: Vec<bool>,
}

impl Intervals {
    /// Adds an interval in an occupied cell, and what is empty before it.
    fn push(&mut self, start: f32, end: f32) {
        match self.edges.last() {
            None => self.edges.push(start),
            Some(last) if *last != start => {
                self.edges.push(start);
                self.queried.push(false);
            }
            Some(_) => {}
        }
        self.edges.push(end);
        self.queried.push(true);
    }

    /// Returns how many are in occupied cells.
    pub fn count(&self) -> usize {
        self.queried.iter().filter(|queried| **queried).count()
    }

    /// Iterates over the middles of those in occupied cells.
    fn middles(&self) -> impl Iterator<Item = f32> {
        let intervals = self.edges.windows(2).zip(&self.queried);
        intervals.filter(|(_, queried)| **queried).map(|(edges, _)| 0.5 * (edges[0] + edges[1]))
    }

    /// Returns the number of intervals before less than `least` of the light is left. `densities` are those in occupied cells.
    fn seen(&self, densities: &[f32], norm: f32, least: f32) -> usize {
        let (mut densities, mut optical) = (densities.iter(), 0.0);
        let is_last = |(k, queried): (usize, &bool)| {
            if *queried {
                let density = densities.next().expect("one for each");
                optical += density * (self.edges[k + 1] - self.edges[k]) * norm;
            }
            f32::exp(-optical) < least
        };
        self.queried.iter().enumerate().position(is_last).map_or(self.queried.len(), |last| last + 1)
    }
}

/// A field's density with its occupied cells, as pictures show it: it is 0 outside of them.
pub struct OccupiedDensity {
    field: FieldDensity,
    occupancy: Occupancy,
}

impl OccupiedDensity {
    /// Creates the density of a field with its current weights and occupied cells.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(field: &Field, occupancy: &Occupancy) -> Result<OccupiedDensity> {
        Ok(OccupiedDensity { field: FieldDensity::new(field)?, occupancy: occupancy.clone() })
    }
}

impl Density for OccupiedDensity {
    fn density(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor> {
        Ok((self.field.density(points, variance)? * self.occupancy.mask(points)?)?)
    }

    fn gradient(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor> {
        Ok(self.field.gradient(points, variance)?.broadcast_mul(&self.occupancy.mask(points)?.unsqueeze(1)?)?)
    }

    fn rgb(&self, points: &Tensor, variance: [f64; 3], viewdirs: &Tensor) -> Result<Tensor> {
        self.field.rgb(points, variance, viewdirs)
    }

    fn dtype(&self) -> DType {
        self.field.dtype()
    }

    fn device(&self) -> &Device {
        self.field.device()
    }
}

/// Walks along rays.
struct Marcher<'a> {
    config: &'a OccupancyConfig,
    domain: Domain,
    occupied: Bits,
    bounds: (f64, f64),
}

impl Marcher<'_> {
    /// Returns a ray's intervals whose middles are in occupied cells.
    fn march(&self, origin: [f32; 3], direction: [f32; 3], shift: f32) -> Intervals {
        let (Marcher { config, domain, .. }, (near, far)) = (self, self.bounds);
        let (side, count) = (config.cells as f32, config.intervals);
        let length = (far - near) / count as f64;
        let edge = |i: usize| (near + (i as f64 + f64::from(shift)).min(count as f64) * length) as f32;
        let (low, high) = domain.corners();
        let is_box = domain.contraction() == Contraction::None;
        let scale: [f32; 3] = std::array::from_fn(|axis| side / (high[axis] - low[axis]) as f32);
        let first: [f32; 3] = std::array::from_fn(|axis| (origin[axis] - low[axis] as f32) * scale[axis]);
        let slope: [f32; 3] = std::array::from_fn(|axis| direction[axis] * scale[axis]);
        // The intervals in the box, and one more at each end, for rounding.
        let (enters, leaves) = if is_box { inside(first, slope, side) } else { (near as f32, far as f32) };
        let number = |t: f32| (f64::from(t) - near) / length - f64::from(shift);
        let (from, to) = ((number(enters) - 1.0).max(0.0) as usize, (number(leaves) + 2.0).min(count as f64) as usize);
        let (mut intervals, mut start) = (Intervals::default(), edge(from));
        for i in from..to {
            let end = edge(i + 1);
            let middle = 0.5 * (start + end);
            let position: [f32; 3] = if is_box {
                std::array::from_fn(|axis| first[axis] + middle * slope[axis])
            } else {
                let (mut unit, point) = ([0f32; 3], [0, 1, 2].map(|axis| origin[axis] + middle * direction[axis]));
                domain.map(&point, &mut unit, &mut [false]);
                unit.map(|unit| unit * side)
            };
            let [x, y, z] = position.map(|x| (x.max(0.0) as usize).min(config.cells - 1));
            let is_inside = position.iter().all(|x| (0.0..=side).contains(x));
            if is_inside && is_set(&self.occupied, x + config.cells * (y + config.cells * z)) {
                intervals.push(start, end);
            }
            start = end;
        }
        intervals
    }
}

/// Returns the first and the last t at which `first + t * slope` is in the cube of that side. The first is not below the last where it
/// never is.
fn inside(first: [f32; 3], slope: [f32; 3], side: f32) -> (f32, f32) {
    first.into_iter().zip(slope).fold((f32::NEG_INFINITY, f32::INFINITY), |(enters, leaves), (first, slope)| {
        let (a, b) = (-first / slope, (side - first) / slope);
        (enters.max(a.min(b)), leaves.min(a.max(b)))
    })
}

/// Returns densities at scene points `[n, 3]`.
fn densities(field: &Field, points: &[f32]) -> Result<Vec<f32>> {
    let points = Tensor::from_slice(points, (points.len() / 3, 3), &Device::Cpu)?;
    let points = points.to_dtype(field.dtype())?.to_device(field.device())?;
    host(&field.activate_density(&field.raw_density(&points)?)?)
}

fn is_set(bits: &[u64], cell: usize) -> bool {
    bits[cell >> 6] >> (cell & 63) & 1 == 1
}

/// Returns one bit for each cell that is at least as deep as the threshold, or as the mean if that is less.
fn occupied(depths: &[f32], threshold: f32) -> Bits {
    let mean = depths.iter().map(|depth| f64::from(depth.min(1.0))).sum::<f64>() / depths.len() as f64;
    let threshold = threshold.min(mean as f32);
    let bits = |depths: &[f32]| depths.iter().rev().fold(0, |bits, depth| bits << 1 | u64::from(*depth >= threshold));
    depths.chunks(64).map(bits).collect()
}

fn host(tensor: &Tensor) -> Result<Vec<f32>> {
    Ok(tensor.detach().to_device(&Device::Cpu)?.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?)
}
