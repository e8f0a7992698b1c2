//! The network on tiles of points: forward with what the backward pass needs kept, and backward
//! with exactly the gradients that are asked for.
//!
//! Nothing lies between the feature layer and the view layer, so that both are one: with V the
//! columns of the view layer's weights that read the feature W h + b, V (W h + b) = (V W) h + V b. A
//! ninth of all multiply-adds is spared. Gradients of V W are sorted out once a step
//! ([`Network::parameter_gradients`]).

use crate::field::encoding::{Code, encoded_channels, gradient_into};
use crate::field::layer_shapes;
use crate::runtime::count_points;
use crate::settings::FieldConfig;

use super::encode::{encode_positions, encode_tile};
use super::kernels::{
    Matrix, add, add_bias, add_bias_relu, add_of_rays_relu, add_rows, apply_mask, few_forward, few_input_gradient,
    few_weight_gradient, multiply,
};
use super::pool::Buffer;

/// Points worked through at once: their layers stay in a core's second-level cache.
pub(super) const TILE: usize = 512;

/// One layer's weights `[outputs, inputs]`, the same transposed, biases, and where weights and biases start in the
/// flat gradient.
pub(super) struct Linear {
    weight: Vec<f32>,
    transposed: Vec<f32>,
    pub(super) bias: Vec<f32>,
    inputs: usize,
    weight_offset: usize,
    bias_offset: usize,
}

/// A layer of few outputs.
pub(super) struct Head(Linear);

/// A field's weights, laid out for tiles: a copy, made once a step.
pub struct Network {
    pub(super) config: FieldConfig,
    pub(super) trunk: Vec<Linear>,
    pub(super) density: Head,
    /// Feature and view layer in one, `[width / 2, width + view channels]`.
    view: Linear,
    rgb: Head,
    /// What `view` was made of.
    parts: Parts,
    /// Numbers of the flat gradient.
    pub gradient_size: usize,
}

/// Weights of the feature layer `[width, width]` with its biases, and those of the view layer.
struct Parts {
    feature: Vec<f32>,
    feature_bias: Vec<f32>,
    view: Vec<f32>,
}

/// What a forward pass is asked.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// `[n, 3]`, or Gaussians `[n, 6]`.
    pub points: &'a [f32],
    /// `[rays, 3]`, unit; every ray has the same number of points. Empty: density alone is asked.
    pub viewdirs: &'a [f32],
    /// Trunk layer (1-based) and what is added to its output, `[n, width]`.
    pub delta: Option<(usize, &'a [f32])>,
    /// The trunk up to the delta's layer, from an earlier pass with the same points.
    pub prefix: Option<&'a Prefix>,
}

/// The trunk's lower part at some points: the same for every delta above it.
pub struct Prefix {
    encoded: Buffer<f32>,
    /// Output of the layer that the delta is added to, or of the last one; without the delta.
    hidden: Buffer<f32>,
}

/// What a backward pass will be asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    pub weights: bool,
    pub points: bool,
    pub viewdirs: bool,
    pub delta: bool,
}

impl Wanted {
    fn any(self) -> bool {
        self != Wanted::default()
    }
}

/// What is kept of a forward pass; what the wanted gradients do not need is empty.
#[derive(Default)]
pub struct Kept {
    encoded: Buffer<f32>,
    encoded_views: Buffer<f32>,
    /// Each trunk layer's output, delta included.
    hidden: Vec<Buffer<f32>>,
    /// Where each trunk layer's output was positive.
    masks: Vec<Buffer<u8>>,
    view: Buffer<f32>,
    view_mask: Buffer<u8>,
}

/// Gradients of a backward pass; what was not wanted is empty.
pub struct InputGradients {
    pub points: Vec<f32>,
    pub viewdirs: Vec<f32>,
    pub delta: Vec<f32>,
}

/// Rows of a tile.
#[derive(Clone, Copy)]
pub(super) struct Tile {
    pub(super) start: usize,
    pub(super) rows: usize,
}

impl Tile {
    pub(super) fn of<'a, T>(&self, values: &'a [T], columns: usize) -> &'a [T] {
        &values[self.start * columns..][..self.rows * columns]
    }

    pub(super) fn of_mut<'a, T>(&self, values: &'a mut [T], columns: usize) -> &'a mut [T] {
        &mut values[self.start * columns..][..self.rows * columns]
    }
}

pub(super) fn tiles(n: usize) -> impl Iterator<Item = Tile> {
    (0..n).step_by(TILE).map(move |start| Tile { start, rows: TILE.min(n - start) })
}

impl Linear {
    fn new(weight: Vec<f32>, bias: Vec<f32>, inputs: usize, offset: &mut usize) -> Linear {
        let outputs = bias.len();
        let transposed = (0..inputs).flat_map(|i| (0..outputs).map(move |o| (o, i)));
        let transposed = transposed.map(|(o, i)| weight[o * inputs + i]).collect();
        let (weight_offset, bias_offset) = (*offset, *offset + weight.len());
        *offset = bias_offset + outputs;
        Linear { weight, transposed, bias, inputs, weight_offset, bias_offset }
    }

    fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// The weights that read inputs `from..from + columns`.
    fn columns(&self, from: usize, columns: usize) -> Matrix<'_> {
        Matrix::new(&self.weight[from..], self.outputs(), columns, self.inputs)
    }

    /// `y = x W^T` of the inputs that `x [rows, columns]` holds, from column `from` on, or `y +=` that.
    fn forward(&self, x: &[f32], from: usize, columns: usize, y: &mut [f32], accumulate: bool) {
        let outputs = self.outputs();
        let x = Matrix::new(x, y.len() / outputs, columns, columns);
        let weight = Matrix::new(&self.transposed[from * outputs..], columns, outputs, outputs);
        multiply(y, outputs, x, weight, accumulate);
    }

    /// `x += dz W`, or `x = dz W`, for the same inputs.
    pub(super) fn input_gradient(&self, dz: &[f32], from: usize, columns: usize, x: &mut [f32], accumulate: bool) {
        let dz = Matrix::new(dz, dz.len() / self.outputs(), self.outputs(), self.outputs());
        multiply(x, columns, dz, self.columns(from, columns), accumulate);
    }

    /// Adds `dz^T x` to the gradient of the weights that read `x`.
    pub(super) fn weight_gradient(&self, dz: &[f32], x: &[f32], from: usize, columns: usize, sum: &mut [f32]) {
        let rows = dz.len() / self.outputs();
        let dz = Matrix::new(dz, rows, self.outputs(), self.outputs());
        let sum = &mut sum[self.weight_offset + from..];
        multiply(sum, self.inputs, dz.transposed(), Matrix::new(x, rows, columns, columns), true);
    }

    /// Gradients of weights and biases in a flat sum.
    fn gradients_in(&self, sum: &[f32]) -> [Vec<f32>; 2] {
        let bias_end = self.bias_offset + self.outputs();
        [sum[self.weight_offset..self.bias_offset].to_vec(), sum[self.bias_offset..bias_end].to_vec()]
    }

    /// The part of a flat gradient that belongs to the biases.
    pub(super) fn bias_of<'a>(&self, sum: &'a mut [f32]) -> &'a mut [f32] {
        &mut sum[self.bias_offset..][..self.outputs()]
    }

    fn bias_gradient(&self, dz: &[f32], sum: &mut [f32]) {
        add_rows(self.bias_of(sum), dz);
    }
}

impl Head {
    /// `y [rows, outputs]` of `x [rows, inputs]`.
    pub(super) fn forward(&self, x: &[f32], y: &mut [f32]) {
        few_forward(x, &self.0.weight, self.0.outputs(), y);
        add_bias(y, &self.0.bias);
    }

    /// `x = dz W`, or `x += dz W`.
    fn input_gradient(&self, dz: &[f32], x: &mut [f32], accumulate: bool) {
        few_input_gradient(dz, &self.0.weight, self.0.outputs(), x, accumulate);
    }

    /// Adds to the gradients of weights and biases.
    fn gradients(&self, dz: &[f32], x: &[f32], sum: &mut [f32]) {
        few_weight_gradient(dz, x, self.0.outputs(), self.weights_of(sum));
        self.0.bias_gradient(dz, sum);
    }

    /// `[outputs, inputs]`.
    pub(super) fn weights(&self) -> &[f32] {
        &self.0.weight
    }

    /// The part of a flat gradient that belongs to the weights.
    pub(super) fn weights_of<'a>(&self, sum: &'a mut [f32]) -> &'a mut [f32] {
        &mut sum[self.0.weight_offset..self.0.bias_offset]
    }

    pub(super) fn bias_of<'a>(&self, sum: &'a mut [f32]) -> &'a mut [f32] {
        self.0.bias_of(sum)
    }
}

impl Network {
    /// Lays out `values`, weight and bias of every layer in the order of parameters.
    pub fn new(config: &FieldConfig, values: Vec<Vec<f32>>) -> Network {
        let mut values = values.into_iter();
        let mut offset = 0;
        let mut layers: Vec<(Vec<f32>, Vec<f32>, usize)> = Vec::new();
        for (_, _, inputs) in layer_shapes(config) {
            let weight = values.next().expect("one weight a layer");
            layers.push((weight, values.next().expect("one bias a layer"), inputs));
        }
        let mut heads = layers.split_off(config.depth).into_iter();
        let mut head = || heads.next().expect("four heads");
        let (density, feature, view, rgb) = (head(), head(), head(), head());
        let mut linear = |(weight, bias, inputs)| Linear::new(weight, bias, inputs, &mut offset);
        let trunk = layers.into_iter().map(&mut linear).collect();
        let density = Head(linear(density));
        let (width, inputs) = (config.width, view.2);
        let (mut joint, mut joint_bias) = (view.0.clone(), view.1);
        let of_feature = Matrix::new(&view.0, width / 2, width, inputs);
        multiply(&mut joint, inputs, of_feature, Matrix::new(&feature.0, width, width, width), false);
        multiply(&mut joint_bias, 1, of_feature, Matrix::new(&feature.1, width, 1, 1), true);
        let joint = linear((joint, joint_bias, inputs));
        let rgb = Head(linear(rgb));
        let parts = Parts { feature: feature.0, feature_bias: feature.1, view: view.0 };
        Network { config: config.clone(), trunk, density, view: joint, rgb, parts, gradient_size: offset }
    }

    /// Gradients of every layer's weight and bias, in the order of parameters, from the flat sum of backward passes.
    pub fn parameter_gradients(&self, sum: &[f32]) -> Vec<Vec<f32>> {
        let mut gradients = self.trunk_gradients(sum);
        let [mut view, view_bias] = self.view.gradients_in(sum);
        let (width, inputs) = (self.config.width, self.view.inputs);
        // With G and s the gradients of V W and of the bias: dW = V^T G, db = V^T s, dV = G W^T + s b^T.
        let joint = Matrix::new(&sum[self.view.weight_offset..], width / 2, width, inputs);
        let of_bias = Matrix::new(&view_bias, width / 2, 1, 1);
        let back = Matrix::new(&self.parts.view, width / 2, width, inputs).transposed();
        let (mut feature, mut feature_bias) = (vec![0f32; width * width], vec![0f32; width]);
        multiply(&mut feature, width, back, joint, false);
        multiply(&mut feature_bias, 1, back, of_bias, false);
        let weight = Matrix::new(&self.parts.feature, width, width, width);
        multiply(&mut view, inputs, joint, weight.transposed(), false);
        multiply(&mut view, inputs, of_bias, Matrix::new(&self.parts.feature_bias, 1, width, width), true);
        gradients.extend([feature, feature_bias, view, view_bias]);
        gradients.extend(self.rgb.0.gradients_in(sum));
        gradients
    }

    /// The same of the trunk and the density head, which come first.
    pub(super) fn trunk_gradients(&self, sum: &[f32]) -> Vec<Vec<f32>> {
        self.trunk.iter().chain([&self.density.0]).flat_map(|layer| layer.gradients_in(sum)).collect()
    }

    /// Trunk layers.
    pub fn depth(&self) -> usize {
        self.config.depth
    }

    /// Neurons of a trunk layer.
    pub fn width(&self) -> usize {
        self.config.width
    }

    /// How positions are encoded.
    pub(super) fn code(&self) -> Code {
        Code::of_positions(&self.config)
    }

    pub(super) fn position_channels(&self) -> usize {
        self.code().channels()
    }

    fn view_channels(&self) -> usize {
        encoded_channels(self.config.view_octaves)
    }

    fn skips(&self, layer: usize) -> bool {
        layer > 0 && self.config.skips.contains(&layer)
    }

    /// Whether trunk layer `layer` (from 0) reads the encoding.
    pub(super) fn encodes(&self, layer: usize) -> bool {
        layer == 0 || self.skips(layer)
    }

    /// Inputs of trunk layer `layer` (from 0) before those that read the layer below.
    pub(super) fn encoded_inputs(&self, layer: usize) -> usize {
        if self.skips(layer) { self.position_channels() } else { 0 }
    }

    /// The trunk up to layer `layer` (1-based) at points `[n, 3]`.
    pub fn prefix(&self, points: &[f32], layer: usize) -> Prefix {
        let n = points.len() / self.code().inputs();
        let (width, position) = (self.config.width, self.position_channels());
        let mut prefix = Prefix { encoded: Buffer::new(n * position), hidden: Buffer::new(n * width) };
        let mut layers = [Buffer::new(TILE * width), Buffer::new(TILE * width)];
        for tile in tiles(n) {
            let encoded = tile.of_mut(&mut prefix.encoded, position);
            encode_positions(self.code(), tile.of(points, self.code().inputs()), encoded);
            for l in 0..layer {
                let [a, b] = &mut layers;
                let (below, output) = if l % 2 == 0 { (&*b, a) } else { (&*a, b) };
                self.trunk_layer(l, encoded, &below[..tile.rows * width], &mut output[..tile.rows * width], None);
            }
            tile.of_mut(&mut prefix.hidden, width).copy_from_slice(&layers[(layer - 1) % 2][..tile.rows * width]);
        }
        prefix
    }

    /// Trunk layer `l` (from 0) of a tile, with its ReLU. The lowest layer does not read `below`.
    pub(super) fn trunk_layer(
        &self,
        l: usize,
        encoded: &[f32],
        below: &[f32],
        output: &mut [f32],
        mask: Option<&mut [u8]>,
    ) {
        self.trunk_product(l, encoded, below, output);
        add_bias_relu(output, &self.trunk[l].bias, mask);
    }

    /// Trunk layer `l`'s weights times its input.
    pub(super) fn trunk_product(&self, l: usize, encoded: &[f32], below: &[f32], output: &mut [f32]) {
        let (layer, width, position) = (&self.trunk[l], self.config.width, self.position_channels());
        if self.encodes(l) {
            layer.forward(encoded, 0, position, output, false);
        }
        if l > 0 {
            layer.forward(below, self.encoded_inputs(l), width, output, self.encodes(l));
        }
    }

    /// What a ray's direction and the bias add to the view layer at each of its points, `[rays, width / 2]`.
    fn view_of_rays(&self, encoded_views: &[f32], rays: usize) -> Buffer<f32> {
        let mut of_rays = Buffer::new(rays * (self.config.width / 2));
        if rays > 0 {
            self.view.forward(encoded_views, self.config.width, self.view_channels(), &mut of_rays, false);
            add_bias(&mut of_rays, &self.view.bias);
        }
        of_rays
    }

    /// Raw colours `[n, 3]` followed by raw densities `[n]`, or raw densities alone; and what a backward pass for
    /// `wanted` needs.
    pub fn forward(&self, inputs: Inputs, wanted: Wanted) -> (Vec<f32>, Kept) {
        let n = inputs.points.len() / self.code().inputs();
        let (width, depth) = (self.config.width, self.config.depth);
        let (position, direction) = (self.position_channels(), self.view_channels());
        let rays = inputs.viewdirs.len() / 3;
        let samples = n.checked_div(rays).unwrap_or(0);
        let colours = if rays > 0 { 3 * n } else { 0 };
        let mut raw = vec![0f32; colours + n];
        let whole = |wanted: bool, size: usize| Buffer::new(if wanted { n * size } else { 0 });
        let mask = |size: usize| Buffer::new(if wanted.any() { n * size } else { 0 });
        let mut kept = Kept {
            encoded: whole(wanted.weights || wanted.points, position),
            encoded_views: Buffer::new(rays * direction),
            hidden: (0..depth).map(|_| whole(wanted.weights, width)).collect(),
            masks: (0..depth).map(|_| mask(width)).collect(),
            view: whole(wanted.weights && rays > 0, width / 2),
            view_mask: if rays > 0 { mask(width / 2) } else { Buffer::default() },
        };
        encode_tile(inputs.viewdirs, self.config.view_octaves, &mut kept.encoded_views);
        let mut encoded = Buffer::new(TILE * position);
        let mut layers = [Buffer::new(TILE * width), Buffer::new(TILE * width)];
        let mut view = Buffer::new(TILE * width / 2);
        let of_rays = self.view_of_rays(&kept.encoded_views, rays);
        let (raw_colour, raw_density) = raw.split_at_mut(colours);
        for tile in tiles(n) {
            let encoded = match inputs.prefix {
                Some(prefix) => tile.of(&prefix.encoded, position),
                None => {
                    let encoded = if kept.encoded.is_empty() {
                        &mut encoded[..tile.rows * position]
                    } else {
                        tile.of_mut(&mut kept.encoded, position)
                    };
                    encode_positions(self.code(), tile.of(inputs.points, self.code().inputs()), encoded);
                    encoded
                }
            };
            let first = if inputs.prefix.is_some() { inputs.delta.map_or(depth, |(layer, _)| layer) - 1 } else { 0 };
            for l in first..depth {
                // Layers are kept whole where weights want gradients, otherwise they take turns in two tiles.
                let (below, output) = if wanted.weights {
                    let (below, rest) = kept.hidden.split_at_mut(l);
                    let below = below.last().map_or(&[][..], |below| tile.of(below, width));
                    (below, tile.of_mut(&mut rest[0], width))
                } else {
                    let [a, b] = &mut layers;
                    let (below, output) = if l % 2 == 0 { (&*b, a) } else { (&*a, b) };
                    (&below[..tile.rows * width], &mut output[..tile.rows * width])
                };
                match inputs.prefix.filter(|_| l == first) {
                    Some(prefix) => output.copy_from_slice(tile.of(&prefix.hidden, width)),
                    None => {
                        let mask = wanted.any().then(|| tile.of_mut(&mut kept.masks[l], width));
                        self.trunk_layer(l, encoded, below, output, mask);
                    }
                }
                if let Some((_, delta)) = inputs.delta.filter(|(at, _)| *at == l + 1) {
                    add(output, tile.of(delta, width));
                }
            }
            let last = if wanted.weights {
                tile.of(&kept.hidden[depth - 1], width)
            } else {
                &layers[(depth - 1) % 2][..tile.rows * width]
            };
            let density = tile.of_mut(raw_density, 1);
            self.density.forward(last, density);
            if rays == 0 {
                continue;
            }
            let view = if wanted.weights {
                tile.of_mut(&mut kept.view, width / 2)
            } else {
                &mut view[..tile.rows * (width / 2)]
            };
            self.view.forward(last, 0, width, view, false);
            let mask = wanted.any().then(|| tile.of_mut(&mut kept.view_mask, width / 2));
            add_of_rays_relu(view, &of_rays, width / 2, (tile.start, samples), mask);
            let colour = tile.of_mut(raw_colour, 3);
            self.rgb.forward(view, colour);
        }
        (raw, kept)
    }

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
        let (width, depth) = (self.config.width, self.config.depth);
        let (position, direction) = (self.position_channels(), self.view_channels());
        let rays = inputs.viewdirs.len() / 3;
        let samples = n.checked_div(rays).unwrap_or(0);
        let delta_layer = inputs.delta.map_or(0, |(layer, _)| layer);
        // The lowest trunk layer (from 0) whose input, or weights, want a gradient.
        let lowest = match wanted {
            Wanted { weights: false, points: false, delta: true, .. } => delta_layer,
            Wanted { weights: false, points: false, delta: false, .. } => depth,
            _ => 0,
        };
        let into_trunk = lowest < depth || delta_layer == depth && wanted.delta;
        let mut out = InputGradients {
            points: vec![0f32; if wanted.points { self.code().inputs() * n } else { 0 }],
            viewdirs: vec![0f32; if wanted.viewdirs { 3 * rays } else { 0 }],
            delta: vec![0f32; if wanted.delta { n * width } else { 0 }],
        };
        let by_rays = rays > 0 && (wanted.weights || wanted.viewdirs);
        let mut d_rays = vec![0f32; if by_rays { rays * (width / 2) } else { 0 }];
        let (g_colour, g_density) = gradient.split_at(if rays > 0 { 3 * n } else { 0 });
        let active: Vec<usize> = (0..n)
            .filter(|&i| g_density[i] != 0.0 || rays > 0 && g_colour[3 * i..][..3].iter().any(|&g| g != 0.0))
            .collect();
        count_points(n, active.len());
        let mut scratch = Scratch::default();
        let (mut room_a, mut room_b) = (Buffer::new(TILE * width), Buffer::new(TILE * width));
        let mut room_view = Buffer::new(TILE * width / 2);
        let mut room_encoded = Buffer::new(TILE * position);
        for rows in active.chunks(TILE) {
            let count = rows.len();
            let (mut d_output, mut d_input) = (&mut room_a[..count * width], &mut room_b[..count * width]);
            let dv = &mut room_view[..count * (width / 2)];
            let density = scratch.density.rows(g_density, 1, rows);
            if rays > 0 {
                let colour = scratch.colour.rows(g_colour, 3, rows);
                self.rgb.input_gradient(colour, dv, false);
                apply_mask(dv, scratch.mask.rows(&kept.view_mask, width / 2, rows));
                if wanted.weights {
                    let view = scratch.input.rows(&kept.view, width / 2, rows);
                    self.rgb.gradients(colour, view, weights);
                    let hidden = scratch.input.rows(&kept.hidden[depth - 1], width, rows);
                    self.view.weight_gradient(dv, hidden, 0, width, weights);
                }
                if by_rays {
                    for (dv, &row) in dv.chunks_exact(width / 2).zip(rows) {
                        add(&mut d_rays[row / samples * (width / 2)..][..width / 2], dv);
                    }
                }
                if into_trunk {
                    self.view.input_gradient(dv, 0, width, d_output, false);
                }
            }
            if wanted.weights {
                let hidden = scratch.input.rows(&kept.hidden[depth - 1], width, rows);
                self.density.gradients(density, hidden, weights);
            }
            if !into_trunk {
                continue;
            }
            self.density.input_gradient(density, d_output, rays > 0);
            let de = &mut room_encoded[..count * position];
            de.fill(0.0);
            for (l, layer) in self.trunk.iter().enumerate().rev() {
                if l + 1 == delta_layer && wanted.delta {
                    scatter(d_output, width, rows, &mut out.delta);
                }
                if l < lowest {
                    break;
                }
                apply_mask(d_output, scratch.mask.rows(&kept.masks[l], width, rows));
                let (encodes, from) = (self.encodes(l), self.encoded_inputs(l));
                if wanted.weights {
                    if encodes {
                        let encoded = scratch.input.rows(&kept.encoded, position, rows);
                        layer.weight_gradient(d_output, encoded, 0, position, weights);
                    }
                    if l > 0 {
                        let hidden = scratch.input.rows(&kept.hidden[l - 1], width, rows);
                        layer.weight_gradient(d_output, hidden, from, width, weights);
                    }
                    layer.bias_gradient(d_output, weights);
                }
                if encodes && wanted.points {
                    layer.input_gradient(d_output, 0, position, de, true);
                }
                if l > 0 {
                    layer.input_gradient(d_output, from, width, d_input, false);
                    std::mem::swap(&mut d_output, &mut d_input);
                }
            }
            if wanted.points {
                let encoded = scratch.input.rows(&kept.encoded, position, rows);
                let code = self.code();
                let mut d_points = vec![0f32; code.inputs() * count];
                code.gradient_into(encoded, de, &mut d_points);
                scatter(&d_points, code.inputs(), rows, &mut out.points);
            }
        }
        if wanted.weights && rays > 0 {
            self.view.weight_gradient(&d_rays, &kept.encoded_views, width, direction, weights);
            self.view.bias_gradient(&d_rays, weights);
        }
        if wanted.viewdirs {
            let mut d_views = vec![0f32; rays * direction];
            self.view.input_gradient(&d_rays, width, direction, &mut d_views, false);
            gradient_into(&kept.encoded_views, &d_views, self.config.view_octaves, &mut out.viewdirs);
        }
        out
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
