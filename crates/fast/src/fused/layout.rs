//! A network's weights in the layout for tiles of points, and its layers.
//!
//! There is no activation between the feature layer and the view layer, so that both are merged. With V the columns of
//! the view layer's weights that read the feature W h + b, V (W h + b) = (V W) h + V b. This saves a ninth of all
//! multiply-adds. Gradients of V W are separated once per step ([`Network::parameter_gradients`]).

use std::sync::OnceLock;

use crate::encoding::{Code, encoded_channels};

use super::kernels::panels::{Form, Packed, Slab, filled_up};
use super::kernels::product::{Bias, Finish, Lhs, Out, Rows, Source};
use super::kernels::{Head, Matrix, add_bias, few_forward, multiply};
use super::pool::Buffer;

/// Points per tile. Their layers stay in a core's second-level cache.
pub(super) const TILE: usize = 512;

/// One layer's weights `[outputs, inputs]` and biases, and their start in the flat gradient.
pub(super) struct Linear {
    weight: Vec<f32>,
    transposed: OnceLock<Vec<f32>>,
    pub(super) bias: Vec<f32>,
    pub(super) inputs: usize,
    pub(super) weight_offset: usize,
    bias_offset: usize,
}

/// A layer of many outputs, packed for products with rows and with their gradients.
pub(super) struct Layer {
    pub(super) linear: Linear,
    /// The bias, padded to a panel.
    pub(super) bias: Vec<f32>,
    /// Weights for the encoding; always f32.
    pub(super) encoded: Option<Packed>,
    /// Weights for the layer below.
    pub(super) below: Option<Packed>,
    /// The transposes of both, in the field's precision.
    pub(super) to_encoded: Option<Packed>,
    pub(super) to_below: Option<Packed>,
}

/// A layer of few outputs.
pub(super) struct Output {
    pub(super) linear: Linear,
    pub(super) head: Head,
}

/// What the networks of a field are made of.
#[derive(Clone, Debug)]
pub struct Architecture {
    /// The encoding of positions.
    pub code: Code,
    /// Octaves of the view direction's encoding.
    pub view_octaves: usize,
    /// Number of trunk layers.
    pub depth: usize,
    /// Their width.
    pub width: usize,
    /// The encoding is concatenated to the output of these trunk layers (1-based).
    pub skips: Vec<usize>,
    /// Number of layers between trunk and colour.
    pub view_depth: usize,
    /// Numbers between layers are bf16.
    pub bf16: bool,
}

/// A copy of a field's weights in the layout for tiles, made once per step.
pub struct Network {
    pub(super) architecture: Architecture,
    pub(super) trunk: Vec<Layer>,
    pub(super) density: Output,
    /// Layers above the trunk. The first reads the trunk, with the feature layer merged in, and the encoded direction.
    /// It is `[neurons, width + view channels]`, the others are `[neurons, neurons]`.
    pub(super) views: Vec<Layer>,
    /// Weights of the first view layer for the direction.
    of_direction: Packed,
    pub(super) rgb: Output,
    /// The parts of the first view layer.
    parts: Parts,
    /// Length of the flat gradient.
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
        let (weight_offset, bias_offset) = (*offset, *offset + weight.len());
        *offset = bias_offset + bias.len();
        Linear { weight, transposed: OnceLock::new(), bias, inputs, weight_offset, bias_offset }
    }

    /// `[inputs, outputs]`.
    fn transposed(&self) -> &[f32] {
        self.transposed.get_or_init(|| {
            let outputs = self.outputs();
            let order = (0..self.inputs).flat_map(|i| (0..outputs).map(move |o| (o, i)));
            order.map(|(o, i)| self.weight[o * self.inputs + i]).collect()
        })
    }

    pub(super) fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Returns the weights for inputs `from..from + columns`.
    fn columns(&self, from: usize, columns: usize) -> Matrix<'_> {
        Matrix::new(&self.weight[from..], self.outputs(), columns, self.inputs)
    }

    /// Computes `y = x W^T`, or `y +=` it, for the inputs in `x [rows, columns]`, from column `from`.
    pub(super) fn forward(&self, x: &[f32], from: usize, columns: usize, y: &mut [f32], accumulate: bool) {
        let outputs = self.outputs();
        let x = Matrix::new(x, y.len() / outputs, columns, columns);
        let weight = Matrix::new(&self.transposed()[from * outputs..], columns, outputs, outputs);
        multiply(y, outputs, x, weight, accumulate);
    }

    /// Computes `x += dz W`, or `x = dz W`, for the same inputs. Rows of `dz` are `stride` apart.
    pub(super) fn input_gradient(
        &self,
        (dz, stride): (&[f32], usize),
        from: usize,
        columns: usize,
        x: &mut [f32],
        accumulate: bool,
    ) {
        let dz = Matrix::new(dz, dz.len() / stride, self.outputs(), stride);
        multiply(x, columns, dz, self.columns(from, columns), accumulate);
    }

    /// Adds `dz^T x` to the gradient of the weights for `x`. Rows of `dz` are `stride` apart.
    pub(super) fn weight_gradient(
        &self,
        (dz, stride): (&[f32], usize),
        x: &[f32],
        from: usize,
        columns: usize,
        sum: &mut [f32],
    ) {
        let rows = dz.len() / stride;
        let dz = Matrix::new(dz, rows, self.outputs(), stride);
        let sum = &mut sum[self.weight_offset + from..];
        multiply(sum, self.inputs, dz.transposed(), Matrix::new(x, rows, columns, columns), true);
    }

    /// Returns the gradients of weights and biases in a flat sum.
    fn gradients_in(&self, sum: &[f32]) -> [Vec<f32>; 2] {
        let bias_end = self.bias_offset + self.outputs();
        [sum[self.weight_offset..self.bias_offset].to_vec(), sum[self.bias_offset..bias_end].to_vec()]
    }

    /// Returns the biases' part of a flat gradient.
    pub(super) fn bias_of<'a>(&self, sum: &'a mut [f32]) -> &'a mut [f32] {
        &mut sum[self.bias_offset..][..self.outputs()]
    }

    /// Returns the weights' part of a flat gradient.
    pub(super) fn weights_of<'a>(&self, sum: &'a mut [f32]) -> &'a mut [f32] {
        &mut sum[self.weight_offset..self.bias_offset]
    }
}

impl Layer {
    /// Creates a layer with these numbers of inputs from the encoding and from the layer below.
    fn new(linear: Linear, pairs: bool, [encoded, below]: [usize; 2]) -> Layer {
        let pack = |pairs: bool, from: usize, inputs: usize| {
            let (outputs, inputs) = ((linear.outputs(), linear.inputs), (inputs, 1));
            (inputs.0 > 0).then(|| Packed::new(pairs, outputs, inputs, &linear.weight[from..]))
        };
        let back = |from: usize, inputs: usize| {
            let (outputs, inputs) = ((linear.outputs(), linear.inputs), (inputs, 1));
            (inputs.0 > 0).then(|| Packed::new(pairs, inputs, outputs, &linear.weight[from..]))
        };
        Layer {
            bias: filled_up(&linear.bias),
            encoded: pack(false, 0, encoded),
            below: pack(pairs, encoded, below),
            to_encoded: back(0, encoded),
            to_below: back(encoded, below),
            linear,
        }
    }
}

impl Output {
    fn new(linear: Linear) -> Output {
        Output { head: Head::new(&linear.weight, &linear.bias), linear }
    }

    /// Computes `y [rows, outputs]` from `x [rows, inputs]`, row by row.
    pub(super) fn forward(&self, x: &[f32], y: &mut [f32]) {
        few_forward(x, &self.linear.weight, self.linear.outputs(), y);
        add_bias(y, &self.linear.bias);
    }

    /// `[outputs, inputs]`.
    pub(super) fn weights(&self) -> &[f32] {
        &self.linear.weight
    }
}

impl Network {
    /// Lays out `values`: weight and bias of every layer in the order of parameters.
    pub fn new(architecture: Architecture, values: Vec<Vec<f32>>) -> Network {
        let mut values = values.into_iter();
        let mut offset = 0;
        let mut layers: Vec<(Vec<f32>, Vec<f32>, usize)> = Vec::new();
        while let Some(weight) = values.next() {
            let bias = values.next().expect("one bias a layer");
            let inputs = weight.len() / bias.len();
            layers.push((weight, bias, inputs));
        }
        let mut heads = layers.split_off(architecture.depth).into_iter();
        let mut head = || heads.next().expect("density, feature and a view layer");
        let (density, feature, view) = (head(), head(), head());
        let mut linear = |(weight, bias, inputs)| Linear::new(weight, bias, inputs, &mut offset);
        let (width, pairs) = (architecture.width, architecture.bf16);
        let trunk = layers.into_iter().enumerate().map(|(l, layer)| {
            let below = if l > 0 { width } else { 0 };
            let layer = linear(layer);
            let encoded = layer.inputs - below;
            Layer::new(layer, pairs, [encoded, below])
        });
        let trunk = trunk.collect();
        let density = Output::new(linear(density));
        let (outputs, inputs) = (view.1.len(), view.2);
        let (mut joint, mut joint_bias) = (view.0.clone(), view.1);
        let of_feature = Matrix::new(&view.0, outputs, width, inputs);
        multiply(&mut joint, inputs, of_feature, Matrix::new(&feature.0, width, width, width), false);
        multiply(&mut joint_bias, 1, of_feature, Matrix::new(&feature.1, width, 1, 1), true);
        let joint = linear((joint, joint_bias, inputs));
        let of_direction = Packed::new(false, (outputs, inputs), (inputs - width, 1), &joint.weight[width..]);
        let mut views = vec![Layer::new(joint, pairs, [0, width])];
        for layer in heads.by_ref().take(architecture.view_depth - 1) {
            let layer = linear(layer);
            let inputs = layer.inputs;
            views.push(Layer::new(layer, pairs, [0, inputs]));
        }
        let rgb = Output::new(linear(heads.next().expect("a colour head")));
        let parts = Parts { feature: feature.0, feature_bias: feature.1, view: view.0 };
        Network { architecture, trunk, density, views, of_direction, rgb, parts, gradient_size: offset }
    }

    /// Returns the gradients of every layer's weight and bias, in the order of parameters, from the flat sum of
    /// backward passes.
    pub fn parameter_gradients(&self, sum: &[f32]) -> Vec<Vec<f32>> {
        let mut gradients = self.trunk_gradients(sum);
        let joint = &self.views[0].linear;
        let [mut view, view_bias] = joint.gradients_in(sum);
        let (width, outputs, inputs) = (self.architecture.width, joint.outputs(), joint.inputs);
        // With G and s the gradients of V W and of the bias: dW = V^T G, db = V^T s, dV = G W^T + s b^T.
        let of_joint = Matrix::new(&sum[joint.weight_offset..], outputs, width, inputs);
        let of_bias = Matrix::new(&view_bias, outputs, 1, 1);
        let back = Matrix::new(&self.parts.view, outputs, width, inputs).transposed();
        let (mut feature, mut feature_bias) = (vec![0f32; width * width], vec![0f32; width]);
        multiply(&mut feature, width, back, of_joint, false);
        multiply(&mut feature_bias, 1, back, of_bias, false);
        let weight = Matrix::new(&self.parts.feature, width, width, width);
        multiply(&mut view, inputs, of_joint, weight.transposed(), false);
        multiply(&mut view, inputs, of_bias, Matrix::new(&self.parts.feature_bias, 1, width, width), true);
        gradients.extend([feature, feature_bias, view, view_bias]);
        let rest = self.views[1..].iter().map(|layer| &layer.linear).chain([&self.rgb.linear]);
        gradients.extend(rest.flat_map(|linear| linear.gradients_in(sum)));
        gradients
    }

    /// The same for the trunk and the density head, which come first.
    pub(super) fn trunk_gradients(&self, sum: &[f32]) -> Vec<Vec<f32>> {
        let layers = self.trunk.iter().map(|layer| &layer.linear).chain([&self.density.linear]);
        layers.flat_map(|linear| linear.gradients_in(sum)).collect()
    }

    /// Returns the number of trunk layers.
    pub fn depth(&self) -> usize {
        self.architecture.depth
    }

    /// Returns the width of a trunk layer.
    pub fn width(&self) -> usize {
        self.architecture.width
    }

    /// Returns the encoding of positions.
    pub(super) fn code(&self) -> Code {
        self.architecture.code
    }

    pub(super) fn position_channels(&self) -> usize {
        self.code().channels()
    }

    pub(super) fn view_channels(&self) -> usize {
        encoded_channels(self.architecture.view_octaves)
    }

    fn skips(&self, layer: usize) -> bool {
        layer > 0 && self.architecture.skips.contains(&layer)
    }

    /// Returns whether trunk layer `layer` (from 0) reads the encoding.
    pub(super) fn encodes(&self, layer: usize) -> bool {
        layer == 0 || self.skips(layer)
    }

    /// Returns the number of inputs of trunk layer `layer` (from 0) before those from the layer below.
    pub(super) fn encoded_inputs(&self, layer: usize) -> usize {
        if self.skips(layer) { self.position_channels() } else { 0 }
    }

    /// Returns whether numbers between layers are bf16.
    pub(super) fn pairs(&self) -> bool {
        self.architecture.bf16
    }

    /// Allocates a layer's rows in the layout of the next product.
    pub(super) fn lhs(&self, rows: usize, columns: usize) -> Slab {
        Slab::new(if self.pairs() { Form::Across } else { Form::Single }, rows, columns)
    }

    /// Allocates a layer's rows in the layout of weight gradients.
    pub(super) fn rhs(&self, rows: usize, columns: usize) -> Slab {
        Slab::new(if self.pairs() { Form::Down } else { Form::Single }, rows, columns)
    }

    /// Returns what a ray's direction and the bias add to the first view layer at each of its points,
    /// `[rays, columns]`. Columns are padded to a panel.
    pub(super) fn view_of_rays(&self, encoded_views: &[f32], rays: usize) -> Buffer<f32> {
        let view = &self.views[0];
        let stride = view.bias.len();
        let mut of_rays = Buffer::new(rays * stride);
        of_rays.fill(0.0);
        let sources = [Source { lhs: Lhs::Rows(encoded_views), weights: &self.of_direction }];
        let finish = Finish {
            bias: Some(Bias { values: &view.bias, of_rays: (0, 0) }),
            out: Some(Out { values: &mut of_rays, stride, accumulate: false }),
            ..Finish::default()
        };
        Rows::Products(&sources).finish(rays, view.linear.outputs(), finish);
        of_rays
    }
}
