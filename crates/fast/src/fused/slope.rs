//! The slope of raw density in the encoding, and the weight gradients of functions of both. It is the adjoint recursion
//! of a field's spatial derivatives, over tiles.

use super::backward::scatter;
use super::encode::encode_positions;
use super::kernels::{add_bias_relu, add_rows, few_input_gradient, few_weight_gradient, mask_where_zero, scale_rows};
use super::layout::{Network, TILE, tiles};
use super::pool::Buffer;

/// What the weight gradients need of the points that matter.
pub struct Tape {
    /// Their indices, ascending.
    points: Vec<usize>,
    encoded: Buffer<f32>,
    /// Each trunk layer's output.
    hidden: Vec<Buffer<f32>>,
    /// d raw / d (each trunk layer's output before its ReLU).
    adjoints: Vec<Buffer<f32>>,
}

/// Raw density and its slope at `n` points.
pub struct Slope {
    /// `[n]`.
    pub raw: Vec<f32>,
    /// d raw / d encoding, `[n, channels]`.
    pub slope: Vec<f32>,
    pub tape: Tape,
}

impl Network {
    /// Computes trunk layer `l`'s weights times its input. The lowest layer does not read `below`.
    fn trunk_product(&self, l: usize, encoded: &[f32], below: &[f32], output: &mut [f32]) {
        let (layer, width, position) = (&self.trunk[l].linear, self.width(), self.position_channels());
        if self.encodes(l) {
            layer.forward(encoded, 0, position, output, false);
        }
        if l > 0 {
            layer.forward(below, self.encoded_inputs(l), width, output, self.encodes(l));
        }
    }

    /// Computes both at points `[n, 3]`, or at features `[n, channels]` of a hash grid. Points whose raw density does
    /// not `matter` have slope 0, and are skipped later.
    pub fn slope(&self, points: &[f32], matters: impl Fn(f32) -> bool) -> Slope {
        let n = points.len() / self.code().inputs();
        let (width, depth, position) = (self.width(), self.depth(), self.position_channels());
        let layers = || (0..depth).map(|_| Buffer::new(n * width)).collect();
        let mut tape = Tape {
            points: Vec::with_capacity(n),
            encoded: Buffer::new(n * position),
            hidden: layers(),
            adjoints: layers(),
        };
        let (mut raw, mut slope) = (vec![0f32; n], vec![0f32; n * position]);
        for tile in tiles(n) {
            let first = tape.points.len();
            let encoded = &mut tape.encoded[first * position..][..tile.rows * position];
            encode_positions(self.code(), tile.of(points, self.code().inputs()), encoded);
            let rows = first * width..(first + tile.rows) * width;
            for l in 0..depth {
                let (below, from_here) = tape.hidden.split_at_mut(l);
                let below = below.last().map_or(&[][..], |below| &below[rows.clone()]);
                let output = &mut from_here[0][rows.clone()];
                self.trunk_product(l, encoded, below, output);
                add_bias_relu(output, &self.trunk[l].linear.bias);
            }
            let densities = tile.of_mut(&mut raw, 1);
            self.density.forward(&tape.hidden[depth - 1][rows], densities);
            for (i, _) in densities.iter().enumerate().filter(|(_, density)| matters(**density)) {
                tape.keep(tile.start + i, first + i, (width, position));
            }
            self.pull_down(&mut tape, first, &mut slope);
        }
        Slope { raw, slope, tape }
    }

    /// Fills adjoints and slope of the tape's points from index `first`.
    fn pull_down(&self, tape: &mut Tape, first: usize, slope: &mut [f32]) {
        let count = tape.points.len() - first;
        let (width, depth, position) = (self.width(), self.depth(), self.position_channels());
        let rows = first * width..(first + count) * width;
        let mut d_encoded = Buffer::new(count * position);
        d_encoded.fill(0.0);
        for row in tape.adjoints[depth - 1][rows.clone()].chunks_exact_mut(width) {
            row.copy_from_slice(self.density.weights());
        }
        for l in (0..depth).rev() {
            let layer = &self.trunk[l].linear;
            let (below, from_here) = tape.adjoints.split_at_mut(l);
            let adjoint = &mut from_here[0][rows.clone()];
            mask_where_zero(adjoint, &tape.hidden[l][rows.clone()]);
            if self.encodes(l) {
                layer.input_gradient((adjoint, width), 0, position, &mut d_encoded, true);
            }
            if let Some(below) = below.last_mut() {
                layer.input_gradient((adjoint, width), self.encoded_inputs(l), width, &mut below[rows.clone()], false);
            }
        }
        scatter(&d_encoded, position, &tape.points[first..], slope);
    }

    /// Returns gradients of weight and bias of the trunk's layers and the density head, in the order of parameters. The
    /// loss has the derivative `cotangent [n, channels]` in the slope, and `d_raw [n]` in raw density.
    pub fn slope_gradients(&self, tape: &Tape, cotangent: Option<&[f32]>, d_raw: Option<&[f32]>) -> Vec<Vec<f32>> {
        let (width, position) = (self.width(), self.position_channels());
        let mut sum = vec![0f32; self.gradient_size];
        let (mut room_a, mut room_b) = (Buffer::new(TILE * width), Buffer::new(TILE * width));
        let (mut u_0, mut d) = (Buffer::new(TILE * position), vec![0f32; TILE]);
        for start in (0..tape.points.len()).step_by(TILE) {
            let points = &tape.points[start..tape.points.len().min(start + TILE)];
            let count = points.len();
            let rows = start * width..(start + count) * width;
            let (mut u, mut below) = (&mut room_a[..count * width], &mut room_b[..count * width]);
            let (u_0, d) = (&mut u_0[..count * position], &mut d[..count]);
            d.iter_mut().zip(points).for_each(|(d, &point)| *d = d_raw.map_or(0.0, |all| all[point]));
            scale_rows(&tape.encoded[start * position..][..count * position], d, u_0);
            if let Some(cotangent) = cotangent {
                for (u, &point) in u_0.chunks_exact_mut(position).zip(points) {
                    u.iter_mut().zip(&cotangent[point * position..]).for_each(|(u, cotangent)| *u += cotangent);
                }
            }
            for (l, layer) in self.trunk.iter().map(|layer| &layer.linear).enumerate() {
                let (adjoint, hidden) = (&tape.adjoints[l][rows.clone()], &tape.hidden[l][rows.clone()]);
                if self.encodes(l) {
                    layer.weight_gradient((adjoint, width), u_0, 0, position, &mut sum);
                }
                if l > 0 {
                    layer.weight_gradient((adjoint, width), below, self.encoded_inputs(l), width, &mut sum);
                }
                few_weight_gradient(d, adjoint, 1, layer.bias_of(&mut sum));
                if cotangent.is_some() {
                    self.trunk_product(l, u_0, below, u);
                    few_input_gradient(d, &layer.bias, 1, u, true);
                    mask_where_zero(u, hidden);
                } else {
                    // For raw density alone, the recursion is the forward pass, scaled point by point.
                    scale_rows(hidden, d, u);
                }
                std::mem::swap(&mut u, &mut below);
            }
            add_rows(self.density.linear.weights_of(&mut sum), below);
            add_rows(self.density.linear.bias_of(&mut sum), d);
        }
        self.trunk_gradients(&sum)
    }
}

impl Tape {
    /// Keeps row `from`, of point number `point`, next to the rows kept so far.
    fn keep(&mut self, point: usize, from: usize, (width, position): (usize, usize)) {
        let to = self.points.len();
        self.points.push(point);
        if to == from {
            return;
        }
        let pull_up = |values: &mut [f32], columns: usize| {
            values.copy_within(from * columns..(from + 1) * columns, to * columns);
        };
        self.hidden.iter_mut().for_each(|hidden| pull_up(hidden, width));
        pull_up(&mut self.encoded, position);
    }
}
