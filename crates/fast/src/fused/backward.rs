//! The backward pass on tiles of points, with only the requested gradients.

use crate::encoding::gradient_into;

use super::forward::{Inputs, Kept, Outputs, targets};
use super::kernels::panels::{Gathered, Panels, Slab};
use super::kernels::product::{ByRay, Finish, Lhs, Out, Rows, Source};
use super::kernels::{add_rows, bias_gradient, head_gradient, weight_gradient};
use super::layout::{Layer, Network, TILE};
use super::pool::Buffer;

/// Gradients of a backward pass. Those that were not requested are empty.
pub struct InputGradients {
    pub points: Vec<f32>,
    pub viewdirs: Vec<f32>,
    pub delta: Vec<f32>,
}

/// One backward pass through a network.
struct Backward<'a> {
    network: &'a Network,
    kept: &'a Kept,
    wanted: Outputs,
    rays: usize,
    /// Points per ray.
    samples: usize,
    /// Trunk layer (1-based) of the delta; 0 without one.
    delta_layer: usize,
    /// The lowest trunk layer (from 0) whose input or weights need a gradient.
    lowest: usize,
}

/// Space for a layer's gradients at a tile's rows: in the layout of products and, if it differs, in that of weight
/// gradients.
struct LayerGradients {
    lhs: Slab,
    rhs: Slab,
}

impl LayerGradients {
    fn new(network: &Network, weights: bool, columns: usize) -> LayerGradients {
        let rhs = if weights && network.pairs() { network.rhs(TILE, columns) } else { Slab::default() };
        LayerGradients { lhs: network.lhs(TILE, columns), rhs }
    }

    fn for_weights(&self) -> Panels<'_> {
        if self.rhs.is_empty() { self.lhs.rows(0) } else { self.rhs.rows(0) }
    }

    /// Stores rows here.
    fn take(&mut self, from: Rows, rows: usize, columns: usize, finish: Finish) {
        let (across, panels) = targets(&mut self.lhs, &mut self.rhs, 0);
        from.finish(rows, columns, Finish { across, panels, ..finish });
    }
}

/// Space for the gradients of a tile's rows.
struct Rooms {
    scratch: Scratch,
    /// Of a layer's output, and of its input.
    trunk: [LayerGradients; 2],
    views: [LayerGradients; 2],
    encoded: Buffer<f32>,
    /// The encoding in the layout of weight gradients.
    encoding: Slab,
    delta: Buffer<f32>,
}

/// The sums of the rows' gradients.
struct Sums<'a> {
    out: InputGradients,
    /// Of what a ray's direction adds to its points, `[rays, view neurons]`. Empty if it is not needed.
    of_rays: Vec<f32>,
    /// Of the weights, flat in the order of parameters.
    weights: &'a mut [f32],
}

impl Network {
    /// Propagates `gradient`, in the layout of the raw output, back to what was requested. Weight gradients are added
    /// to `weights`, flat in the order of parameters. Points whose gradient is 0 are skipped, because they would add 0.
    /// Behind a ReLU density these include all empty space.
    pub fn backward(
        &self,
        inputs: Inputs,
        kept: &Kept,
        gradient: &[f32],
        wanted: Outputs,
        weights: &mut [f32],
    ) -> InputGradients {
        let n = inputs.points.len() / self.code().inputs();
        let rays = inputs.viewdirs.len() / 3;
        let delta_layer = inputs.delta.map_or(0, |(layer, _)| layer);
        let lowest = match wanted {
            Outputs { weights: false, points: false, delta: true, .. } => delta_layer,
            Outputs { weights: false, points: false, delta: false, .. } => self.depth(),
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
        let of_rays = vec![0f32; if self.by_rays() { rays * network.views[0].bias.len() } else { 0 }];
        let mut sums = Sums { out, of_rays, weights };
        let (g_colour, g_density) = gradient.split_at(if rays > 0 { 3 * n } else { 0 });
        let active: Vec<usize> = (0..n)
            .filter(|&i| g_density[i] != 0.0 || rays > 0 && g_colour[3 * i..][..3].iter().any(|&g| g != 0.0))
            .collect();
        let room = |columns: usize| [0; 2].map(|_| LayerGradients::new(network, wanted.weights, columns));
        let mut rooms = Rooms {
            scratch: Scratch::default(),
            trunk: room(width),
            views: room(network.views[0].linear.outputs()),
            encoded: Buffer::new(TILE * position),
            encoding: if wanted.weights { network.rhs(TILE, position) } else { Slab::default() },
            delta: Buffer::new(if wanted.delta { TILE * width } else { 0 }),
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

    /// Returns whether the gradient of what each ray's direction adds is needed.
    fn by_rays(&self) -> bool {
        self.rays > 0 && (self.wanted.weights || self.wanted.viewdirs)
    }

    /// Returns whether a gradient below the heads is needed.
    fn reaches_trunk(&self) -> bool {
        let depth = self.network.depth();
        self.lowest < depth || self.delta_layer == depth && self.wanted.delta
    }

    /// Runs through colour, the layers above the trunk, and density to the trunk's output. Its gradient is left in the
    /// first space.
    fn heads(&self, rows: &[usize], (g_colour, g_density): (&[f32], &[f32]), rooms: &mut Rooms, sums: &mut Sums) {
        let (network, kept) = (self.network, self.kept);
        let Rooms { scratch, trunk: [output, _], views, delta, .. } = rooms;
        let density = scratch.density.rows(g_density, 1, rows);
        if self.wanted.weights {
            let hidden = scratch.hidden.rows(&kept.hidden[network.depth() - 1], rows);
            head_gradient(density, 1, hidden, network.density.linear.weights_of(sums.weights));
            add_rows(network.density.linear.bias_of(sums.weights), density);
        }
        let mut sources = Vec::new();
        if self.rays > 0 {
            let colour = scratch.colour.rows(g_colour, 3, rows);
            let gradients =
                self.views(rows, colour, (&mut scratch.hidden, &mut scratch.view, &mut scratch.mask), views, sums);
            sources.extend(back(gradients, &network.views[0]));
        }
        if self.reaches_trunk() {
            let density = Some((density, &network.density.head.weights[..]));
            let rooms = (output, &mut delta[..], &mut scratch.mask);
            self.arrive(network.depth() - 1, &sources, density, rows, rooms, sums);
        }
    }

    /// Runs through colour and the layers above the trunk, down to the first of them.
    fn views<'a>(
        &self,
        rows: &[usize],
        colour: &[f32],
        (hidden, view, mask): (&mut Gathered, &mut Gathered, &mut Gathered),
        rooms: &'a mut [LayerGradients; 2],
        sums: &mut Sums,
    ) -> &'a LayerGradients {
        let (network, kept, wanted) = (self.network, self.kept, self.wanted);
        let (rgb, top) = (&network.rgb, network.views.len() - 1);
        if wanted.weights {
            let inputs = view.rows(&kept.views[top], rows);
            head_gradient(colour, rgb.linear.outputs(), inputs, rgb.linear.weights_of(sums.weights));
            add_rows(rgb.linear.bias_of(sums.weights), colour);
        }
        let rays: Vec<usize> = rows.iter().map(|row| row / self.samples).collect();
        let [mut above, mut here] = rooms.each_mut();
        for (i, layer) in network.views.iter().enumerate().rev() {
            let by_ray = (i == 0 && self.by_rays()).then(|| ByRay { sums: &mut sums.of_rays, rays: &rays });
            let finish = Finish { mask: Some(mask.masks(&kept.view_masks[i], rows)), by_ray, ..Finish::default() };
            let sources: Vec<Source> =
                network.views.get(i + 1).and_then(|layer| back(above, layer)).into_iter().collect();
            let from = match i == top {
                true => Rows::Few { dz: colour, weights: &rgb.head.weights, outputs: rgb.linear.outputs() },
                false => Rows::Products(&sources),
            };
            here.take(from, rows.len(), layer.linear.outputs(), finish);
            if wanted.weights {
                let inputs = match i {
                    0 => hidden.rows(&kept.hidden[network.depth() - 1], rows),
                    _ => view.rows(&kept.views[i - 1], rows),
                };
                let sum = &mut sums.weights[layer.linear.weight_offset..];
                weight_gradient(here.for_weights(), inputs, rows.len(), sum, layer.linear.inputs);
                // The first layer's bias comes by rays.
                if i > 0 {
                    bias_gradient(here.for_weights(), rows.len(), layer.linear.bias_of(sums.weights));
                }
            }
            std::mem::swap(&mut above, &mut here);
        }
        above
    }

    /// Handles the gradients of trunk layer `l`'s output: for a delta there, and, masked, for the layers below.
    fn arrive(
        &self,
        l: usize,
        sources: &[Source],
        density: Option<(&[f32], &[f32])>,
        rows: &[usize],
        (room, delta, mask): (&mut LayerGradients, &mut [f32], &mut Gathered),
        sums: &mut Sums,
    ) {
        let (width, count) = (self.network.width(), rows.len());
        let (of_delta, on) = (l + 1 == self.delta_layer && self.wanted.delta, l >= self.lowest);
        let out = of_delta.then(|| Out { values: &mut delta[..count * width], stride: width, accumulate: false });
        let mask = on.then(|| mask.masks(&self.kept.masks[l], rows));
        let finish = Finish { density, out, mask, ..Finish::default() };
        match on {
            true => room.take(Rows::Products(sources), count, width, finish),
            false => Rows::Products(sources).finish(count, width, finish),
        }
        if of_delta {
            scatter(&delta[..count * width], width, rows, &mut sums.out.delta);
        }
    }

    /// Runs down the trunk. The gradient of the encoding is left in its space.
    fn trunk(&self, rows: &[usize], rooms: &mut Rooms, sums: &mut Sums) {
        let (network, kept, wanted) = (self.network, self.kept, self.wanted);
        let (position, count) = (network.position_channels(), rows.len());
        let Rooms { scratch, trunk, encoded, encoding, delta, .. } = rooms;
        let [mut output, mut input] = trunk.each_mut();
        let de = &mut encoded[..count * position];
        de.fill(0.0);
        if wanted.weights {
            let panels = Some(encoding.rows_mut(0));
            Rows::Chosen(&kept.encoded, rows).finish(count, position, Finish { panels, ..Finish::default() });
        }
        for l in (self.lowest..network.depth()).rev() {
            let layer = &network.trunk[l];
            if wanted.weights {
                let (dz, from) = (output.for_weights(), network.encoded_inputs(l));
                let sum = &mut sums.weights[layer.linear.weight_offset..];
                if network.encodes(l) {
                    weight_gradient(dz, encoding.rows(0), count, sum, layer.linear.inputs);
                }
                if l > 0 {
                    let hidden = scratch.hidden.rows(&kept.hidden[l - 1], rows);
                    weight_gradient(dz, hidden, count, &mut sum[from..], layer.linear.inputs);
                }
                bias_gradient(dz, count, layer.linear.bias_of(sums.weights));
            }
            if let Some(weights) = layer.to_encoded.as_ref().filter(|_| wanted.points) {
                let sources = [Source { lhs: Lhs::Panels(output.lhs.rows(0)), weights }];
                let out = Some(Out { values: &mut *de, stride: position, accumulate: true });
                Rows::Products(&sources).finish(count, position, Finish { out, ..Finish::default() });
            }
            if let Some(source) = back(output, layer) {
                self.arrive(l - 1, &[source], None, rows, (input, &mut *delta, &mut scratch.mask), sums);
                std::mem::swap(&mut output, &mut input);
            }
        }
    }

    /// Runs from the encoding to the points.
    fn points(&self, rows: &[usize], rooms: &mut Rooms, out: &mut InputGradients) {
        let (code, position) = (self.network.code(), self.network.position_channels());
        let encoded = rooms.scratch.encoded.rows(&self.kept.encoded, position, rows);
        let mut d_points = vec![0f32; code.inputs() * rows.len()];
        code.gradient_into(encoded, &rooms.encoded[..rows.len() * position], &mut d_points);
        scatter(&d_points, code.inputs(), rows, &mut out.points);
    }

    /// Runs from what each ray's direction adds to the view layer's weights and to the directions.
    fn directions(&self, sums: &mut Sums) {
        let (network, kept, wanted) = (self.network, self.kept, self.wanted);
        let (width, direction) = (network.width(), network.view_channels());
        let (view, stride) = (&network.views[0].linear, network.views[0].bias.len());
        if wanted.weights && self.rays > 0 {
            view.weight_gradient((&sums.of_rays, stride), &kept.encoded_views, width, direction, sums.weights);
            let bias = view.bias_of(sums.weights);
            sums.of_rays.chunks_exact(stride).for_each(|of_ray| add_rows(bias, &of_ray[..bias.len()]));
        }
        if wanted.viewdirs {
            let mut d_views = vec![0f32; self.rays * direction];
            view.input_gradient((&sums.of_rays, stride), width, direction, &mut d_views, false);
            gradient_into(&kept.encoded_views, &d_views, network.architecture.view_octaves, &mut sums.out.viewdirs);
        }
    }
}

/// Returns a layer's gradients as the left side of a product with its weights, for the layer below.
fn back<'a>(gradients: &'a LayerGradients, layer: &'a Layer) -> Option<Source<'a>> {
    layer.to_below.as_ref().map(|weights| Source { lhs: Lhs::Panels(gradients.lhs.rows(0)), weights })
}

/// Space for gathered rows.
#[derive(Default)]
struct Scratch {
    colour: Room,
    density: Room,
    encoded: Room,
    hidden: Gathered,
    view: Gathered,
    mask: Gathered,
}

#[derive(Default)]
struct Room(Vec<f32>);

impl Room {
    /// Returns the given rows of `values`, gathered unless they are consecutive.
    fn rows<'a>(&'a mut self, values: &'a [f32], columns: usize, rows: &[usize]) -> &'a [f32] {
        let (first, last) = (rows[0], rows[rows.len() - 1]);
        if last - first + 1 == rows.len() {
            return &values[first * columns..][..rows.len() * columns];
        }
        self.0.clear();
        rows.iter().for_each(|row| self.0.extend_from_slice(&values[row * columns..][..columns]));
        &self.0
    }
}

/// Writes gathered rows back to their rows of `out`.
pub(super) fn scatter(values: &[f32], columns: usize, rows: &[usize], out: &mut [f32]) {
    for (value, &row) in values.chunks_exact(columns).zip(rows) {
        out[row * columns..][..columns].copy_from_slice(value);
    }
}
