//! The forward pass of a chunk of rays.

use crate::srn::network::HIDDEN;
use augnerf_fast::fused::kernels::head_forward;
use augnerf_fast::fused::kernels::panels::{Form, Panels, Slab};
use augnerf_fast::fused::kernels::product::{Bias, Finish, Lhs, Out, Rows, Source};

use super::cell::{self, State};
use super::norm;
use super::weights::{Block, GATES, Network};

/// Rays and their initial depths; vectors are `[rays, 3]`.
#[derive(Clone, Copy)]
pub(crate) struct Lines<'a> {
    pub(crate) origins: &'a [f32],
    pub(crate) directions: &'a [f32],
    pub(crate) viewdirs: &'a [f32],
    /// Scene units times `srn.scale`, `[rays]`.
    pub(crate) z_0: &'a [f32],
}

impl Lines<'_> {
    pub(super) fn len(&self) -> usize {
        self.z_0.len()
    }

    /// Returns the length of each ray's direction.
    pub(super) fn norms(&self) -> Vec<f32> {
        self.directions.chunks_exact(3).map(|d| d.iter().map(|d| d * d).sum::<f32>().sqrt()).collect()
    }
}

/// The end of a chunk's march and, for a backward pass, what it went through.
pub(crate) struct Tape {
    /// Colour from -1 to 1, unless it overshoots, `[rays, 3]`.
    pub(crate) colour: Vec<f32>,
    /// Depth at the end, scene units times `srn.scale`, `[rays]`.
    pub(crate) z: Vec<f32>,
    /// Every query of Phi: before each step, and at the end.
    pub(super) queries: Vec<Query>,
    pub(super) pixel: Normals,
    /// After each step.
    pub(super) states: Vec<State>,
    /// The cell's outputs after each step, in the layout of products.
    pub(super) outputs: Vec<Slab>,
}

/// A query of Phi.
pub(super) struct Query {
    pub(super) points: Slab,
    pub(super) normals: Normals,
}

/// The normalized numbers of each layer, and 1 over each row's deviation.
pub(super) struct Normals {
    pub(super) layers: Vec<Slab>,
    pub(super) inverse: Vec<Vec<f32>>,
}

impl Normals {
    fn new(blocks: &[Block], rays: usize) -> Normals {
        Normals {
            layers: blocks.iter().map(|block| slab(rays, block.scale.len())).collect(),
            inverse: vec![vec![0.0; rays]; blocks.len()],
        }
    }
}

/// Allocates rows in f32.
pub(super) fn slab(rows: usize, columns: usize) -> Slab {
    Slab::new(Form::Single, rows, columns)
}

/// Returns rows in the layout of products and weight gradients.
pub(super) fn laid_out(values: &[f32], rows: usize, columns: usize) -> Slab {
    let mut slab = slab(rows, columns);
    let panels = Some(slab.rows_mut(0));
    Rows::Given(values).finish(rows, columns, Finish { panels, ..Finish::default() });
    slab
}

/// Space for the outputs of layers, which alternate.
struct Rooms([Slab; 2]);

impl Rooms {
    fn new(rays: usize, width: usize) -> Rooms {
        Rooms([0; 2].map(|_| slab(rays, width)))
    }

    /// Runs `rays` rows through layers, and returns the last one's output.
    fn run(&mut self, blocks: &[Block], input: Panels, rays: usize, normals: &mut Normals) -> Panels<'_> {
        for (l, block) in blocks.iter().enumerate() {
            let [a, b] = &mut self.0;
            let (below, output) = if l % 2 == 0 { (&*b, a) } else { (&*a, b) };
            let lhs = Lhs::Panels(if l == 0 { input } else { below.rows(0) });
            let bias = Some(Bias { values: &block.bias, of_rays: (0, 0) });
            let layer = &mut normals.layers[l];
            let finish = Finish { bias, panels: Some(layer.rows_mut(0)), ..Finish::default() };
            Rows::Products(&[Source { lhs, weights: &block.weight }]).finish(rays, block.scale.len(), finish);
            norm::forward(block, rays, layer, &mut normals.inverse[l], output);
        }
        self.0[(blocks.len() + 1) % 2].rows(0)
    }
}

impl Network {
    /// Marches a chunk. `keep` stores what [`Network::backward`] needs.
    pub(crate) fn march(&self, lines: Lines, keep: bool) -> Tape {
        let (rays, width, steps) = (lines.len(), self.config.width, self.config.steps);
        let norms = lines.norms();
        let mut tape = Tape {
            colour: vec![0.0; 3 * rays],
            z: lines.z_0.to_vec(),
            queries: Vec::new(),
            pixel: Normals::new(&self.pixel, rays),
            states: Vec::new(),
            outputs: Vec::new(),
        };
        let (mut of_phi, mut of_pixel) = (Rooms::new(rays, width), Rooms::new(rays, width));
        let mut x = self.start(lines);
        for step in 0..=steps {
            let points = laid_out(&x, rays, 3);
            let mut query = Query { points, normals: Normals::new(&self.phi, rays) };
            let feature = of_phi.run(&self.phi, query.points.rows(0), rays, &mut query.normals);
            if step < steps {
                let (state, output) = self.remember(feature, tape.states.last().zip(tape.outputs.last()), rays);
                for (ray, norm) in norms.iter().enumerate() {
                    let length = self.step_length(&state, ray);
                    let axes = 3 * ray..3 * ray + 3;
                    let along = x[axes.clone()].iter_mut().zip(&lines.viewdirs[axes]);
                    along.for_each(|(x, direction)| *x += length * direction);
                    tape.z[ray] += length / norm;
                }
                if !keep {
                    tape.states.clear();
                    tape.outputs.clear();
                }
                tape.states.push(state);
                tape.outputs.push(output);
            } else {
                let hidden = of_pixel.run(&self.pixel, feature, rays, &mut tape.pixel);
                head_forward(&self.rgb, &[hidden], &mut tape.colour);
            }
            if keep {
                tape.queries.push(query);
            }
        }
        tape
    }

    /// Returns the starts of rays, `[rays, 3]`.
    fn start(&self, lines: Lines) -> Vec<f32> {
        let scale = self.config.scale as f32;
        let rays = lines.origins.chunks_exact(3).zip(lines.directions.chunks_exact(3)).zip(lines.z_0);
        rays.flat_map(|((o, d), z)| [0, 1, 2].map(|axis| scale * o[axis] + z * d[axis])).collect()
    }

    /// Returns the cell's state after a feature, and its output. The first step has no state before it.
    fn remember(&self, feature: Panels, before: Option<(&State, &Slab)>, rays: usize) -> (State, Slab) {
        let mut sums = vec![0f32; rays * GATES];
        let mut sources = vec![Source { lhs: Lhs::Panels(feature), weights: &self.cell.input }];
        sources.extend(
            before.map(|(_, output)| Source { lhs: Lhs::Panels(output.rows(0)), weights: &self.cell.recurrent }),
        );
        let bias = Some(Bias { values: &self.cell.bias, of_rays: (0, 0) });
        let out = Some(Out { values: &mut sums, stride: GATES, accumulate: false });
        Rows::Products(&sources).finish(rays, GATES, Finish { bias, out, ..Finish::default() });
        let nothing = vec![0f32; if before.is_none() { rays * HIDDEN } else { 0 }];
        let state = cell::forward(sums, before.map_or(&nothing[..], |(state, _)| &state.memory));
        let outputs: Vec<f32> = (0..rays).flat_map(|ray| state.output(ray)).collect();
        (state, laid_out(&outputs, rays, HIDDEN))
    }

    fn step_length(&self, state: &State, ray: usize) -> f32 {
        let products = state.output(ray).zip(&self.cell.head).map(|(output, weight)| output * weight);
        products.sum::<f32>() + self.cell.head_bias
    }
}
