//! All layers of a trunk in one kernel, on matrix units.

use wgpu::Buffer;

use crate::device;
use crate::kernels::Kernel;
use crate::network::FieldBuffers;
use crate::params::Params;

use super::Recorder;
use super::products::Rows;

impl<'a> Recorder<'a> {
    /// Whether one kernel computes all layers of the trunk.
    pub(super) fn has_trunks(&self, rows: Rows) -> bool {
        self.form.trunk_rows.is_some() && !rows.are_jets()
    }

    fn trunk_params(&self, rows: Rows) -> Params {
        let (shape, of_layer) = (self.shape, self.scratch.trunk.bytes as usize / 8);
        let (m, layers, channels, end) = (rows.count(), shape.trunk.len(), shape.channels, shape.head.offset);
        let skips = (0..layers).filter(|i| shape.skips_to(*i)).fold(0, |skips, i| skips | 1 << i);
        params! { m, layers, channels, skips, of_layer, end }
    }

    /// Records a kernel of all layers from `lowest` on, and counts its work: what it multiplies, and weights, encodings and hidden
    /// values once.
    fn run_trunk(&mut self, name: &'static str, rows: Rows, lowest: usize, params: Params, more: Vec<(u32, &Buffer)>) {
        let (shape, rows_of_group) = (self.shape, self.form.trunk_rows.expect("a device that has it"));
        let kernel = Kernel::new(name).set("WIDTH", shape.width).set("ROWS", rows_of_group);
        let kernel = kernel.with("LIVE", more.iter().any(|(binding, _)| *binding == 7));
        let kernel = kernel.with(if name == "trunk" { "DELTA" } else { "OPEN" }, more.iter().any(|(at, _)| *at == 6));
        self.run(kernel, params, &more, device::rows(rows.count().div_ceil(rows_of_group)));
        let (rows, layers) = (rows.count(), shape.trunk.len() - lowest);
        let inputs = match lowest {
            0 => shape.trunk.iter().map(|layer| layer.inputs).sum(),
            // The way back to encodings are products of their own.
            _ => layers * shape.width,
        };
        let work = &mut self.dispatches.last_mut().expect("just recorded").work;
        work.multiply_adds = (rows * inputs * shape.width) as u64;
        work.product_bytes =
            (2 * inputs * shape.width + 2 * rows * layers * shape.width + 4 * rows * shape.channels) as u64;
    }

    /// Records all layers, with a delta after one.
    pub(super) fn all_layers(&mut self, rows: Rows, field: &FieldBuffers, feature: Option<(&Buffer, usize)>) {
        let scratch = self.scratch;
        let injection = feature.map_or(0, |(_, layer)| layer);
        let params = self.trunk_params(rows).and(params! { injection, lowest: 0usize });
        let weights = field.halves.as_ref().expect("weights in f16");
        let mut buffers = vec![(1, &scratch.encoded), (3, weights), (4, &scratch.trunk.buffers[0])];
        buffers.extend(feature.iter().flat_map(|(delta, _)| [(5, *delta), (6, &scratch.moved)]));
        self.run_trunk("trunk", rows, 0, params, buffers);
    }

    /// Records the way back through all layers above the lowest one, from 1, from the gradient of what the last one leaves. `open`
    /// names the layer whose output's gradient is kept before its ReLU.
    pub(super) fn all_layers_back(&mut self, rows: Rows, field: &FieldBuffers, lowest: usize, open: Option<usize>) {
        if lowest == self.shape.trunk.len() {
            return;
        }
        let scratch = self.scratch;
        let params = self.trunk_params(rows).and(params! { injection: open.unwrap_or(0), lowest });
        let weights = field.halves.as_ref().expect("weights in f16");
        let mut buffers = vec![(3, weights), (4, &scratch.d_trunk.buffers[0]), (5, &scratch.trunk.buffers[0])];
        buffers.extend(open.is_some().then_some((6, &scratch.d_feature)));
        buffers.extend(self.live(rows).map(|live| (7, live)));
        self.run_trunk("trunk_back", rows, lowest, params, buffers);
    }
}
