//! The way back of a pass.

use augnerf_nerf::perturb::PaperSite;
use augnerf_nerf::settings::OutputPlace;
use wgpu::Buffer;

use crate::device;
use crate::device::groups;
use crate::kernels::Kernel;
use crate::network::FieldBuffers;

use super::products::{Matrix, Rows, Through};
use super::scratch::LIVE_GROUP;
use super::{GradientAt, PassAt, Recorder, Wanted};

impl<'a> Recorder<'a> {
    /// Records the way back of the pass that was just recorded forward.
    pub(crate) fn back(&mut self, pass: &PassAt<'a>, wanted: Wanted) {
        let rows = Rows::Live(pass.points());
        let of_tables = wanted.weights && self.shape.grid.is_some();
        let of_encoding = of_tables || wanted.points();
        self.activate_back(pass);
        let below = wanted.weights || wanted.points() || wanted.feature;
        if !(below || wanted.view) {
            return;
        }
        self.list_live(pass, wanted, of_encoding);
        self.colour_back(pass, wanted, below);
        if below {
            let injection = pass.deltas.feature.map(|(_, layer)| layer);
            self.trunk_back(rows, pass.field, injection, wanted, of_encoding);
        }
        if wanted.weights {
            self.reduce(rows, pass.field, self.shape.weights());
        }
        if of_encoding {
            self.encoding_back(pass, wanted);
        }
    }

    fn activate_back(&mut self, pass: &PassAt<'a>) {
        let (scratch, deltas) = (self.scratch, pass.deltas);
        let params = self.output_params(pass);
        let mut buffers = vec![
            (1, &scratch.raw),
            (2, &scratch.head),
            (3, &scratch.d_values),
            (4, &scratch.d_raw),
            (5, &scratch.d_head),
        ];
        let [rgb, density] = [deltas.rgb.is_some(), deltas.density.is_some()].map(|on| on && deltas.before);
        if self.has_outside() {
            buffers.push((6, &scratch.inside));
        }
        buffers.extend(pass.noise.map(|noise| (7, noise)));
        if rgb {
            buffers.push((8, &scratch.used_rgb));
        }
        if density {
            buffers.push((9, &scratch.used_density));
        }
        let kernel = Kernel::new("activate_back").with("INSIDE", self.has_outside());
        let kernel = kernel.with("NOISE", pass.noise.is_some()).with("BEFORE_RGB", rgb).with("BEFORE_DENSITY", density);
        self.run(kernel, params, &buffers, groups(pass.points()));
    }

    /// Lists the samples with a gradient, and makes 0 what all samples have of the way back: the others are not written.
    fn list_live(&mut self, pass: &PassAt<'a>, wanted: Wanted, of_encoding: bool) {
        let (shape, scratch, points) = (self.shape, self.scratch, pass.points());
        let buffers = [(1, &scratch.d_raw), (2, &scratch.d_head), (3, &scratch.live_counts), (4, &scratch.live)];
        for (lists, buffers) in [(false, &buffers[..3]), (true, &buffers[..])] {
            let params = params! { points, columns: shape.width + 4 };
            self.run(
                Kernel::new("live").with("LIST", lists),
                params,
                buffers,
                device::rows(points.div_ceil(LIVE_GROUP)),
            );
        }
        for (is_wanted, buffer, columns) in [
            (of_encoding, &scratch.d_encoded, shape.channels),
            (wanted.feature, &scratch.d_feature, shape.width),
            (wanted.view, &scratch.d_view, shape.view_channels),
        ] {
            if is_wanted {
                let numbers = points * columns;
                self.run(Kernel::new("zero"), params! { numbers }, &[(1, buffer)], groups(numbers));
            }
        }
    }

    /// From the raw colour to the head, and to the encoding of view directions.
    fn colour_back(&mut self, pass: &PassAt<'a>, wanted: Wanted, below: bool) {
        let (shape, scratch, rows) = (self.shape, self.scratch, Rows::Live(pass.points()));
        let mut d = Matrix::new(&scratch.d_raw, 4);
        let mut layer = shape.rgb;
        let mut next = 0;
        for i in (0..=shape.view.len()).rev() {
            let input = self.view_input(i, pass.samples, rows);
            if wanted.weights {
                self.dense_weights(rows, layer, input, d);
            }
            if i > 0 {
                let to = self.of_layer(&scratch.d_hidden, next, rows);
                let c = (to, shape.view_width);
                let through = Through { mask: Some(self.hidden(&scratch.view[i - 1], rows)), ..Through::default() };
                self.dense_back(rows, pass.field, layer, 0..shape.view_width, d, c, through);
                d = Matrix::new(to, shape.view_width);
                next = 1 - next;
                layer = shape.view[i - 1];
            }
        }
        if below {
            let c = ((&scratch.d_head).into(), shape.width + 4);
            self.dense_back(rows, pass.field, layer, 0..shape.width, d, c, Through::default());
        }
        if wanted.view {
            let inputs = shape.width..shape.width + shape.view_channels;
            let c = ((&scratch.d_view).into(), shape.view_channels);
            self.dense_back(rows, pass.field, layer, inputs, d, c, Through::default());
            let (octaves, channels) = (shape.view_octaves, shape.view_channels);
            let params = params! { rays: pass.rays, octaves, channels, ray0: pass.ray0, samples: pass.samples };
            let tilt = pass.deltas.view.expect("a gradient of a delta that is there");
            let buffers =
                [(1, self.rays), (2, &scratch.view_encoded), (3, &scratch.d_view), (4, tilt), (5, &scratch.d_tilt)];
            self.run(Kernel::new("view_back"), params, &buffers, groups(pass.rays));
        }
    }

    /// From the head down the trunk: to the layer of a delta, or to the encoding.
    pub(super) fn trunk_back(
        &mut self,
        rows: Rows,
        field: &FieldBuffers,
        injection: Option<usize>,
        wanted: Wanted,
        of_encoding: bool,
    ) {
        let (shape, scratch) = (self.shape, self.scratch);
        let lowest = if wanted.weights || of_encoding { 0 } else { injection.unwrap_or(0) };
        let mut d = Matrix::new(&scratch.d_head, shape.width + 4);
        let mut layer = shape.head;
        let mut adds = false;
        for i in (0..=shape.trunk.len()).rev() {
            let input = self.trunk_input(i, injection, rows);
            if wanted.weights {
                self.dense_weights(rows, layer, input, d);
            }
            if of_encoding && (i == 0 || i < shape.trunk.len() && shape.skips_to(i)) {
                let c = ((&scratch.d_encoded).into(), shape.channels);
                let through = Through { adds, ..Through::default() };
                self.dense_back(rows, field, layer, 0..shape.channels, d, c, through);
                adds = true;
            }
            if i == 0 {
                break;
            }
            let to = self.of_layer(&scratch.d_trunk, i - 1, rows);
            let open = (wanted.feature && injection == Some(i)).then_some(&scratch.d_feature);
            let is_top = i == shape.trunk.len();
            if is_top || !self.has_trunks(rows) {
                let from = if !is_top && shape.skips_to(i) { shape.channels } else { 0 };
                let through = Through { mask: Some(self.of_layer(&scratch.trunk, i - 1, rows)), adds: false, open };
                self.dense_back(rows, field, layer, from..from + shape.width, d, (to, shape.width), through);
            }
            if lowest == i {
                break;
            }
            if is_top && self.has_trunks(rows) {
                let open = injection.filter(|layer| wanted.feature && *layer < i);
                // What weights or encodings have a gradient by is kept.
                let is_kept = |layer: &usize| wanted.weights || of_encoding && (*layer == 0 || shape.skips_to(*layer));
                self.all_layers_back(rows, field, lowest.max(1), open, &(0..i - 1).filter(is_kept).collect::<Vec<_>>());
            }
            d = Matrix::new(to, shape.width);
            layer = shape.trunk[i - 1];
        }
    }

    /// Where the gradient of a site's delta is after the way back.
    pub(crate) fn gradient_of(&self, site: PaperSite, place: OutputPlace) -> GradientAt<'a> {
        let (scratch, width) = (self.scratch, self.shape.width);
        match (site, place) {
            (PaperSite::T, _) => (&scratch.d_t, 1, 0),
            (PaperSite::Xyz, _) => (&scratch.d_points, 3, 0),
            (PaperSite::View, _) => (&scratch.d_tilt, 2, 0),
            (PaperSite::Feature, _) => (&scratch.d_feature, width, 0),
            (PaperSite::Rgb, OutputPlace::After) => (&scratch.d_values, 4, 0),
            (PaperSite::Density, OutputPlace::After) => (&scratch.d_values, 4, 3),
            (PaperSite::Rgb, OutputPlace::Before) => (&scratch.d_raw, 4, 0),
            (PaperSite::Density, OutputPlace::Before) => (&scratch.d_head, width + 4, width),
        }
    }

    /// The positions of the last pass with a delta of `t`.
    pub(crate) fn moved_t_vals(&self) -> &'a Buffer {
        &self.scratch.t_moved
    }

    /// Where the deltas of the output level are as the last pass used them.
    pub(crate) fn used(&self, site: PaperSite) -> Option<&'a Buffer> {
        match site {
            PaperSite::Rgb => Some(&self.scratch.used_rgb),
            PaperSite::Density => Some(&self.scratch.used_density),
            PaperSite::T | PaperSite::Xyz | PaperSite::View | PaperSite::Feature => None,
        }
    }
}
