//! A hash grid's encoding by kernels, and the records behind its table's gradient.
//!
//! The gradient of a table is as large as the table, and a chunk of rays changes little of it. A recording field
//! therefore keeps what each chunk would add. The gradient is summed once per step, with the levels in parallel.

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp2, Device, Layout, Result, Shape, Tensor};

use crate::base::tensors::{Values, slice};
use crate::field::grid::Grid;
use augnerf_fast::hash::{Domain, EncodingGradients, HashGrid, Operator};

/// The records of a field, in the order of its backward passes.
pub(super) type Records = Arc<Mutex<Vec<TableRecord>>>;

/// A contribution to the table's gradient: points in the grid's cube, and the gradient of their encoding, or of what
/// operators make of it.
pub struct TableRecord {
    pub(super) points: Vec<f32>,
    pub(super) gradient: Vec<f32>,
    pub(super) operators: Option<Vec<Operator<f32>>>,
    /// Left by a step's second pass.
    pub is_of_second_pass: bool,
}

impl TableRecord {
    /// Returns the number of points in the record.
    pub fn count(&self) -> usize {
        self.points.len() / 3
    }

    fn encoding_gradients(&self) -> EncodingGradients<'_> {
        EncodingGradients { points: &self.points, d_out: &self.gradient, operators: self.operators.as_deref() }
    }
}

/// Returns the table's gradient, `[entries, features]`, from records in their order.
pub(super) fn table_gradient<'a>(grid: &Grid, records: impl IntoIterator<Item = &'a TableRecord>) -> Result<Tensor> {
    let shape = &grid.shape;
    let mut sum = vec![0f32; shape.entries() * shape.features()];
    let records: Vec<EncodingGradients> = records.into_iter().map(TableRecord::encoding_gradients).collect();
    shape.table_gradient(&records, &mut sum);
    Tensor::from_vec(sum, (shape.entries(), shape.features()), &Device::Cpu)
}

/// Returns features `[n, channels]` at points `[n, 3]`. Backward passes leave what the table's gradient needs in `records`, if
/// there are any.
pub(super) fn encode(grid: &Grid, points: &Tensor, records: Option<Records>) -> Result<Tensor> {
    let operation = Encode { shape: grid.shape.clone(), domain: grid.domain, records, unit: Mutex::default() };
    points.contiguous()?.apply_op2(&grid.table.contiguous()?, operation)
}

/// The encoding of points by a table, whose gradient is recorded beside candle's graph.
struct Encode {
    shape: Arc<HashGrid>,
    domain: Domain,
    records: Option<Records>,
    /// The points in the grid's cube, kept from the forward to the backward pass.
    unit: Mutex<Vec<f32>>,
}

impl CustomOp2 for Encode {
    fn name(&self) -> &'static str {
        "hash-encode"
    }

    fn cpu_fwd(
        &self,
        points: &CpuStorage,
        layout: &Layout,
        table: &CpuStorage,
        table_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let points: &[f32] = slice(points, layout)?;
        let mut unit = vec![0f32; points.len()];
        let n = points.len() / 3;
        self.domain.map(points, &mut unit, &mut vec![false; n]);
        let mut out = vec![0f32; n * self.shape.channels()];
        self.shape.encode(slice(table, table_layout)?, &unit, None, &mut out);
        *self.unit.lock().unwrap_or_else(PoisonError::into_inner) = unit;
        Ok((CpuStorage::F32(out), Shape::from((n, self.shape.channels()))))
    }

    fn bwd(
        &self,
        points: &Tensor,
        table: &Tensor,
        _features: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let unit = std::mem::take(&mut *self.unit.lock().unwrap_or_else(PoisonError::into_inner));
        if unit.is_empty() && points.elem_count() > 0 {
            candle_core::bail!("hash encoding: a second backward pass through one forward pass");
        }
        let gradient = gradient.contiguous()?;
        let gradient = Values::of(&gradient).slice()?.to_vec();
        let d_points = if points.track_op() {
            let mut d_unit = vec![0f32; unit.len()];
            self.shape.point_gradient(Values::of(table).slice()?, &unit, &gradient, &mut d_unit);
            let mut d_points = vec![0f32; unit.len()];
            self.domain.backward(Values::of(points).slice()?, &d_unit, &mut d_points);
            Some(Tensor::from_vec(d_points, points.shape(), &Device::Cpu)?)
        } else {
            None
        };
        if let Some(records) = &self.records {
            let record = TableRecord { points: unit, gradient, operators: None, is_of_second_pass: false };
            records.lock().unwrap_or_else(PoisonError::into_inner).push(record);
        }
        Ok((d_points, None))
    }
}
