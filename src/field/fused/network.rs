//! The network on tiles of points: forward with what the backward pass needs kept, and backward
//! with exactly the gradients that are asked for.

use crate::config::FieldConfig;
use crate::field::encoding::{encode_into, encoded_channels, gradient_into};

use super::kernels::{Matrix, add, add_bias, add_bias_relu, add_rows, apply_mask, multiply};

/// Points worked through at once: their layers stay in a core's second-level cache.
const TILE: usize = 256;

/// One layer's weights `[outputs, inputs]` and biases, and where both start in the flat gradient.
pub struct Linear<'a> {
    pub weight: &'a [f32],
    pub bias: &'a [f32],
    pub inputs: usize,
    pub weight_offset: usize,
    pub bias_offset: usize,
}

/// A field's layers in the order of its parameters.
pub struct Network<'a> {
    pub config: &'a FieldConfig,
    pub trunk: Vec<Linear<'a>>,
    pub density: Linear<'a>,
    pub feature: Linear<'a>,
    pub view: Linear<'a>,
    pub rgb: Linear<'a>,
}

/// What a forward pass is asked.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// `[n, 3]`.
    pub points: &'a [f32],
    /// `[rays, 3]`, unit; every ray has the same number of points. Empty: density alone is asked.
    pub viewdirs: &'a [f32],
    /// Trunk layer (1-based) and what is added to its output, `[n, width]`.
    pub delta: Option<(usize, &'a [f32])>,
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
    encoded: Vec<f32>,
    encoded_views: Vec<f32>,
    /// Each trunk layer's output, delta included.
    hidden: Vec<Vec<f32>>,
    /// Where each trunk layer's output was positive.
    masks: Vec<Vec<u8>>,
    feature: Vec<f32>,
    view: Vec<f32>,
    view_mask: Vec<u8>,
}

/// Gradients of a backward pass; what was not wanted is empty.
#[derive(Default)]
pub struct InputGradients {
    pub points: Vec<f32>,
    pub viewdirs: Vec<f32>,
    pub delta: Vec<f32>,
}

/// Rows of a tile.
#[derive(Clone, Copy)]
struct Tile {
    start: usize,
    rows: usize,
}

impl Tile {
    fn of<'a, T>(&self, values: &'a [T], columns: usize) -> &'a [T] {
        &values[self.start * columns..][..self.rows * columns]
    }

    fn of_mut<'a, T>(&self, values: &'a mut [T], columns: usize) -> &'a mut [T] {
        &mut values[self.start * columns..][..self.rows * columns]
    }
}

fn tiles(n: usize) -> impl Iterator<Item = Tile> {
    (0..n).step_by(TILE).map(move |start| Tile { start, rows: TILE.min(n - start) })
}

impl Linear<'_> {
    fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// The weights that read inputs `from..from + columns`.
    fn columns(&self, from: usize, columns: usize) -> Matrix<'_> {
        Matrix::new(&self.weight[from..], self.outputs(), columns, self.inputs)
    }

    /// `y = x W^T` of the inputs that `x [rows, columns]` holds, from column `from` on, or `y +=` that.
    fn forward(&self, x: &[f32], from: usize, columns: usize, y: &mut [f32], accumulate: bool) {
        let rows = y.len() / self.outputs();
        let x = Matrix::new(x, rows, columns, columns);
        multiply(y, self.outputs(), x, self.columns(from, columns).transposed(), accumulate);
    }

    /// `x += dz W`, or `x = dz W`, for the same inputs.
    fn input_gradient(&self, dz: &[f32], from: usize, columns: usize, x: &mut [f32], accumulate: bool) {
        let dz = Matrix::new(dz, dz.len() / self.outputs(), self.outputs(), self.outputs());
        multiply(x, columns, dz, self.columns(from, columns), accumulate);
    }

    /// Adds `dz^T x` to the gradient of the weights that read `x`.
    fn weight_gradient(&self, dz: &[f32], x: &[f32], from: usize, columns: usize, sum: &mut [f32]) {
        let rows = dz.len() / self.outputs();
        let dz = Matrix::new(dz, rows, self.outputs(), self.outputs());
        let sum = &mut sum[self.weight_offset + from..];
        multiply(sum, self.inputs, dz.transposed(), Matrix::new(x, rows, columns, columns), true);
    }

    fn bias_gradient(&self, dz: &[f32], sum: &mut [f32]) {
        add_rows(&mut sum[self.bias_offset..][..self.outputs()], dz);
    }
}

impl Network<'_> {
    fn position_channels(&self) -> usize {
        encoded_channels(self.config.position_octaves)
    }

    fn view_channels(&self) -> usize {
        encoded_channels(self.config.view_octaves)
    }

    fn skips(&self, layer: usize) -> bool {
        layer > 0 && self.config.skips.contains(&layer)
    }

    /// Raw colours `[n, 3]` followed by raw densities `[n]`, or raw densities alone; and what a backward pass for
    /// `wanted` needs.
    pub fn forward(&self, inputs: Inputs, wanted: Wanted) -> (Vec<f32>, Kept) {
        let n = inputs.points.len() / 3;
        let (width, depth) = (self.config.width, self.config.depth);
        let (position, direction) = (self.position_channels(), self.view_channels());
        let rays = inputs.viewdirs.len() / 3;
        let samples = n.checked_div(rays).unwrap_or(0);
        let colours = if rays > 0 { 3 * n } else { 0 };
        let mut raw = vec![0f32; colours + n];
        let whole = |wanted: bool, size: usize| vec![0f32; if wanted { n * size } else { 0 }];
        let mask = |size: usize| vec![0u8; if wanted.any() { n * size } else { 0 }];
        let mut kept = Kept {
            encoded: whole(wanted.weights || wanted.points, position),
            encoded_views: vec![0f32; rays * direction],
            hidden: (0..depth).map(|_| whole(wanted.weights, width)).collect(),
            masks: (0..depth).map(|_| mask(width)).collect(),
            feature: whole(wanted.weights && rays > 0, width),
            view: whole(wanted.weights && rays > 0, width / 2),
            view_mask: if rays > 0 { mask(width / 2) } else { Vec::new() },
        };
        encode_into(inputs.viewdirs, self.config.view_octaves, &mut kept.encoded_views);
        let mut encoded = vec![0f32; TILE * position];
        let mut layers = [vec![0f32; TILE * width], vec![0f32; TILE * width]];
        let mut heads = (vec![0f32; TILE * width], vec![0f32; TILE * width / 2], vec![0f32; TILE * direction]);
        let (raw_colour, raw_density) = raw.split_at_mut(colours);
        for tile in tiles(n) {
            let encoded = if kept.encoded.is_empty() {
                &mut encoded[..tile.rows * position]
            } else {
                tile.of_mut(&mut kept.encoded, position)
            };
            encode_into(tile.of(inputs.points, 3), self.config.position_octaves, encoded);
            for (l, layer) in self.trunk.iter().enumerate() {
                // Layers are kept whole where weights want gradients, otherwise they take turns in two tiles.
                let (below, output) = if wanted.weights {
                    let (below, rest) = kept.hidden.split_at_mut(l);
                    (below.last().map(|below| tile.of(below, width)), tile.of_mut(&mut rest[0], width))
                } else {
                    let [a, b] = &mut layers;
                    let (below, output) = if l % 2 == 0 { (&*b, a) } else { (&*a, b) };
                    ((l > 0).then(|| &below[..tile.rows * width]), &mut output[..tile.rows * width])
                };
                match below {
                    None => layer.forward(encoded, 0, position, output, false),
                    Some(below) if self.skips(l) => {
                        layer.forward(encoded, 0, position, output, false);
                        layer.forward(below, position, width, output, true);
                    }
                    Some(below) => layer.forward(below, 0, width, output, false),
                }
                let mask = wanted.any().then(|| tile.of_mut(&mut kept.masks[l], width));
                add_bias_relu(output, layer.bias, mask);
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
            self.density.forward(last, 0, width, density, false);
            add_bias(density, self.density.bias);
            if rays == 0 {
                continue;
            }
            let (feature, view, views) = &mut heads;
            let (feature, view) = if wanted.weights {
                (tile.of_mut(&mut kept.feature, width), tile.of_mut(&mut kept.view, width / 2))
            } else {
                (&mut feature[..tile.rows * width], &mut view[..tile.rows * (width / 2)])
            };
            self.feature.forward(last, 0, width, feature, false);
            add_bias(feature, self.feature.bias);
            let views = &mut views[..tile.rows * direction];
            spread(&kept.encoded_views, tile, samples, direction, views);
            self.view.forward(feature, 0, width, view, false);
            self.view.forward(views, width, direction, view, true);
            let mask = wanted.any().then(|| tile.of_mut(&mut kept.view_mask, width / 2));
            add_bias_relu(view, self.view.bias, mask);
            let colour = tile.of_mut(raw_colour, 3);
            self.rgb.forward(view, 0, width / 2, colour, false);
            add_bias(colour, self.rgb.bias);
        }
        (raw, kept)
    }

    /// Pulls `gradient`, laid out as the raw output, back to what was wanted. Gradients of weights are added to
    /// `weights`, flat in the order of parameters.
    pub fn backward(
        &self,
        inputs: Inputs,
        kept: &Kept,
        gradient: &[f32],
        wanted: Wanted,
        weights: &mut [f32],
    ) -> InputGradients {
        let n = inputs.points.len() / 3;
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
        let mut out = InputGradients {
            points: vec![0f32; if wanted.points { 3 * n } else { 0 }],
            viewdirs: vec![0f32; if wanted.viewdirs { 3 * rays } else { 0 }],
            delta: vec![0f32; if wanted.delta { n * width } else { 0 }],
        };
        let mut d_views = vec![0f32; if wanted.viewdirs { rays * direction } else { 0 }];
        let (mut d_view, mut d_feature) = (vec![0f32; TILE * width / 2], vec![0f32; TILE * width]);
        let mut views = vec![0f32; TILE * direction];
        let (mut d_output, mut d_input) = (vec![0f32; TILE * width], vec![0f32; TILE * width]);
        let mut d_encoded = vec![0f32; TILE * position];
        let (g_colour, g_density) = gradient.split_at(if rays > 0 { 3 * n } else { 0 });
        for tile in tiles(n) {
            let size = tile.rows * width;
            let density = tile.of(g_density, 1);
            let dh = &mut d_output[..size];
            let trunk = lowest < depth || delta_layer == depth && wanted.delta;
            if rays > 0 {
                let colour = tile.of(g_colour, 3);
                let dv = &mut d_view[..tile.rows * (width / 2)];
                self.rgb.input_gradient(colour, 0, width / 2, dv, false);
                apply_mask(dv, tile.of(&kept.view_mask, width / 2));
                let df = &mut d_feature[..size];
                if trunk || wanted.weights {
                    self.view.input_gradient(dv, 0, width, df, false);
                }
                let views = &mut views[..tile.rows * direction];
                if wanted.weights {
                    self.rgb.weight_gradient(colour, tile.of(&kept.view, width / 2), 0, width / 2, weights);
                    self.rgb.bias_gradient(colour, weights);
                    spread(&kept.encoded_views, tile, samples, direction, views);
                    self.view.weight_gradient(dv, tile.of(&kept.feature, width), 0, width, weights);
                    self.view.weight_gradient(dv, views, width, direction, weights);
                    self.view.bias_gradient(dv, weights);
                    self.feature.weight_gradient(df, tile.of(&kept.hidden[depth - 1], width), 0, width, weights);
                    self.feature.bias_gradient(df, weights);
                }
                if wanted.viewdirs {
                    self.view.input_gradient(dv, width, direction, views, false);
                    gather(views, tile, samples, direction, &mut d_views);
                }
                if trunk {
                    self.feature.input_gradient(df, 0, width, dh, false);
                }
            }
            if wanted.weights {
                self.density.weight_gradient(density, tile.of(&kept.hidden[depth - 1], width), 0, width, weights);
                self.density.bias_gradient(density, weights);
            }
            if !trunk {
                continue;
            }
            self.density.input_gradient(density, 0, width, dh, rays > 0);
            let de = &mut d_encoded[..tile.rows * position];
            de.fill(0.0);
            for (l, layer) in self.trunk.iter().enumerate().rev() {
                if l + 1 == delta_layer && wanted.delta {
                    tile.of_mut(&mut out.delta, width).copy_from_slice(&d_output[..size]);
                }
                if l < lowest {
                    break;
                }
                let dz = &mut d_output[..size];
                apply_mask(dz, tile.of(&kept.masks[l], width));
                let skips = self.skips(l);
                let encodes = l == 0 || skips;
                let from = if skips { position } else { 0 };
                if wanted.weights {
                    if encodes {
                        layer.weight_gradient(dz, tile.of(&kept.encoded, position), 0, position, weights);
                    }
                    if l > 0 {
                        layer.weight_gradient(dz, tile.of(&kept.hidden[l - 1], width), from, width, weights);
                    }
                    layer.bias_gradient(dz, weights);
                }
                if encodes && wanted.points {
                    layer.input_gradient(dz, 0, position, de, true);
                }
                if l > 0 {
                    layer.input_gradient(dz, from, width, &mut d_input[..size], false);
                    std::mem::swap(&mut d_output, &mut d_input);
                }
            }
            if wanted.points {
                let encoded = tile.of(&kept.encoded, position);
                gradient_into(encoded, de, self.config.position_octaves, tile.of_mut(&mut out.points, 3));
            }
        }
        if wanted.viewdirs {
            gradient_into(&kept.encoded_views, &d_views, self.config.view_octaves, &mut out.viewdirs);
        }
        out
    }
}

/// Repeats each ray's row for its points within the tile.
fn spread(of_rays: &[f32], tile: Tile, samples: usize, columns: usize, out: &mut [f32]) {
    for (i, row) in out.chunks_exact_mut(columns).enumerate() {
        let ray = (tile.start + i) / samples;
        row.copy_from_slice(&of_rays[ray * columns..][..columns]);
    }
}

/// Adds the rows of a tile's points to those of their rays.
fn gather(of_points: &[f32], tile: Tile, samples: usize, columns: usize, sum: &mut [f32]) {
    for (i, row) in of_points.chunks_exact(columns).enumerate() {
        let ray = (tile.start + i) / samples;
        sum[ray * columns..][..columns].iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
}
