//! A network's weights laid out for tiles of points, and its layers.
//!
//! Nothing lies between the feature layer and the view layer, so that both are one: with V the
//! columns of the view layer's weights that read the feature W h + b, V (W h + b) = (V W) h + V b. A
//! ninth of all multiply-adds is spared. Gradients of V W are sorted out once a step
//! ([`Network::parameter_gradients`]).

use crate::field::encoding::{Code, encoded_channels};
use crate::field::layer_shapes;
use crate::settings::FieldConfig;

use super::kernels::{
    Matrix, add_bias, add_bias_relu, add_rows, few_forward, few_input_gradient, few_weight_gradient, multiply,
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
    pub(super) view: Linear,
    pub(super) rgb: Head,
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
    pub(super) fn forward(&self, x: &[f32], from: usize, columns: usize, y: &mut [f32], accumulate: bool) {
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

    pub(super) fn bias_gradient(&self, dz: &[f32], sum: &mut [f32]) {
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
    pub(super) fn input_gradient(&self, dz: &[f32], x: &mut [f32], accumulate: bool) {
        few_input_gradient(dz, &self.0.weight, self.0.outputs(), x, accumulate);
    }

    /// Adds to the gradients of weights and biases.
    pub(super) fn gradients(&self, dz: &[f32], x: &[f32], sum: &mut [f32]) {
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

    pub(super) fn view_channels(&self) -> usize {
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
    pub(super) fn view_of_rays(&self, encoded_views: &[f32], rays: usize) -> Buffer<f32> {
        let mut of_rays = Buffer::new(rays * (self.config.width / 2));
        if rays > 0 {
            self.view.forward(encoded_views, self.config.width, self.view_channels(), &mut of_rays, false);
            add_bias(&mut of_rays, &self.view.bias);
        }
        of_rays
    }
}
