//! The forward pass on tiles of points, which keeps what the backward pass needs.

use super::encode::{encode_positions, encode_tile};
use super::kernels::head_forward;
use super::kernels::panels::{Form, Masks, Panels, PanelsMut, Slab};
use super::kernels::product::{Bias, Finish, Lhs, Rows, Source};
use super::layout::{Network, TILE, Tile, tiles};
use super::pool::Buffer;

/// The inputs of a forward pass.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// `[n, 3]`, or Gaussians `[n, 6]`.
    pub points: &'a [f32],
    /// `[rays, 3]`, unit. Every ray has the same number of points. Empty: only density is computed.
    pub viewdirs: &'a [f32],
    /// Trunk layer (1-based), and the delta of its output, `[n, width]`.
    pub delta: Option<(usize, &'a [f32])>,
    /// The trunk up to the delta's layer, from an earlier pass with the same points.
    pub prefix: Option<&'a Prefix>,
}

/// The trunk's lower part at some points, the same for every delta above it.
pub struct Prefix {
    encoded: Buffer<f32>,
    /// Output of the delta's layer, or of the last one, without the delta.
    hidden: Slab,
}

/// The gradients that a backward pass will be asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    pub weights: bool,
    pub points: bool,
    pub viewdirs: bool,
    pub delta: bool,
}

impl Outputs {
    fn any(self) -> bool {
        self != Outputs::default()
    }
}

/// What a forward pass keeps for the backward pass. What the requested gradients do not need is empty.
#[derive(Default)]
pub struct Kept {
    pub(super) encoded: Buffer<f32>,
    pub(super) encoded_views: Buffer<f32>,
    /// Each trunk layer's output, including the delta.
    pub(super) hidden: Vec<Slab>,
    /// Where each trunk layer's output was positive.
    pub(super) masks: Vec<Masks>,
    /// The same for the layers above the trunk.
    pub(super) views: Vec<Slab>,
    pub(super) view_masks: Vec<Masks>,
}

/// Space for a tile's layers in the layout of products. The layers alternate.
struct Rooms {
    encoded: Buffer<f32>,
    trunk: [Slab; 2],
    views: [Slab; 2],
    /// The delta, if it is bf16. It has a product of its own, since rounding would lose it in the sum.
    delta: Slab,
}

/// The input of a layer from the one below: its output and, if it is bf16, the delta.
struct LayerInput<'a>([Panels<'a>; 2], usize);

impl<'a> LayerInput<'a> {
    fn parts(&self) -> &[Panels<'a>] {
        &self.0[..self.1]
    }
}

/// Returns the targets of a layer's output: as the left side of bf16, and as f32 or in the layout of weight gradients.
pub(super) fn targets<'a>(
    room: &'a mut Slab,
    kept: &'a mut Slab,
    start: usize,
) -> (Option<PanelsMut<'a>>, Option<PanelsMut<'a>>) {
    let kept_rows = |kept: &'a mut Slab| (!kept.is_empty()).then(|| kept.rows_mut(start));
    match room.form() {
        Form::Across => (Some(room.rows_mut(0)), kept_rows(kept)),
        _ if kept.is_empty() => (None, Some(room.rows_mut(0))),
        _ => (None, kept_rows(kept)),
    }
}

/// Returns the layer's output in the layout of products.
fn lhs_of<'a>(room: &'a Slab, kept: &'a Slab, start: usize) -> Panels<'a> {
    if room.form() == Form::Across || kept.is_empty() { room.rows(0) } else { kept.rows(start) }
}

impl Network {
    fn rooms(&self, with_delta: bool) -> Rooms {
        let (width, view) = (self.width(), self.views[0].linear.outputs());
        let delta = if with_delta && self.pairs() { self.lhs(TILE, width) } else { Slab::default() };
        Rooms {
            encoded: Buffer::new(TILE * self.position_channels()),
            trunk: [self.lhs(TILE, width), self.lhs(TILE, width)],
            views: [self.lhs(TILE, view), self.lhs(TILE, view)],
            delta,
        }
    }

    /// Computes the trunk up to layer `layer` (1-based) at points `[n, 3]`.
    pub fn prefix(&self, points: &[f32], layer: usize) -> Prefix {
        let n = points.len() / self.code().inputs();
        let (width, position) = (self.width(), self.position_channels());
        let mut prefix = Prefix { encoded: Buffer::new(n * position), hidden: self.lhs(n, width) };
        let mut rooms = [self.lhs(TILE, width), self.lhs(TILE, width)];
        for tile in tiles(n) {
            let encoded = tile.of_mut(&mut prefix.encoded, position);
            encode_positions(self.code(), tile.of(points, self.code().inputs()), encoded);
            for l in 0..layer {
                let [a, b] = &mut rooms;
                let (below, output) = if l % 2 == 0 { (&*b, a) } else { (&*a, b) };
                let to = if l + 1 == layer { prefix.hidden.rows_mut(tile.start) } else { output.rows_mut(0) };
                let (across, panels) = if self.pairs() { (Some(to), None) } else { (None, Some(to)) };
                let finish = Finish { across, panels, ..Finish::default() };
                self.trunk_layer(l, encoded, &[below.rows(0)], tile.rows, finish);
            }
        }
        prefix
    }

    /// Computes trunk layer `l` (from 0) of a tile, with its ReLU, from the encoding and the parts of the layer below.
    fn trunk_layer(&self, l: usize, encoded: &[f32], below: &[Panels], rows: usize, finish: Finish) {
        let layer = &self.trunk[l];
        let encoded = layer.encoded.iter().map(|weights| Source { lhs: Lhs::Rows(encoded), weights });
        let below =
            below.iter().flat_map(|part| layer.below.iter().map(|weights| Source { lhs: Lhs::Panels(*part), weights }));
        let sources: Vec<Source> = encoded.chain(below).collect();
        let bias = Some(Bias { values: &layer.bias, of_rays: (0, 0) });
        Rows::Products(&sources).finish(rows, self.width(), Finish { bias, relu: true, ..finish });
    }

    /// Returns raw colours `[n, 3]` followed by raw densities `[n]`, or only raw densities. Also returns what a
    /// backward pass for `wanted` needs.
    pub fn forward(&self, inputs: Inputs, wanted: Outputs) -> (Vec<f32>, Kept) {
        let n = inputs.points.len() / self.code().inputs();
        let rays = inputs.viewdirs.len() / 3;
        let samples = n.checked_div(rays).unwrap_or(0);
        let colours = if rays > 0 { 3 * n } else { 0 };
        let mut raw = vec![0f32; colours + n];
        let mut kept = self.kept(n, rays, wanted);
        encode_tile(inputs.viewdirs, self.architecture.view_octaves, &mut kept.encoded_views);
        let mut rooms = self.rooms(inputs.delta.is_some());
        let of_rays = self.view_of_rays(&kept.encoded_views, rays);
        let (raw_colour, raw_density) = raw.split_at_mut(colours);
        for tile in tiles(n) {
            self.encode(inputs, tile, &mut kept, &mut rooms);
            self.trunk(inputs, wanted, tile, &mut kept, &mut rooms);
            let top = self.depth() - 1;
            let output = (&rooms.trunk[top % 2], &kept.hidden[top]);
            let last = self.below(top + 1, inputs, output, &rooms.delta, tile);
            head_forward(&self.density.head, last.parts(), tile.of_mut(raw_density, 1));
            if rays > 0 {
                let bias = Bias { values: &of_rays, of_rays: (tile.start, samples) };
                let views = (&mut kept.views[..], &mut kept.view_masks[..], &mut rooms.views);
                self.colour(last.parts(), bias, wanted, tile, views, tile.of_mut(raw_colour, 3));
            }
        }
        (raw, kept)
    }

    /// Computes raw colours of a tile through the layers above the trunk. `bias` is added by the first of them.
    fn colour(
        &self,
        last: &[Panels],
        bias: Bias,
        wanted: Outputs,
        tile: Tile,
        (kept, masks, rooms): (&mut [Slab], &mut [Masks], &mut [Slab; 2]),
        raw: &mut [f32],
    ) {
        for (i, layer) in self.views.iter().enumerate() {
            let [a, b] = &mut *rooms;
            let (room, output) = if i % 2 == 0 { (&*b, a) } else { (&*a, b) };
            let (kept_below, from_here) = kept.split_at_mut(i);
            let below = kept_below.last().map(|kept| [lhs_of(room, kept, tile.start)]);
            let sources: Vec<Source> = below
                .as_ref()
                .map_or(last, |below| below)
                .iter()
                .flat_map(|part| layer.below.iter().map(|weights| Source { lhs: Lhs::Panels(*part), weights }))
                .collect();
            let bias = if i == 0 { bias } else { Bias { values: &layer.bias, of_rays: (0, 0) } };
            let positive = wanted.any().then(|| masks[i].rows_mut(tile.start));
            let (across, panels) = targets(output, &mut from_here[0], tile.start);
            let finish = Finish { bias: Some(bias), relu: true, positive, across, panels, ..Finish::default() };
            Rows::Products(&sources).finish(tile.rows, layer.linear.outputs(), finish);
        }
        let top = self.views.len() - 1;
        let view = lhs_of(&rooms[top % 2], &kept[top], tile.start);
        head_forward(&self.rgb.head, &[view], raw);
    }

    /// Allocates what a backward pass for `wanted` needs of `n` points on `rays` rays.
    fn kept(&self, n: usize, rays: usize, wanted: Outputs) -> Kept {
        let (width, depth) = (self.width(), self.depth());
        let rows = |wanted: bool| if wanted { n } else { 0 };
        let views = || self.views.iter().map(|layer| layer.linear.outputs());
        Kept {
            encoded: Buffer::new(rows(wanted.weights || wanted.points) * self.position_channels()),
            encoded_views: Buffer::new(rays * self.view_channels()),
            hidden: (0..depth).map(|_| self.rhs(rows(wanted.weights), width)).collect(),
            masks: (0..depth).map(|_| Masks::new(Form::Single, rows(wanted.any()), width)).collect(),
            views: views().map(|width| self.rhs(rows(wanted.weights && rays > 0), width)).collect(),
            view_masks: views().map(|width| Masks::new(Form::Single, rows(wanted.any() && rays > 0), width)).collect(),
        }
    }

    /// Computes the encoding of a tile, in the kept tensor or in its space, unless there is an earlier pass.
    fn encode(&self, inputs: Inputs, tile: Tile, kept: &mut Kept, rooms: &mut Rooms) {
        if inputs.prefix.is_some() {
            return;
        }
        let position = self.position_channels();
        let encoded = match kept.encoded.is_empty() {
            true => &mut rooms.encoded[..tile.rows * position],
            false => tile.of_mut(&mut kept.encoded, position),
        };
        encode_positions(self.code(), tile.of(inputs.points, self.code().inputs()), encoded);
    }

    /// Returns the input of layer `l` from the layer below, whose output is in its space or kept.
    fn below<'a>(
        &self,
        l: usize,
        inputs: Inputs<'a>,
        (room, kept): (&'a Slab, &'a Slab),
        delta: &'a Slab,
        tile: Tile,
    ) -> LayerInput<'a> {
        let hidden = match inputs.prefix.filter(|_| self.pairs() && l == self.first_layer(inputs) + 1) {
            Some(prefix) => prefix.hidden.rows(tile.start),
            None => lhs_of(room, kept, tile.start),
        };
        match self.pairs() && inputs.delta.is_some_and(|(layer, _)| layer == l) {
            true => LayerInput([hidden, delta.rows(0)], 2),
            false => LayerInput([hidden; 2], 1),
        }
    }

    /// Returns the first trunk layer (from 0) whose output a pass needs.
    fn first_layer(&self, inputs: Inputs) -> usize {
        match inputs.prefix {
            Some(_) => inputs.delta.map_or(self.depth(), |(layer, _)| layer) - 1,
            None => 0,
        }
    }

    /// Computes the trunk of a tile. Its last layer is left in the kept tensor, or in its space.
    fn trunk(&self, inputs: Inputs, wanted: Outputs, tile: Tile, kept: &mut Kept, rooms: &mut Rooms) {
        let (width, position, first) = (self.width(), self.position_channels(), self.first_layer(inputs));
        let encoded = match inputs.prefix {
            Some(prefix) => tile.of(&prefix.encoded, position),
            None if kept.encoded.is_empty() => &rooms.encoded[..tile.rows * position],
            None => tile.of(&kept.encoded, position),
        };
        for l in first..self.depth() {
            let delta = inputs.delta.filter(|(at, _)| *at == l + 1).map(|(_, delta)| tile.of(delta, width));
            let [a, b] = &mut rooms.trunk;
            let (room, output) = if l % 2 == 0 { (&*b, a) } else { (&*a, b) };
            let (kept_below, from_here) = kept.hidden.split_at_mut(l);
            let (across, panels) = targets(output, &mut from_here[0], tile.start);
            match inputs.prefix.filter(|_| l == first) {
                // In bf16 it is read in place.
                Some(_) if self.pairs() => {}
                Some(prefix) => {
                    let finish = Finish { delta, panels, ..Finish::default() };
                    Rows::Panels(prefix.hidden.rows(tile.start)).finish(tile.rows, width, finish);
                }
                None => {
                    let below = kept_below.last().map(|kept| self.below(l, inputs, (room, kept), &rooms.delta, tile));
                    let positive = wanted.any().then(|| kept.masks[l].rows_mut(tile.start));
                    let finish = Finish { positive, delta, across, panels, ..Finish::default() };
                    self.trunk_layer(l, encoded, below.as_ref().map_or(&[], LayerInput::parts), tile.rows, finish);
                }
            }
            if let Some(delta) = delta.filter(|_| self.pairs()) {
                let across = Some(rooms.delta.rows_mut(0));
                Rows::Given(delta).finish(tile.rows, width, Finish { across, ..Finish::default() });
            }
        }
    }
}
