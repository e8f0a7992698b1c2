//! Backward on tiles of points, with exactly the gradients that are asked for.

use crate::field::encoding::gradient_into;
use crate::runtime::count_points;

use super::forward::{Inputs, Kept, Wanted};
use super::kernels::{add, apply_mask};
use super::layout::{Network, TILE};
use super::pool::Buffer;

/// Gradients of a backward pass; what was not wanted is empty.
pub struct InputGradients {
    pub points: Vec<f32>,
    pub viewdirs: Vec<f32>,
    pub delta: Vec<f32>,
}

/// One way back through a network.
struct Backward<'a> {
    network: &'a Network,
    kept: &'a Kept,
    wanted: Wanted,
    rays: usize,
    /// Points of a ray.
    samples: usize,
    /// Trunk layer (1-based) of the delta; 0 without one.
    delta_layer: usize,
    /// The lowest trunk layer (from 0) whose input, or weights, want a gradient.
    lowest: usize,
}

/// Room for the gradients of a tile's rows.
struct Rooms {
    scratch: Scratch,
    /// Of a trunk layer's output, and of its input.
    trunk: [Buffer<f32>; 2],
    view: Buffer<f32>,
    encoded: Buffer<f32>,
}

/// What the rows' gradients are added to.
struct Sums<'a> {
    out: InputGradients,
    /// Of what a ray's direction adds to its points, `[rays, width / 2]`; empty where nothing wants it.
    of_rays: Vec<f32>,
    /// Of the weights, flat in the order of parameters.
    weights: &'a mut [f32],
}

impl Network {
    /// Pulls `gradient`, laid out as the raw output, back to what was wanted. Gradients of weights are added to
    /// `weights`, flat in the order of parameters. Points whose gradient is 0, as all of empty space has it behind a
    /// ReLU density, take no part: they would add 0.
    pub fn backward(
        &self,
        inputs: Inputs,
        kept: &Kept,
        gradient: &[f32],
        wanted: Wanted,
        weights: &mut [f32],
    ) -> InputGradients {
        let n = inputs.points.len() / self.code().inputs();
        let rays = inputs.viewdirs.len() / 3;
        let delta_layer = inputs.delta.map_or(0, |(layer, _)| layer);
        let lowest = match wanted {
            Wanted { weights: false, points: false, delta: true, .. } => delta_layer,
            Wanted { weights: false, points: false, delta: false, .. } => self.depth(),
            _ => 0,
        };
        let samples = n.checked_div(rays).unwrap_or(0);
        let backward = Backward { network: self, kept, wanted, rays, samples, delta_layer, lowest };
        backward.run(n, gradient, weights)
    }
}

impl Backward<'_> {
    fn run(&self, n: usize, gradient: &[f32], weights: &mut [f32]) -> InputGradients {
        let (network, wanted, rays) = (self.network, self.wanted, self.rays);
        let (width, position) = (network.width(), network.position_channels());
        let out = InputGradients {
            points: vec![0f32; if wanted.points { network.code().inputs() * n } else { 0 }],
            viewdirs: vec![0f32; if wanted.viewdirs { 3 * rays } else { 0 }],
            delta: vec![0f32; if wanted.delta { n * width } else { 0 }],
        };
        let of_rays = vec![0f32; if self.by_rays() { rays * (width / 2) } else { 0 }];
        let mut sums = Sums { out, of_rays, weights };
        let (g_colour, g_density) = gradient.split_at(if rays > 0 { 3 * n } else { 0 });
        let active: Vec<usize> = (0..n)
            .filter(|&i| g_density[i] != 0.0 || rays > 0 && g_colour[3 * i..][..3].iter().any(|&g| g != 0.0))
            .collect();
        count_points(n, active.len());
        let mut rooms = Rooms {
            scratch: Scratch::default(),
            trunk: [Buffer::new(TILE * width), Buffer::new(TILE * width)],
            view: Buffer::new(TILE * width / 2),
            encoded: Buffer::new(TILE * position),
        };
        for rows in active.chunks(TILE) {
            self.heads(rows, (g_colour, g_density), &mut rooms, &mut sums);
            if self.reaches_trunk() {
                self.trunk(rows, &mut rooms, &mut sums);
                if wanted.points {
                    self.points(rows, &mut rooms, &mut sums.out);
                }
            }
        }
        self.directions(&mut sums);
        sums.out
    }

    /// Something wants the gradient of what each ray's direction adds.
    fn by_rays(&self) -> bool {
        self.rays > 0 && (self.wanted.weights || self.wanted.viewdirs)
    }

    /// Something wants a gradient below the heads.
    fn reaches_trunk(&self) -> bool {
        let depth = self.network.depth();
        self.lowest < depth || self.delta_layer == depth && self.wanted.delta
    }

    /// Through colour, view layer and density to the trunk's output, whose gradient is left in the first room.
    fn heads(&self, rows: &[usize], (g_colour, g_density): (&[f32], &[f32]), rooms: &mut Rooms, sums: &mut Sums) {
        let (network, kept, wanted) = (self.network, self.kept, self.wanted);
        let (width, depth, into_trunk) = (network.width(), network.depth(), self.reaches_trunk());
        let Rooms { scratch, trunk, view, .. } = rooms;
        let d_output = &mut trunk[0][..rows.len() * width];
        let dv = &mut view[..rows.len() * (width / 2)];
        let density = scratch.density.rows(g_density, 1, rows);
        if self.rays > 0 {
            let colour = scratch.colour.rows(g_colour, 3, rows);
            network.rgb.input_gradient(colour, dv, false);
            apply_mask(dv, scratch.mask.rows(&kept.view_mask, width / 2, rows));
            if wanted.weights {
                let view = scratch.input.rows(&kept.view, width / 2, rows);
                network.rgb.gradients(colour, view, sums.weights);
                let hidden = scratch.input.rows(&kept.hidden[depth - 1], width, rows);
                network.view.weight_gradient(dv, hidden, 0, width, sums.weights);
            }
            if self.by_rays() {
                for (dv, &row) in dv.chunks_exact(width / 2).zip(rows) {
                    add(&mut sums.of_rays[row / self.samples * (width / 2)..][..width / 2], dv);
                }
            }
            if into_trunk {
                network.view.input_gradient(dv, 0, width, d_output, false);
            }
        }
        if wanted.weights {
            let hidden = scratch.input.rows(&kept.hidden[depth - 1], width, rows);
            network.density.gradients(density, hidden, sums.weights);
        }
        if into_trunk {
            network.density.input_gradient(density, d_output, self.rays > 0);
        }
    }

    /// Down the trunk; the gradient of the encoding is left in its room.
    fn trunk(&self, rows: &[usize], rooms: &mut Rooms, sums: &mut Sums) {
        let (network, kept, wanted) = (self.network, self.kept, self.wanted);
        let (width, position) = (network.width(), network.position_channels());
        let Rooms { scratch, trunk: [a, b], encoded, .. } = rooms;
        let (mut d_output, mut d_input) = (&mut a[..rows.len() * width], &mut b[..rows.len() * width]);
        let de = &mut encoded[..rows.len() * position];
        de.fill(0.0);
        for (l, layer) in network.trunk.iter().enumerate().rev() {
            if l + 1 == self.delta_layer && wanted.delta {
                scatter(d_output, width, rows, &mut sums.out.delta);
            }
            if l < self.lowest {
                break;
            }
            apply_mask(d_output, scratch.mask.rows(&kept.masks[l], width, rows));
            let (encodes, from) = (network.encodes(l), network.encoded_inputs(l));
            if wanted.weights {
                if encodes {
                    let encoded = scratch.input.rows(&kept.encoded, position, rows);
                    layer.weight_gradient(d_output, encoded, 0, position, sums.weights);
                }
                if l > 0 {
                    let hidden = scratch.input.rows(&kept.hidden[l - 1], width, rows);
                    layer.weight_gradient(d_output, hidden, from, width, sums.weights);
                }
                layer.bias_gradient(d_output, sums.weights);
            }
            if encodes && wanted.points {
                layer.input_gradient(d_output, 0, position, de, true);
            }
            if l > 0 {
                layer.input_gradient(d_output, from, width, d_input, false);
                std::mem::swap(&mut d_output, &mut d_input);
            }
        }
    }

    /// From the encoding to the points.
    fn points(&self, rows: &[usize], rooms: &mut Rooms, out: &mut InputGradients) {
        let (code, position) = (self.network.code(), self.network.position_channels());
        let encoded = rooms.scratch.input.rows(&self.kept.encoded, position, rows);
        let mut d_points = vec![0f32; code.inputs() * rows.len()];
        code.gradient_into(encoded, &rooms.encoded[..rows.len() * position], &mut d_points);
        scatter(&d_points, code.inputs(), rows, &mut out.points);
    }

    /// From what each ray's direction adds to the view layer's weights and to the directions.
    fn directions(&self, sums: &mut Sums) {
        let (network, kept, wanted) = (self.network, self.kept, self.wanted);
        let (width, direction) = (network.width(), network.view_channels());
        if wanted.weights && self.rays > 0 {
            network.view.weight_gradient(&sums.of_rays, &kept.encoded_views, width, direction, sums.weights);
            network.view.bias_gradient(&sums.of_rays, sums.weights);
        }
        if wanted.viewdirs {
            let mut d_views = vec![0f32; self.rays * direction];
            network.view.input_gradient(&sums.of_rays, width, direction, &mut d_views, false);
            gradient_into(&kept.encoded_views, &d_views, network.config.view_octaves, &mut sums.out.viewdirs);
        }
    }
}

/// Room for rows that are brought together.
#[derive(Default)]
struct Scratch {
    colour: Room<f32>,
    density: Room<f32>,
    input: Room<f32>,
    mask: Room<u8>,
}

#[derive(Default)]
struct Room<T>(Vec<T>);

impl<T: Copy> Room<T> {
    /// The rows of `values`, brought together unless they are neighbours.
    fn rows<'a>(&'a mut self, values: &'a [T], columns: usize, rows: &[usize]) -> &'a [T] {
        let (first, last) = (rows[0], rows[rows.len() - 1]);
        if last - first + 1 == rows.len() {
            return &values[first * columns..][..rows.len() * columns];
        }
        self.0.clear();
        rows.iter().for_each(|row| self.0.extend_from_slice(&values[row * columns..][..columns]));
        &self.0
    }
}

/// Writes rows to where they came from.
pub(super) fn scatter(values: &[f32], columns: usize, rows: &[usize], out: &mut [f32]) {
    for (value, &row) in values.chunks_exact(columns).zip(rows) {
        out[row * columns..][..columns].copy_from_slice(value);
    }
}
