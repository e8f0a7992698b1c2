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
        params! { m, layers, channels, skips: bits((0..layers).filter(|i| shape.skips_to(*i))), of_layer, end }
    }

    /// Records a kernel of all layers, and counts its work: the inputs of these layers, and the bytes that a row reads and leaves.
    fn run_trunk(
        &mut self,
        kernel: Kernel,
        rows: Rows,
        params: Params,
        buffers: &[(u32, &Buffer)],
        (inputs, bytes_of_row): (usize, usize),
    ) {
        let (width, rows_of_group) = (self.shape.width, self.form.trunk_rows.expect("a device that has it"));
        let kernel = kernel.set("WIDTH", width).set("ROWS", rows_of_group);
        self.run(kernel, params, buffers, device::rows(rows.count().div_ceil(rows_of_group)));
        let work = &mut self.dispatches.last_mut().expect("just recorded").work;
        work.multiply_adds = (rows.count() * inputs * width) as u64;
        work.product_bytes = (2 * inputs * width + rows.count() * bytes_of_row) as u64;
    }

    /// Records all layers, with a delta after one.
    pub(super) fn all_layers(&mut self, rows: Rows, field: &FieldBuffers, feature: Option<(&Buffer, usize)>) {
        let (scratch, shape, layers) = (self.scratch, self.shape, self.shape.trunk.len());
        let injection = feature.map_or(0, |(_, layer)| layer);
        let params = self.trunk_params(rows).and(params! { injection, lowest: 0usize, kept: 0usize });
        let weights = field.halves.as_ref().expect("weights in f16");
        let mut buffers = vec![(1, &scratch.encoded), (3, weights), (4, &scratch.trunk.buffers[0])];
        buffers.extend(feature.iter().flat_map(|(delta, _)| [(5, *delta), (6, &scratch.moved)]));
        let inputs: usize = shape.trunk.iter().map(|layer| layer.inputs).sum();
        let bytes_of_row = 4 * (inputs - (layers - 1) * shape.width) + 2 * layers * shape.width;
        let kernel = Kernel::new("trunk").with("DELTA", feature.is_some());
        self.run_trunk(kernel, rows, params, &buffers, (inputs, bytes_of_row));
    }

    /// Records the way back through all layers above the lowest one, from 1, from the gradient of what the last one leaves. `open`
    /// names the layer whose output's gradient is left before its ReLU. Those of `kept` are left after it.
    pub(super) fn all_layers_back(
        &mut self,
        rows: Rows,
        field: &FieldBuffers,
        lowest: usize,
        open: Option<usize>,
        kept: &[usize],
    ) {
        let (scratch, width) = (self.scratch, self.shape.width);
        let inputs = (self.shape.trunk.len() - lowest) * width;
        if inputs == 0 {
            return;
        }
        let params = self.trunk_params(rows);
        let params = params.and(params! { injection: open.unwrap_or(0), lowest, kept: bits(kept.iter().copied()) });
        let weights = field.halves.as_ref().expect("weights in f16");
        let mut buffers = vec![(3, weights), (4, &scratch.d_trunk.buffers[0]), (5, &scratch.trunk.buffers[0])];
        buffers.extend(open.is_some().then_some((6, &scratch.d_feature)));
        buffers.extend(self.live(rows).map(|live| (7, live)));
        let kernel = Kernel::new("trunk_back").with("OPEN", open.is_some()).with("LIVE", self.live(rows).is_some());
        self.run_trunk(kernel, rows, params, &buffers, (inputs, 2 * (1 + kept.len()) * width));
    }
}

/// Returns a number with a bit for each of some layers.
fn bits(layers: impl Iterator<Item = usize>) -> usize {
    layers.fold(0, |bits, layer| {
        assert!(layer < 32, "a bit of a word");
        bits | 1 << layer
    })
}
