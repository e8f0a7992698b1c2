//! Forward on tiles of points, with what the backward pass needs kept.

use super::encode::{encode_positions, encode_tile};
use super::kernels::{add, add_of_rays_relu};
use super::layout::{Network, TILE, Tile, tiles};
use super::pool::Buffer;

/// What a forward pass is queried with.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// `[n, 3]`, or Gaussians `[n, 6]`.
    pub points: &'a [f32],
    /// `[rays, 3]`, unit; every ray has the same number of points. Empty: density alone is queried.
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

/// What a backward pass will be asked for.
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
    pub(super) encoded: Buffer<f32>,
    pub(super) encoded_views: Buffer<f32>,
    /// Each trunk layer's output, delta included.
    pub(super) hidden: Vec<Buffer<f32>>,
    /// Where each trunk layer's output was positive.
    pub(super) masks: Vec<Buffer<u8>>,
    pub(super) view: Buffer<f32>,
    pub(super) view_mask: Buffer<u8>,
}

/// Room for a tile, where nothing is kept.
struct Rooms {
    encoded: Buffer<f32>,
    /// Trunk layers take turns in these.
    layers: [Buffer<f32>; 2],
    view: Buffer<f32>,
}

impl Rooms {
    fn new(width: usize, position: usize) -> Rooms {
        let layers = [Buffer::new(TILE * width), Buffer::new(TILE * width)];
        Rooms { encoded: Buffer::new(TILE * position), layers, view: Buffer::new(TILE * width / 2) }
    }
}

impl Network {
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

    /// Raw colours `[n, 3]` followed by raw densities `[n]`, or raw densities alone; and what a backward pass for
    /// `wanted` needs.
    pub fn forward(&self, inputs: Inputs, wanted: Wanted) -> (Vec<f32>, Kept) {
        let n = inputs.points.len() / self.code().inputs();
        let (width, position) = (self.width(), self.position_channels());
        let rays = inputs.viewdirs.len() / 3;
        let samples = n.checked_div(rays).unwrap_or(0);
        let colours = if rays > 0 { 3 * n } else { 0 };
        let mut raw = vec![0f32; colours + n];
        let mut kept = self.kept(n, rays, wanted);
        encode_tile(inputs.viewdirs, self.config.view_octaves, &mut kept.encoded_views);
        let mut rooms = Rooms::new(width, position);
        let of_rays = self.view_of_rays(&kept.encoded_views, rays);
        let (raw_colour, raw_density) = raw.split_at_mut(colours);
        for tile in tiles(n) {
            self.encode_and_trunk(inputs, wanted, tile, &mut kept, &mut rooms);
            let last = match kept.hidden.last().filter(|_| wanted.weights) {
                Some(hidden) => tile.of(hidden, width),
                None => &rooms.layers[(self.depth() - 1) % 2][..tile.rows * width],
            };
            self.density.forward(last, tile.of_mut(raw_density, 1));
            if rays == 0 {
                continue;
            }
            let view = match wanted.weights {
                true => tile.of_mut(&mut kept.view, width / 2),
                false => &mut rooms.view[..tile.rows * (width / 2)],
            };
            self.view.forward(last, 0, width, view, false);
            let mask = wanted.any().then(|| tile.of_mut(&mut kept.view_mask, width / 2));
            add_of_rays_relu(view, &of_rays, width / 2, (tile.start, samples), mask);
            self.rgb.forward(view, tile.of_mut(raw_colour, 3));
        }
        (raw, kept)
    }

    /// Room for what a backward pass for `wanted` needs of `n` points on `rays` rays.
    fn kept(&self, n: usize, rays: usize, wanted: Wanted) -> Kept {
        let (width, depth) = (self.width(), self.depth());
        let whole = |wanted: bool, size: usize| Buffer::new(if wanted { n * size } else { 0 });
        let mask = |size: usize| Buffer::new(if wanted.any() { n * size } else { 0 });
        Kept {
            encoded: whole(wanted.weights || wanted.points, self.position_channels()),
            encoded_views: Buffer::new(rays * self.view_channels()),
            hidden: (0..depth).map(|_| whole(wanted.weights, width)).collect(),
            masks: (0..depth).map(|_| mask(width)).collect(),
            view: whole(wanted.weights && rays > 0, width / 2),
            view_mask: if rays > 0 { mask(width / 2) } else { Buffer::default() },
        }
    }

    /// Encoding and trunk of a tile. Its last layer is left where it is kept, or in the rooms.
    fn encode_and_trunk(&self, inputs: Inputs, wanted: Wanted, tile: Tile, kept: &mut Kept, rooms: &mut Rooms) {
        let (width, depth, position) = (self.width(), self.depth(), self.position_channels());
        let encoded = match inputs.prefix {
            Some(prefix) => tile.of(&prefix.encoded, position),
            None => {
                let encoded = match kept.encoded.is_empty() {
                    true => &mut rooms.encoded[..tile.rows * position],
                    false => tile.of_mut(&mut kept.encoded, position),
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
                let [a, b] = &mut rooms.layers;
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
    }
}
