//! The derivatives of an encoding e(x) in space, for given derivatives of raw density in its channels.

use candle_core::{CpuStorage, CustomOp1, DType, Device, Layout, Shape, Tensor};

use crate::base::Result;
use crate::base::tensors::{Values, slice};

use super::activation::Cotangents;
use super::grid::{Grid, TableRecord};
use super::{Field, encoded_channels};
use augnerf_fast::hash::Operator;

/// The derivatives of an encoding at `n` points.
pub(super) enum Slopes {
    /// Of the positional encoding.
    Waves(Waves),
    /// Of a hash grid, computed when they are needed.
    Grid(GridSlopes),
}

/// First and second derivatives of each channel in its own coordinate, `[n, channels]`, and the coordinate of each
/// channel.
pub(super) struct Waves {
    first: Tensor,
    second: Tensor,
    /// `[channels, 3]`, 1 where the channel belongs to the axis.
    axes: Tensor,
}

impl Slopes {
    /// Creates the derivatives of a field's encoding of `points [n, 3]`, which is `encoded`.
    pub(super) fn of(field: &Field, points: &Tensor, encoded: &Tensor) -> Result<Slopes> {
        Ok(match &field.grid {
            Some(grid) => Slopes::Grid(GridSlopes::new(grid.clone(), points)?),
            None => Slopes::Waves(Waves::new(encoded, field.config.position_octaves)?),
        })
    }

    /// Returns the gradient `[n, 3]` of a quantity whose derivative in the encoding is `e_bar [n, channels]`.
    pub(super) fn gradient(&self, e_bar: &Tensor) -> Result<Tensor> {
        match self {
            Slopes::Waves(waves) => Ok((e_bar * &waves.first)?.matmul(&waves.axes)?),
            Slopes::Grid(grid) => grid.gradient(e_bar),
        }
    }

    /// Returns its Laplacian `[n]`, which not every encoding has ([`super::settings::FieldConfig::has_laplacian`]).
    pub(super) fn laplacian(&self, e_bar: &Tensor) -> Result<Tensor> {
        match self {
            Slopes::Waves(waves) => Ok((e_bar * &waves.second)?.sum(1)?),
            Slopes::Grid(grid) => Ok((e_bar * grid.laplacian()?)?.sum(1)?),
        }
    }

    /// Returns dL/d e_bar `[n, channels]` of a loss with these derivatives in the gradient and the Laplacian.
    pub(super) fn backward(&self, gradient: &Option<Tensor>, laplacian: &Option<Tensor>) -> Result<Option<Tensor>> {
        match self {
            Slopes::Waves(waves) => waves.backward(gradient, laplacian),
            Slopes::Grid(_) if gradient.is_none() && laplacian.is_none() => Ok(None),
            Slopes::Grid(grid) => {
                let (gradient, laplacian) = (gradient.clone(), laplacian.clone());
                Ok(Some(grid.operate(&Cotangents { density: None, gradient, laplacian })?))
            }
        }
    }

    /// Returns each channel's derivative along each axis and its Laplacian, `[n, channels]`, with a hash grid's table
    /// in the graph.
    pub(super) fn tangents(&self) -> Result<[Tensor; 4]> {
        let [x, y, z] = [0, 1, 2].map(|axis| match self {
            Slopes::Waves(waves) => Ok(waves.first.broadcast_mul(&waves.axes.narrow(1, axis, 1)?.t()?)?),
            Slopes::Grid(grid) => grid.along(axis),
        });
        let laplacian = match self {
            Slopes::Waves(waves) => waves.second.clone(),
            Slopes::Grid(grid) => grid.laplacian()?,
        };
        Ok([x?, y?, z?, laplacian])
    }
}

impl Waves {
    /// From the encoding itself: the derivative of a sine is the frequency times the cosine of the same octave.
    fn new(encoded: &Tensor, octaves: usize) -> Result<Waves> {
        let channels = encoded_channels(octaves);
        // first = encoded @ turn + identity: each wave reads its partner.
        let (mut turn, mut constant) = (vec![0f64; channels * channels], vec![0f64; channels]);
        let (mut curvature, mut axes) = (vec![0f64; channels], vec![0f64; channels * 3]);
        for axis in 0..3 {
            constant[axis] = 1.0;
            axes[axis * 3 + axis] = 1.0;
            for octave in 0..octaves {
                let frequency = 2f64.powi(octave as i32);
                let (sin, cos) = (3 + 6 * octave + axis, 6 + 6 * octave + axis);
                turn[cos * channels + sin] = frequency;
                turn[sin * channels + cos] = -frequency;
                for channel in [sin, cos] {
                    curvature[channel] = -frequency * frequency;
                    axes[channel * 3 + axis] = 1.0;
                }
            }
        }
        let (dtype, device) = (encoded.dtype(), encoded.device());
        let tensor = |values: Vec<f64>, shape: (usize, usize)| {
            Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(dtype)?.to_device(device)
        };
        let first = encoded.matmul(&tensor(turn, (channels, channels))?)?;
        Ok(Waves {
            first: first.broadcast_add(&tensor(constant, (1, channels))?)?,
            second: encoded.broadcast_mul(&tensor(curvature, (1, channels))?)?,
            axes: tensor(axes, (channels, 3))?,
        })
    }

    fn backward(&self, gradient: &Option<Tensor>, laplacian: &Option<Tensor>) -> Result<Option<Tensor>> {
        let through_gradient =
            gradient.as_ref().map(|gradient| gradient.matmul(&self.axes.t()?)? * &self.first).transpose()?;
        let through_laplacian =
            laplacian.as_ref().map(|laplacian| self.second.broadcast_mul(&laplacian.unsqueeze(1)?)).transpose()?;
        Ok(match (through_gradient, through_laplacian) {
            (Some(a), Some(b)) => Some((a + b)?),
            (a, b) => a.or(b),
        })
    }
}

/// A hash grid at `n` points.
pub(super) struct GridSlopes {
    grid: Grid,
    /// The points in the scene and in the grid's cube, `[n, 3]`.
    points: Vec<f64>,
    unit: Vec<f64>,
}

impl GridSlopes {
    fn new(grid: Grid, points: &Tensor) -> Result<GridSlopes> {
        let points = values(points)?;
        let mut unit = vec![0.0; points.len()];
        grid.domain.map(&points, &mut unit, &mut vec![false; points.len() / 3]);
        Ok(GridSlopes { grid, points, unit })
    }

    fn along(&self, axis: usize) -> Result<Tensor> {
        let mut unit = [0.0; 3];
        unit[axis] = 1.0;
        let gradient = Some(Tensor::new(&unit, &Device::Cpu)?.broadcast_as((self.points.len() / 3, 3))?);
        self.operate(&Cotangents { gradient, ..Cotangents::default() })
    }

    fn laplacian(&self) -> Result<Tensor> {
        let laplacian = Some(Tensor::ones(self.points.len() / 3, DType::F64, &Device::Cpu)?);
        self.operate(&Cotangents { laplacian, ..Cotangents::default() })
    }

    fn gradient(&self, e_bar: &Tensor) -> Result<Tensor> {
        let Grid { shape, domain, table, .. } = &self.grid;
        let (e_bar, table) = (e_bar.contiguous()?, table.contiguous()?);
        let mut d_unit = vec![0.0; self.unit.len()];
        if table.dtype() == DType::F32 {
            let mut single = vec![0f32; d_unit.len()];
            let (table, e_bar) = (Values::of(&table), Values::of(&e_bar));
            shape.point_gradient(table.slice()?, &narrowed(&self.unit), e_bar.slice()?, &mut single);
            d_unit.iter_mut().zip(single).for_each(|(d, single)| *d = f64::from(single));
        } else {
            shape.point_gradient_reference(&values(&table)?, &self.unit, &values(&e_bar)?, &mut d_unit);
        }
        let mut d_points = vec![0.0; d_unit.len()];
        domain.backward(&self.points, &d_unit, &mut d_points);
        Ok(Tensor::from_vec(d_points, (self.points.len() / 3, 3), &Device::Cpu)?.to_dtype(table.dtype())?)
    }

    /// Returns the sum of encoding, its derivatives along the axes and its Laplacian, times `factors` at each point,
    /// `[n, channels]`. It is differentiable in the table.
    fn operate(&self, factors: &Cotangents) -> Result<Tensor> {
        Ok(self.grid.table.contiguous()?.apply_op1(self.operation(factors)?)?)
    }

    /// Returns the table's gradient of a loss with derivatives `raw` in raw density, its gradient and its Laplacian,
    /// where raw density is `e_bar [n, channels]` in the encoding. In f32 it is a record, otherwise the gradient
    /// itself.
    pub(super) fn table_gradient(
        &self,
        raw: &Cotangents,
        e_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<TableRecord>)> {
        let operation = self.operation(raw)?;
        let e_bar = e_bar.contiguous()?;
        if self.grid.table.dtype() != DType::F32 {
            return Ok((Some(operation.table_gradient(&self.grid.table, &e_bar)?), None));
        }
        Ok((None, Some(operation.record(&e_bar)?)))
    }

    fn operation(&self, factors: &Cotangents) -> Result<Operate> {
        let numbers = |factor: &Option<Tensor>| factor.as_ref().map(values).transpose();
        let (value, gradient) = (numbers(&factors.density)?, numbers(&factors.gradient)?);
        let laplacian = numbers(&factors.laplacian)?;
        let at = |(i, point): (usize, &[f64; 3])| {
            let one = |factors: &Option<Vec<f64>>, i: usize| factors.as_ref().map_or(0.0, |factors| factors[i]);
            let slope = std::array::from_fn(|axis| one(&gradient, 3 * i + axis));
            self.grid.domain.operator(*point, one(&value, i), slope, one(&laplacian, i))
        };
        let operators = self.points.as_chunks().0.iter().enumerate().map(at).collect();
        Ok(Operate { grid: self.grid.clone(), unit: self.unit.clone(), operators })
    }
}

/// Operators at points of the grid's cube.
struct Operate {
    grid: Grid,
    unit: Vec<f64>,
    operators: Vec<Operator<f64>>,
}

impl Operate {
    /// Returns the record with the gradient `d_out [n, channels]`, f32.
    fn record(&self, d_out: &Tensor) -> candle_core::Result<TableRecord> {
        Ok(TableRecord {
            points: narrowed(&self.unit),
            gradient: Values::of(d_out).slice()?.to_vec(),
            operators: Some(narrowed_each(&self.operators)),
            is_of_second_pass: false,
        })
    }

    /// `[entries, features]`.
    fn table_gradient(&self, table: &Tensor, d_out: &Tensor) -> candle_core::Result<Tensor> {
        let shape = &self.grid.shape;
        if table.dtype() == DType::F32 {
            return self.grid.table_gradient(&[self.record(d_out)?]);
        }
        let mut sum = vec![0f64; table.elem_count()];
        shape.table_gradient_reference(&self.unit, Some(&self.operators), &d_out.flatten_all()?.to_vec1()?, &mut sum);
        Tensor::from_vec(sum, table.shape(), &Device::Cpu)
    }
}

impl CustomOp1 for Operate {
    fn name(&self) -> &'static str {
        "hash-operate"
    }

    fn cpu_fwd(&self, table: &CpuStorage, layout: &Layout) -> candle_core::Result<(CpuStorage, Shape)> {
        let Operate { grid, unit, operators } = self;
        let (n, channels) = (operators.len(), grid.shape.channels());
        let out = match table {
            CpuStorage::F32(_) => {
                let mut out = vec![0f32; n * channels];
                let table = slice(table, layout)?;
                grid.shape.encode(table, &narrowed(unit), Some(&narrowed_each(operators)), &mut out);
                CpuStorage::F32(out)
            }
            CpuStorage::F64(_) => {
                let mut out = vec![0f64; n * channels];
                grid.shape.encode_reference(slice(table, layout)?, unit, Some(operators), &mut out);
                CpuStorage::F64(out)
            }
            _ => candle_core::bail!("tables are f32 or f64"),
        };
        Ok((out, Shape::from((n, channels))))
    }

    fn bwd(&self, table: &Tensor, _out: &Tensor, d_out: &Tensor) -> candle_core::Result<Option<Tensor>> {
        Ok(Some(self.table_gradient(table, &d_out.contiguous()?)?))
    }
}

fn values(tensor: &Tensor) -> Result<Vec<f64>> {
    Ok(tensor.detach().to_dtype(DType::F64)?.contiguous()?.flatten_all()?.to_vec1()?)
}

fn narrowed(values: &[f64]) -> Vec<f32> {
    values.iter().map(|value| *value as f32).collect()
}

fn narrowed_each(operators: &[Operator<f64>]) -> Vec<Operator<f32>> {
    operators.iter().map(|operator| operator.map(|number| number as f32)).collect()
}
