//! A pass forward.

use augnerf_nerf::settings::Contraction;
use wgpu::Buffer;

use crate::device::{groups, rows};
use crate::kernels::Kernel;
use crate::network::FieldBuffers;
use crate::params::Params;

use super::products::{Matrix, Output, Rows};
use super::{ON_RAYS, Outputs, PassAt, PassLoss, Recorder};

impl<'a> Recorder<'a> {
    /// Whether points can be outside of where density is.
    pub(super) fn has_outside(&self) -> bool {
        self.shape.domain.is_some_and(|domain| domain.contraction() == Contraction::None)
    }

    /// The input of layer `i` of the trunk, from 0, with the layer below as a delta after layer `injection` moved it.
    pub(super) fn trunk_input(
        &self,
        i: usize,
        injection: Option<usize>,
        rows: Rows,
    ) -> (Matrix<'a>, Option<Matrix<'a>>) {
        let (scratch, shape) = (self.scratch, self.shape);
        let encoded = Matrix::new(&scratch.encoded, shape.channels);
        if i == 0 {
            return (encoded, None);
        }
        let below = match injection {
            Some(layer) if layer == i => self.hidden(&scratch.moved, rows),
            _ => self.of_layer(&scratch.trunk, i - 1, rows),
        };
        let hidden = Matrix::new(below, shape.width);
        if i < shape.trunk.len() && shape.skips_to(i) { (encoded, Some(hidden)) } else { (hidden, None) }
    }

    /// Records the trunk, with a delta after a layer.
    pub(super) fn trunk(&mut self, rows: Rows, field: &FieldBuffers, feature: Option<(&Buffer, usize)>) {
        if self.has_trunks(rows) {
            return self.all_layers(rows, field, feature);
        }
        let (shape, scratch) = (self.shape, self.scratch);
        let injection = feature.map(|(_, layer)| layer);
        for (i, layer) in shape.trunk.iter().enumerate() {
            let input = self.trunk_input(i, injection, rows);
            let delta = feature.filter(|(_, at)| *at == i + 1);
            let delta = delta.map(|(delta, _)| (delta, self.hidden(&scratch.moved, rows)));
            let c = Output { numbers: self.of_layer(&scratch.trunk, i, rows), stride: shape.width, first: 0 };
            self.dense(rows, field, *layer, 0..shape.width, input, c, true, delta);
        }
    }

    /// Records the trunk and the head's density alone.
    pub(super) fn raw_density(&mut self, rows: Rows, field: &FieldBuffers) {
        let (shape, scratch) = (self.shape, self.scratch);
        self.trunk(rows, field, None);
        let last = self.trunk_input(shape.trunk.len(), None, rows).0;
        let columns = shape.width..shape.width + 4;
        let c = Output { numbers: (&scratch.head).into(), stride: shape.width + 4, first: shape.width };
        self.dense(rows, field, shape.head, columns, (last, None), c, false, None);
    }

    /// Records the weights of samples from the field's density alone.
    pub(crate) fn place_by_density(&mut self, pass: &PassAt<'a>) {
        let t_vals = self.place(pass);
        self.raw_density(Rows::Samples(pass.points()), pass.field);
        self.density_of_head(pass.points());
        self.march(pass, t_vals, None);
    }

    pub(super) fn output_params(&self, pass: &PassAt) -> Params {
        let Outputs { activation, padding, limit } = self.outputs;
        let deltas = &pass.deltas;
        let (rgb_radius, rgb_ball) = deltas.rgb.map_or((0.0, false), |(_, radius, ball)| (radius, ball));
        let (density_radius, masks_last) = deltas.density.map_or((0.0, false), |(_, radius, masks)| (radius, masks));
        let (points, samples, columns, before) = (pass.points(), pass.samples, self.shape.width + 4, deltas.before);
        let of_field = params! { columns, activation, padding, limit };
        of_field.and(params! { points, samples, rgb_radius, rgb_ball, density_radius, masks_last, before })
    }

    /// Records density without noise and deltas.
    pub(super) fn density_of_head(&mut self, points: usize) {
        let scratch = self.scratch;
        let params = params! { points, columns: self.shape.width + 4, activation: self.outputs.activation };
        let mut buffers = vec![(2, &scratch.head), (3, &scratch.density)];
        if self.has_outside() {
            buffers.push((4, &scratch.inside));
        }
        let kernel = Kernel::new("density").with("INSIDE", self.has_outside());
        self.run(kernel, params, &buffers, groups(points));
    }

    /// Records weights, or accumulation without noise into `out`.
    fn march(&mut self, pass: &PassAt<'a>, t_vals: &Buffer, out: Option<&Buffer>) {
        let scratch = self.scratch;
        let params = params! { rays: pass.rays, samples: pass.samples, columns: pass.columns, ray0: pass.ray0 };
        let kernel = Kernel::new("march").with("WEIGHTS", out.is_none()).with("ACC", out.is_some());
        let mut buffers = vec![(1, self.rays), (2, t_vals), (3, &scratch.density)];
        buffers.push(out.map_or((4, &scratch.weights), |out| (5, out)));
        self.run(kernel, params, &buffers, rows(pass.rays));
    }

    /// Records a pass forward, and its loss with what the way back starts from.
    pub(crate) fn forward(&mut self, pass: &PassAt<'a>, loss: Option<PassLoss>) {
        let (shape, scratch, rows) = (self.shape, self.scratch, Rows::Samples(pass.points()));
        let t_vals = self.place(pass);
        let params =
            params! { rays: pass.rays, octaves: shape.view_octaves, channels: shape.view_channels, ray0: pass.ray0 };
        let mut buffers = vec![(1, self.rays), (2, &scratch.view_encoded)];
        buffers.extend(pass.deltas.view.map(|tilt| (3, tilt)));
        self.run(Kernel::new("view").with("TILT", pass.deltas.view.is_some()), params, &buffers, groups(pass.rays));
        self.trunk(rows, pass.field, pass.deltas.feature);
        let injection = pass.deltas.feature.map(|(_, layer)| layer);
        let last = self.trunk_input(shape.trunk.len(), injection, rows).0;
        for columns in shape.head.products() {
            let head = Output { numbers: (&scratch.head).into(), stride: shape.width + 4, first: columns.start };
            self.dense(rows, pass.field, shape.head, columns, (last, None), head, false, None);
        }
        for (i, layer) in shape.view.iter().enumerate() {
            let input = self.view_input(i, pass.samples, rows);
            let c = Output { numbers: self.hidden(&scratch.view[i], rows), stride: shape.view_width, first: 0 };
            self.dense(rows, pass.field, *layer, 0..shape.view_width, input, c, true, None);
        }
        let last = (self.view_input(shape.view.len(), pass.samples, rows).0, None);
        let raw = Output { numbers: (&scratch.raw).into(), stride: 4, first: 0 };
        self.dense(rows, pass.field, shape.rgb, 0..4, last, raw, false, None);
        self.activate(pass);
        self.composite(pass, t_vals, loss);
        if pass.noise.is_some() {
            self.density_of_head(pass.points());
            self.march(pass, t_vals, Some(pass.out));
        }
    }

    /// The input of layer `i` between trunk and colour.
    pub(super) fn view_input(&self, i: usize, samples: usize, rows: Rows) -> (Matrix<'a>, Option<Matrix<'a>>) {
        let (scratch, shape) = (self.scratch, self.shape);
        if i > 0 {
            return (Matrix::new(self.hidden(&scratch.view[i - 1], rows), shape.view_width), None);
        }
        let feature = Matrix { columns: shape.width, ..Matrix::new(&scratch.head, shape.width + 4) };
        let view = Matrix { every: samples, ..Matrix::new(&scratch.view_encoded, shape.view_channels) };
        (feature, Some(view))
    }

    fn activate(&mut self, pass: &PassAt<'a>) {
        let (scratch, deltas) = (self.scratch, pass.deltas);
        let params = self.output_params(pass);
        let mut buffers = vec![(1, &scratch.raw), (2, &scratch.head), (3, &scratch.values)];
        if self.has_outside() {
            buffers.push((4, &scratch.inside));
        }
        buffers.extend(pass.noise.map(|noise| (5, noise)));
        if let Some((delta, ..)) = deltas.rgb {
            buffers.extend([(6, delta), (8, &scratch.used_rgb)]);
        }
        if let Some((delta, ..)) = deltas.density {
            buffers.extend([(7, delta), (9, &scratch.used_density)]);
        }
        let kernel = Kernel::new("activate").with("INSIDE", self.has_outside()).with("NOISE", pass.noise.is_some());
        let kernel = kernel.with("RGB", deltas.rgb.is_some()).with("DENSITY", deltas.density.is_some());
        self.run(kernel, params, &buffers, groups(pass.points()));
    }

    fn composite(&mut self, pass: &PassAt<'a>, t_vals: &Buffer, loss: Option<PassLoss>) {
        let scratch = self.scratch;
        let background = self.background.unwrap_or_default().map(f64::from);
        let PassLoss { weight, terms, occlusion_share } = loss.unwrap_or_default();
        let PassAt { rays, samples, columns, ray0, .. } = *pass;
        let ((near, far), has_background) = (self.bounds, self.background.is_some());
        let weight = weight * self.loss_scale;
        let [distortion, occlusion, entropy, cauchy, opacity_prior] =
            terms.map(|weight| weight.unwrap_or(0.0) * self.loss_scale);
        let params = params! { rays, samples, columns, ray0, background, has_background, near, far, weight };
        let params =
            params.and(params! { distortion, occlusion, share: occlusion_share, entropy, cauchy, opacity_prior });
        let mut buffers = vec![(1, self.rays), (2, t_vals), (3, &scratch.values), (4, &scratch.weights), (5, pass.out)];
        if loss.is_some() {
            buffers.extend([(6, &scratch.before), (7, &scratch.d_values), (8, &scratch.d_t)]);
        }
        let kernel = Kernel::new("composite").with("BACK", loss.is_some());
        let kernel =
            ON_RAYS.iter().zip(terms).fold(kernel, |kernel, ((_, part), weight)| kernel.with(part, weight.is_some()));
        self.run(kernel, params, &buffers, rows(pass.rays));
    }
}
