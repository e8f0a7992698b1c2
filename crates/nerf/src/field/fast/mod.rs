//! Kernels that compute a field in f32 on the CPU in candle's place: those of [`augnerf_fast`] on a copy of the weights. They
//! serve fields that are frozen or that record, and density's derivatives in space. Their results equal those of candle's
//! operations to rounding.

use std::sync::{Arc, MutexGuard, PoisonError};

use candle_core::Tensor;

use crate::base::{Error, Result};
use crate::field::settings::{Encoding, FieldConfig, Precision};
use augnerf_fast::encoding::{self, Code};
use augnerf_fast::fused;
use augnerf_fast::hash::fetch_tables;
use augnerf_fast::inside::replaced_outside;

use super::grid::Grid;
use super::inside::NOTHING;
use super::{FeatureDelta, Field, Inputs, RawOutput, position_channels};
use crate::base::tensors::Values;

mod spatial;
mod table;

pub(super) use augnerf_fast::fused::PrefixCache;
pub(super) use spatial::Tape;
use table::Records;
pub use table::TableRecord;

/// The weights of a field in the layout of the kernels.
#[derive(Clone)]
pub(super) struct FastField {
    network: Arc<fused::Network>,
    /// Receives the gradients of the weights outside of candle's graph.
    record: Option<Record>,
}

/// Gradients that backward passes record.
#[derive(Clone)]
struct Record {
    layers: Arc<fused::Recorder>,
    /// For the table of a hash grid.
    table: Records,
}

impl FastField {
    /// Copies the weights of a field. After an update of them the copy is out of date.
    pub(super) fn new(field: &Field) -> Result<FastField> {
        if let Some(grid) = &field.grid {
            // Into the caches, before threads read it in random order.
            fetch_tables(Values::of(&grid.table.contiguous()?).slice()?);
        }
        let parameters: Vec<Tensor> = field.parameters_of_layers().cloned().collect();
        let network = Arc::new(fused::prepare(architecture(field.config()), &parameters)?);
        Ok(FastField { network, record: None })
    }

    /// Returns the same with a record of its own.
    pub(super) fn recording(&self) -> FastField {
        let layers = Arc::new(fused::Recorder::new(self.network.clone()));
        FastField { record: Some(Record { layers, table: Records::default() }), ..self.clone() }
    }

    /// Returns the same without a record.
    pub(super) fn detached(&self) -> FastField {
        FastField { record: None, ..self.clone() }
    }

    /// Returns whether backward passes leave the gradients of the weights.
    pub(super) fn records(&self) -> bool {
        self.record.is_some()
    }

    /// Returns features `[n, channels]` of a hash grid at points `[n, 3]`.
    pub(super) fn features(&self, grid: &Grid, points: &Tensor) -> Result<Tensor> {
        Ok(table::encode(grid, points, self.record.as_ref().map(|record| record.table.clone()))?)
    }

    fn query<'a>(&self, below: Option<&'a PrefixCache>) -> fused::Query<'a> {
        let recorder = self.record.as_ref().map(|record| record.layers.clone());
        fused::Query { network: self.network.clone(), recorder, below }
    }

    /// Computes [`Field::forward`]. `below` keeps the trunk below a delta, if many queries share their points.
    pub(super) fn forward(
        &self,
        inputs: &Inputs,
        viewdirs: &Tensor,
        delta: Option<FeatureDelta>,
        below: Option<&PrefixCache>,
    ) -> Result<RawOutput> {
        let (n, _) = inputs.values.dims2()?;
        let delta = delta.map(|delta| (delta.layer, delta.delta));
        let raw = only_inside(inputs, self.query(below).run(&inputs.values, viewdirs, delta)?)?;
        let (rgb, density) = (raw.narrow(0, 0, 3 * n)?.reshape((n, 3))?, raw.narrow(0, 3 * n, n)?);
        Ok(RawOutput { rgb, density })
    }

    /// Computes [`Field::raw_density`] without gradients, and without points outside a grid's box.
    pub(super) fn raw_density(&self, field: &Field, points: &Tensor) -> Result<Tensor> {
        let Some(grid) = &field.grid else { return Ok(self.query(None).density(points)?) };
        let density = |points: &Tensor| Ok::<_, Error>(self.query(None).density(&self.features(grid, points)?)?);
        let Some(inside) = grid.are_inside(points)? else { return density(points) };
        let indices: Vec<u32> = (0..).zip(&inside).filter_map(|(i, inside)| inside.then_some(i)).collect();
        let mut raw = vec![NOTHING; inside.len()];
        if !indices.is_empty() {
            let points = points.index_select(&Tensor::new(indices.as_slice(), points.device())?, 0)?;
            let raw_inside = density(&points)?.to_vec1::<f32>()?;
            for (index, value) in indices.iter().zip(raw_inside) {
                raw[*index as usize] = value;
            }
        }
        Ok(Tensor::new(raw, points.device())?)
    }

    /// Computes [`Field::raw_density`] in candle's graph with gradients of `positions`: the encoding by kernels, the layers by
    /// candle.
    pub(super) fn raw_density_in_graph(&self, field: &Field, positions: &Tensor) -> Result<Tensor> {
        let inputs = field.inputs(positions, None)?;
        let encoded = match &field.grid {
            Some(_) => inputs.values.clone(),
            None => encoding::encode(&inputs.values, position_code(field.config()))?,
        };
        only_inside(&inputs, field.nerf.raw_density(&field.nerf.trunk(&encoded, None)?)?)
    }

    /// Returns the gradients of weight and bias of each layer that backward passes have added up, in `shapes`. `None` without a
    /// record.
    pub(super) fn recorded(&self, shapes: Vec<Vec<usize>>) -> Result<Option<Vec<Tensor>>> {
        Ok(self.record.as_ref().map(|record| record.layers.gradients(shapes)).transpose()?)
    }

    /// Returns the records for a hash grid's table. `None` if it does not record.
    pub(super) fn table_records(&self) -> Option<MutexGuard<'_, Vec<TableRecord>>> {
        self.record.as_ref().map(|record| record.table.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Returns the gradient of a hash grid's table, `[entries, features]`, from records in their order.
pub(super) fn table_gradient<'a>(grid: &Grid, records: impl IntoIterator<Item = &'a TableRecord>) -> Result<Tensor> {
    Ok(table::table_gradient(grid, records)?)
}

/// Removes raw density where there can be none. It takes raw density `[n]`, or raw output that ends with it.
fn only_inside(inputs: &Inputs, raw: Tensor) -> Result<Tensor> {
    Ok(match &inputs.inside {
        Some(inside) => replaced_outside(&raw, &inside.0, NOTHING)?,
        None => raw,
    })
}

/// Returns what the kernels know of a field.
fn architecture(config: &FieldConfig) -> fused::Architecture {
    fused::Architecture {
        code: position_code(config),
        view_octaves: config.view_octaves,
        depth: config.depth,
        width: config.width,
        skips: config.skips.clone(),
        view_depth: config.view_depth,
        bf16: config.precision == Precision::Bf16,
    }
}

/// Returns the encoding of a field's positions.
fn position_code(config: &FieldConfig) -> Code {
    match config.encoding {
        Encoding::Positional => Code::Positional(config.position_octaves),
        Encoding::Integrated => Code::Integrated(config.position_octaves),
        Encoding::Hash => Code::Features(position_channels(config)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use crate::field::settings::{Contraction, HashConfig};
    use candle_core::{DType, Device};

    /// What is not queried points outside the box is what masking it afterwards leaves, to the bit.
    #[test]
    fn points_outside_the_box_are_not_asked_about() {
        let hash = HashConfig {
            levels: 5,
            log2_table: 9,
            coarsest: 4,
            finest: Some(40),
            bounds: Some([[-1.0; 3], [1.0; 3]]),
            contraction: Some(Contraction::None),
            ..HashConfig::default()
        };
        let config = FieldConfig { encoding: Encoding::Hash, hash, width: 64, ..FieldConfig::default() };
        let field = Field::init(&config, 3, 0, DType::F32, &Device::Cpu).unwrap().frozen().unwrap();
        let drawn = Random::new(4, Stream::Init, 0).uniform_tensor(&[1300, 3], DType::F32, &Device::Cpu).unwrap();
        for (scale, some_inside, some_outside) in [(1.3, true, true), (0.9, true, false)] {
            let points = drawn.affine(2.0 * scale, -scale).unwrap();
            let raw = field.raw_density(&points).unwrap().to_vec1::<f32>().unwrap();
            let inputs = field.inputs(&points, None).unwrap();
            let unmasked = field.fast.as_ref().unwrap().query(None).density(&inputs.values).unwrap();
            assert_eq!(raw, only_inside(&inputs, unmasked).unwrap().to_vec1::<f32>().unwrap(), "scale {scale}");
            let outside = raw.iter().filter(|raw| **raw == -1e4).count();
            assert_eq!((outside < 1300, outside > 0), (some_inside, some_outside), "scale {scale}");
        }
        let empty = field.raw_density(&drawn.affine(1.0, 5.0).unwrap()).unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(empty, vec![-1e4; 1300], "all of them outside");
    }
}
