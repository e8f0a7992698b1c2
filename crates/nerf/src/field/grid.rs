//! A field's hash grid in candle's terms: the table as a parameter, the encoding as a differentiable operation, and the
//! records behind the table's gradient.
//!
//! The gradient of a table is as large as the table, and a chunk of rays changes little of it. A recording field
//! therefore keeps what each chunk would add. The gradient is summed once per step, with the levels in parallel.

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp1, CustomOp2, DType, Device, Layout, Result, Shape, Tensor, Var};
use candle_nn::{Init, VarBuilder};

use super::inside::Inside;
use crate::base::place::is_ours;
use crate::base::tensors::{Values, slice, with_values};
use crate::field::settings::{Contraction, Encoding, FieldConfig};
use augnerf_fast::hash::{Cotangents, Domain, HashGrid, Operator, Real, fetch_tables};

/// Initial entries of a table are uniform within +- this (Mueller et al. 2022, section 4).
const INITIAL: f64 = 1e-4;

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

    fn cotangents(&self) -> Cotangents<'_> {
        Cotangents { points: &self.points, d_out: &self.gradient, operators: self.operators.as_deref() }
    }
}

/// A hash grid with its table.
#[derive(Clone)]
pub(super) struct Grid {
    pub(super) shape: Arc<HashGrid>,
    pub(super) domain: Domain,
    pub(super) table: Tensor,
    records: Option<Arc<Mutex<Vec<TableRecord>>>>,
}

impl Grid {
    /// Creates the grid of a configuration with the builder's `table`, `[entries, features]`. `None` without a grid.
    ///
    /// # Errors
    /// Those of the builder.
    pub(super) fn new(config: &FieldConfig, builder: &VarBuilder) -> Result<Option<Grid>> {
        if config.encoding != Encoding::Hash {
            return Ok(None);
        }
        let (shape, domain) = config.hash.grid();
        let init = Init::Uniform { lo: -INITIAL, up: INITIAL };
        let table = builder.get_with_hints((shape.entries(), shape.features()), "table", init)?;
        Ok(Some(Grid { shape: Arc::new(shape), domain, table, records: None }))
    }

    /// Returns the same table as a constant, without records.
    pub(super) fn detached(&self) -> Grid {
        Grid { table: self.table.detach(), records: None, ..self.clone() }
    }

    /// Brings the table into the caches, before threads read it in random order.
    pub(super) fn fetch(&self) -> Result<()> {
        fetch_tables(Values::of(&self.table.contiguous()?).slice()?);
        Ok(())
    }

    pub(super) fn table(&self) -> &Tensor {
        &self.table
    }

    /// Returns the same table with records of its own.
    pub(super) fn recording(&self) -> Grid {
        Grid { records: Some(Arc::default()), ..self.detached() }
    }

    /// Adds a record to its own, or returns the table's gradient from it if it has none.
    pub(super) fn leave(&self, record: TableRecord) -> Result<Option<Tensor>> {
        let Some(records) = &self.records else { return self.table_gradient(&[record]).map(Some) };
        records.lock().unwrap_or_else(PoisonError::into_inner).push(record);
        Ok(None)
    }

    pub(super) fn take_records(&self) -> Vec<TableRecord> {
        let records = self.records.as_ref();
        records.map_or_else(Vec::new, |records| {
            std::mem::take(&mut *records.lock().unwrap_or_else(PoisonError::into_inner))
        })
    }

    /// Marks the records after the first `count` as the second pass's.
    pub(super) fn mark_second_pass(&self, count: usize) {
        if let Some(records) = &self.records {
            let mut records = records.lock().unwrap_or_else(PoisonError::into_inner);
            records.iter_mut().skip(count).for_each(|record| record.is_of_second_pass = true);
        }
    }

    pub(super) fn record_count(&self) -> usize {
        self.records.as_ref().map_or(0, |records| records.lock().unwrap_or_else(PoisonError::into_inner).len())
    }

    /// Returns the table's gradient, `[entries, features]`, from records in their order.
    pub(super) fn table_gradient<'a>(&self, records: impl IntoIterator<Item = &'a TableRecord>) -> Result<Tensor> {
        let mut sum = vec![0f32; self.shape.entries() * self.shape.features()];
        let records: Vec<Cotangents> = records.into_iter().map(TableRecord::cotangents).collect();
        self.shape.table_gradient(&records, &mut sum);
        Tensor::from_vec(sum, (self.shape.entries(), self.shape.features()), &Device::Cpu)
    }

    /// Returns features `[n, channels]` at points `[n, 3]`.
    pub(super) fn encode(&self, points: &Tensor) -> Result<Tensor> {
        if !is_ours(points) {
            return self.encode_plainly(points);
        }
        let points = points.contiguous()?;
        if points.dtype() != DType::F32 || self.table.track_op() {
            return points.apply_op2(&self.table.contiguous()?, Reference { grid: self.clone() });
        }
        // If points are not tracked, candle's backward pass would not reach the table.
        let tracked = match &self.records {
            Some(_) if !points.track_op() => Var::from_tensor(&points)?.as_tensor().clone(),
            _ => points.clone(),
        };
        let operation = Encode { grid: self.clone(), wants_points: points.track_op(), unit: Mutex::default() };
        tracked.apply_op1(operation)
    }

    /// Returns which of points `[n, 3]` are in the box. `None` if the grid covers all of space, or all points are
    /// inside.
    pub(super) fn are_inside(&self, points: &Tensor) -> Result<Option<Vec<bool>>> {
        if self.domain.contraction() != Contraction::None {
            return Ok(None);
        }
        let points = points.detach().contiguous()?;
        let inside = match with_values(&points, |points| self.domain.inside(points)) {
            Some(inside) => inside,
            None => self.domain.inside(&points.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?),
        };
        Ok(inside.iter().any(|inside| !inside).then_some(inside))
    }

    /// Returns the same for later results at these points.
    pub(super) fn inside(&self, points: &Tensor) -> Result<Option<Inside>> {
        Ok(self.are_inside(points)?.map(Inside::new))
    }
}

/// The encoding in f32, without the table in the graph.
struct Encode {
    grid: Grid,
    wants_points: bool,
    /// The points in the grid's cube, kept from the forward to the backward pass.
    unit: Mutex<Vec<f32>>,
}

impl CustomOp1 for Encode {
    fn name(&self) -> &'static str {
        "hash-encode"
    }

    fn cpu_fwd(&self, points: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let points: &[f32] = slice(points, layout)?;
        let Grid { shape, domain, table, .. } = &self.grid;
        let mut unit = vec![0f32; points.len()];
        let n = points.len() / 3;
        domain.map(points, &mut unit, &mut vec![false; n]);
        let mut out = vec![0f32; n * shape.channels()];
        shape.encode(Values::of(&table.contiguous()?).slice()?, &unit, None, &mut out);
        *self.unit.lock().unwrap_or_else(PoisonError::into_inner) = unit;
        Ok((CpuStorage::F32(out), Shape::from((n, shape.channels()))))
    }

    fn bwd(&self, points: &Tensor, _features: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let Grid { shape, domain, table, records } = &self.grid;
        let unit = std::mem::take(&mut *self.unit.lock().unwrap_or_else(PoisonError::into_inner));
        if unit.is_empty() && points.elem_count() > 0 {
            candle_core::bail!("hash encoding: a second backward pass through one forward pass");
        }
        let gradient = gradient.contiguous()?;
        let gradient = Values::of(&gradient).slice()?.to_vec();
        let d_points = if self.wants_points {
            let mut d_unit = vec![0f32; unit.len()];
            shape.point_gradient(Values::of(&table.contiguous()?).slice()?, &unit, &gradient, &mut d_unit);
            let points = points.contiguous()?;
            let mut d_points = vec![0f32; unit.len()];
            domain.backward(Values::of(&points).slice()?, &d_unit, &mut d_points);
            Some(Tensor::from_vec(d_points, points.shape(), &Device::Cpu)?)
        } else {
            None
        };
        if let Some(records) = records {
            let record = TableRecord { points: unit, gradient, operators: None, is_of_second_pass: false };
            records.lock().unwrap_or_else(PoisonError::into_inner).push(record);
        }
        Ok(d_points)
    }
}

/// The encoding as the paper writes it, with the table in the graph, in f32 and f64.
struct Reference {
    grid: Grid,
}

impl Reference {
    fn features<T: Real + Default>(&self, points: &[T], table: &[T]) -> Vec<T> {
        let unit = self.unit(points);
        let mut out = vec![T::default(); points.len() / 3 * self.grid.shape.channels()];
        self.grid.shape.encode_reference(table, &unit, None, &mut out);
        out
    }

    fn unit<T: Real + Default>(&self, points: &[T]) -> Vec<T> {
        let mut unit = vec![T::default(); points.len()];
        self.grid.domain.map(points, &mut unit, &mut vec![false; points.len() / 3]);
        unit
    }

    /// Returns gradients of points and table.
    fn gradients<T: Real + Default>(&self, points: &[T], table: &[T], gradient: &[T]) -> (Vec<T>, Vec<T>) {
        let Grid { shape, domain, .. } = &self.grid;
        let unit = self.unit(points);
        let (mut d_unit, mut d_points) = (vec![T::default(); points.len()], vec![T::default(); points.len()]);
        shape.point_gradient_reference(table, &unit, gradient, &mut d_unit);
        domain.backward(points, &d_unit, &mut d_points);
        let mut d_table = vec![T::default(); table.len()];
        shape.table_gradient_reference(&unit, None, gradient, &mut d_table);
        (d_points, d_table)
    }
}

impl CustomOp2 for Reference {
    fn name(&self) -> &'static str {
        "hash-encode-reference"
    }

    fn cpu_fwd(
        &self,
        points: &CpuStorage,
        points_layout: &Layout,
        table: &CpuStorage,
        table_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let shape = Shape::from((points_layout.shape().dims2()?.0, self.grid.shape.channels()));
        let out = match points {
            CpuStorage::F32(_) => {
                CpuStorage::F32(self.features(slice(points, points_layout)?, slice(table, table_layout)?))
            }
            CpuStorage::F64(_) => {
                CpuStorage::F64(self.features(slice(points, points_layout)?, slice(table, table_layout)?))
            }
            _ => candle_core::bail!("points and table are both f32 or both f64"),
        };
        Ok((out, shape))
    }

    fn bwd(
        &self,
        points: &Tensor,
        table: &Tensor,
        _features: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        macro_rules! of {
            ($kind:ty) => {{
                let flat = |tensor: &Tensor| tensor.contiguous()?.flatten_all()?.to_vec1::<$kind>();
                let (d_points, d_table) = self.gradients(&flat(points)?, &flat(table)?, &flat(gradient)?);
                let like = |values: Vec<$kind>, tensor: &Tensor| Tensor::from_vec(values, tensor.shape(), &Device::Cpu);
                Ok((Some(like(d_points, points)?), Some(like(d_table, table)?)))
            }};
        }
        match points.dtype() {
            DType::F64 => of!(f64),
            _ => of!(f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use crate::field::Field;
    use crate::field::settings::HashConfig;

    /// What is not asked about points outside the box is what masking it afterwards leaves, to the bit.
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
            let found = field.raw_density(&points).unwrap().to_vec1::<f32>().unwrap();
            let inputs = field.inputs(&points).unwrap();
            let all = field.query(None).unwrap().density(&inputs.values).unwrap();
            assert_eq!(found, inputs.only_inside(all).unwrap().to_vec1::<f32>().unwrap(), "scale {scale}");
            let outside = found.iter().filter(|raw| **raw == -1e4).count();
            assert_eq!((outside < 1300, outside > 0), (some_inside, some_outside), "scale {scale}");
        }
        let nothing = field.raw_density(&drawn.affine(1.0, 5.0).unwrap()).unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(nothing, vec![-1e4; 1300], "all of them outside");
    }
}
