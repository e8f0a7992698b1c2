//! The backward pass of a chunk of rays.

use crate::srn::network::{GRADIENT_LIMIT, HIDDEN};
use augnerf_fast::fused::kernels::panels::{Panels, Slab};
use augnerf_fast::fused::kernels::product::{Finish, Lhs, Out, Rows, Source};
use augnerf_fast::fused::kernels::{add_rows, bias_gradient, head_forward, head_gradient, weight_gradient};

use super::forward::{Lines, Normals, Query, Tape, slab};
use super::norm;
use super::weights::{Block, GATES, Network};

/// Space for a layer's gradients, and for outputs that are recomputed.
struct Rooms {
    rays: usize,
    gradient: Slab,
    next: Slab,
    /// The output of an intermediate layer.
    output: Slab,
    /// The output of the last layer.
    feature: Slab,
    /// Gradients of the gates' sums: a panel.
    gates: Slab,
}

/// Gradients that one step passes to the one before it.
struct StepGradients {
    /// Of positions, `[rays, 3]`.
    x: Vec<f32>,
    /// Of the cell's output and of its memory, `[rays, HIDDEN]`.
    output: Vec<f32>,
    memory: Vec<f32>,
}

impl Rooms {
    fn new(rays: usize, width: usize) -> Rooms {
        let [gradient, next, output, feature] = [0; 4].map(|_| slab(rays, width));
        Rooms { rays, gradient, next, output, feature, gates: slab(rays, GATES) }
    }

    /// Propagates the gradient of the last layer's output in `gradient` down through the layers, and adds those of
    /// their parameters to `sum`. It leaves the gradient of the first layer's product there.
    fn down(&mut self, blocks: &[Block], normals: &Normals, input: Panels, sum: &mut [f32]) {
        for (l, block) in blocks.iter().enumerate().rev() {
            let [weight, bias, scale, shift] = block.gradients(sum);
            let normal = (&normals.layers[l], &normals.inverse[l][..]);
            norm::backward(block, self.rays, normal, &mut self.gradient, (scale, shift));
            if l > 0 {
                norm::again(&blocks[l - 1], self.rays, &normals.layers[l - 1], &mut self.output);
            }
            let x = if l > 0 { self.output.rows(0) } else { input };
            weight_gradient(self.gradient.rows(0), x, self.rays, weight, block.inputs);
            bias_gradient(self.gradient.rows(0), self.rays, bias);
            if l > 0 {
                self.below(block);
            }
        }
    }

    /// Propagates the gradient of a layer's product to its input.
    fn below(&mut self, block: &Block) {
        let weights = block.back.as_ref().expect("layers that read no points have a way back");
        let sources = [Source { lhs: Lhs::Panels(self.gradient.rows(0)), weights }];
        let finish = Finish { panels: Some(self.next.rows_mut(0)), ..Finish::default() };
        Rows::Products(&sources).finish(self.rays, block.inputs, finish);
        std::mem::swap(&mut self.gradient, &mut self.next);
    }
}

impl Network {
    /// Propagates gradients of colours `[rays, 3]` and of depths `[rays]` back through a chunk's march. It adds those
    /// of the parameters to `sum`, flat in their order.
    pub(crate) fn backward(&self, lines: Lines, tape: &Tape, (d_colour, d_z): (&[f32], &[f32]), sum: &mut [f32]) {
        let rays = d_z.len();
        let mut rooms = Rooms::new(rays, self.config.width);
        let mut gradients = StepGradients {
            x: vec![0.0; 3 * rays],
            output: vec![0.0; rays * HIDDEN],
            memory: vec![0.0; rays * HIDDEN],
        };
        let end = &tape.queries[self.config.steps];
        self.colour(tape, end, d_colour, &mut rooms, sum);
        self.phi(end, true, &mut rooms, &mut gradients, sum);
        let norms = lines.norms();
        for step in (0..self.config.steps).rev() {
            let lengths: Vec<f32> = (0..rays)
                .map(|ray| {
                    let along =
                        (3 * ray..3 * ray + 3).map(|axis| gradients.x[axis] * lines.viewdirs[axis]).sum::<f32>();
                    along + d_z[ray] / norms[ray]
                })
                .collect();
            self.cell(tape, step, &lengths, &mut rooms, &mut gradients, sum);
            self.phi(&tape.queries[step], step > 0, &mut rooms, &mut gradients, sum);
        }
    }

    /// Propagates through G to the feature at the end, whose gradient is left in the first space.
    fn colour(&self, tape: &Tape, end: &Query, d_colour: &[f32], rooms: &mut Rooms, sum: &mut [f32]) {
        let (rays, width) = (rooms.rays, self.config.width);
        let [weight, bias] = self.of_rgb.clone();
        let last = self.pixel.len() - 1;
        norm::again(&self.pixel[last], rays, &tape.pixel.layers[last], &mut rooms.output);
        head_gradient(d_colour, self.rgb.outputs, rooms.output.rows(0), &mut sum[weight]);
        add_rows(&mut sum[bias], d_colour);
        let from = Rows::Few { dz: d_colour, weights: &self.rgb.weights, outputs: self.rgb.outputs };
        from.finish(rays, width, Finish { panels: Some(rooms.gradient.rows_mut(0)), ..Finish::default() });
        self.feature(end, rooms);
        let feature = std::mem::take(&mut rooms.feature);
        rooms.down(&self.pixel, &tape.pixel, feature.rows(0), sum);
        rooms.below(&self.pixel[0]);
        rooms.feature = feature;
    }

    /// Recomputes the feature of a query.
    fn feature(&self, query: &Query, rooms: &mut Rooms) {
        let last = self.phi.len() - 1;
        norm::again(&self.phi[last], rooms.rays, &query.normals.layers[last], &mut rooms.feature);
    }

    /// Propagates through Phi, from the feature's gradient in the first space. It adds that of the points if it is
    /// needed.
    fn phi(&self, query: &Query, of_points: bool, rooms: &mut Rooms, gradients: &mut StepGradients, sum: &mut [f32]) {
        rooms.down(&self.phi, &query.normals, query.points.rows(0), sum);
        if of_points {
            let mut d_points = vec![0f32; gradients.x.len()];
            head_forward(&self.to_points, &[rooms.gradient.rows(0)], &mut d_points);
            gradients.x.iter_mut().zip(&d_points).for_each(|(sum, value)| *sum += value);
        }
    }

    /// Propagates through a step's head and cell, from gradients of the steps' lengths. That of the feature is left in
    /// the first space.
    fn cell(
        &self,
        tape: &Tape,
        step: usize,
        lengths: &[f32],
        rooms: &mut Rooms,
        gradients: &mut StepGradients,
        sum: &mut [f32],
    ) {
        let (rays, state, cell) = (rooms.rays, &tape.states[step], &self.cell);
        let [of_input, of_recurrent, of_bias_ih, of_bias_hh, of_head, of_head_bias] = cell.at.clone();
        for (ray, length) in lengths.iter().enumerate() {
            let d_output = &mut gradients.output[ray * HIDDEN..][..HIDDEN];
            let all = d_output.iter_mut().zip(&cell.head).zip(sum[of_head.clone()].iter_mut().zip(state.output(ray)));
            for ((d, weight), (d_weight, output)) in all {
                *d = (*d + length * weight).clamp(-GRADIENT_LIMIT as f32, GRADIENT_LIMIT as f32);
                *d_weight += length * output;
            }
            sum[of_head_bias.start] += length;
        }
        let nothing = vec![0f32; if step == 0 { rays * HIDDEN } else { 0 }];
        let before = if step > 0 { &tape.states[step - 1].memory } else { &nothing };
        let d_sums = &mut rooms.gates.rows_mut(0).words[..rays * GATES];
        state.backward(before, &gradients.output, &mut gradients.memory, d_sums);
        self.feature(&tape.queries[step], rooms);
        let gates = rooms.gates.rows(0);
        weight_gradient(gates, rooms.feature.rows(0), rays, &mut sum[of_input], self.config.width);
        bias_gradient(gates, rays, &mut sum[of_bias_ih]);
        bias_gradient(gates, rays, &mut sum[of_bias_hh]);
        let source = |weights| [Source { lhs: Lhs::Panels(gates), weights }];
        if step > 0 {
            weight_gradient(gates, tape.outputs[step - 1].rows(0), rays, &mut sum[of_recurrent], HIDDEN);
            let out = Some(Out { values: &mut gradients.output, stride: HIDDEN, accumulate: false });
            let sources = source(&cell.recurrent_back);
            Rows::Products(&sources).finish(rays, HIDDEN, Finish { out, ..Finish::default() });
        }
        let finish = Finish { panels: Some(rooms.gradient.rows_mut(0)), ..Finish::default() };
        Rows::Products(&source(&cell.input_back)).finish(rays, self.config.width, finish);
    }
}
