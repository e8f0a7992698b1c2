//! Density with its exact gradient and Laplacian in space, and the weight gradients of any function of the three, by their
//! adjoints.
//!
//! A trunk of ReLU layers is linear between its kinks. With the masks m of its active units held, raw density is a
//! linear function of the encoding e(x). The adjoint recursion, from the density head down to the first layer, gives
//! its slope e_bar:
//!
//! ```text
//! s_D = w m_D,   s_(l-1) = (s_l W_l) m_(l-1),   e_bar = s_1 W_1  (+ a skip layer's share)
//! d raw / dx_i = sum over the channels c of axis i of e'_c e_bar_c,   Laplacian(raw) = sum_c e''_c e_bar_c
//! ```
//!
//! Masks are constant almost everywhere, so that holding them loses nothing. The jumps of the gradient on the kinks
//! themselves are ignored. The weight gradients of a loss L of (raw, gradient, Laplacian) follow from one forward
//! recursion, started at r = dL/d e_bar + dL/d raw e:
//!
//! ```text
//! u_0 = r,   u_l = (W_l u_(l-1) + b_l dL/d raw) m_l,   dL/dW_l = s_l^T u_(l-1),   dL/db_l = s_l^T dL/d raw
//! ```
//!
//! Both are first-order. If a hash grid is the encoding, e is linear in its table. With e_bar held, the table's gradient is
//! that through the encoding D e with the cotangent e_bar. The operator is D = dL/d raw + dL/d gradient . nabla +
//! dL/d Laplacian nabla^2 at each point.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::base::tensors::{Values, sum};
use crate::field::activation::{Activated, Cotangents};
use crate::field::grid::Grid;
use crate::field::settings::DensityActivation;
use crate::field::spatial::{DensityAt, Order, not_requested};
use crate::field::waves::Waves;
use crate::field::{Field, Inputs};
use augnerf_fast::fused::Slope;
use augnerf_fast::hash::Operator;

use super::table::{self, TableRecord};
use super::{FastField, only_inside, position_code};

/// What the weight gradients of a loss need.
pub(in crate::field) struct Tape {
    slopes: Slopes,
    /// Raw density, and its slope in the encoding, d raw / d encoding, `[n, channels]`.
    raw: Slope,
    activated: Activated,
    raw_gradient: Tensor,
    raw_laplacian: Tensor,
}

impl FastField {
    /// Returns the derivatives of `field`'s density at `points [n, 3]`, up to `order`.
    pub(in crate::field) fn spatial(&self, field: &Field, order: Order, points: &Tensor) -> Result<(DensityAt, Tape)> {
        let points = points.detach();
        let config = field.config();
        let (values, slopes, inside) = match &field.grid {
            Some(grid) => {
                let slopes = Slopes::Grid(GridSlopes::new(grid.detached(), &points)?);
                (table::encode(grid, &points, None)?, slopes, grid.inside(&points)?)
            }
            None => {
                let code = position_code(config);
                let encoded = Values::of(&points.contiguous()?).slice().map(|points| code.rows(points))?;
                let encoded = Tensor::from_vec(encoded, (points.dim(0)?, code.channels()), points.device())?;
                (points, Slopes::Waves(Waves::new(&encoded, config.position_octaves)?), None)
            }
        };
        // After a ReLU only positive raw density has derivatives.
        let positive_alone = config.density_activation == DensityActivation::Relu;
        let slope = Slope::new(self.network.clone(), &values, positive_alone)?;
        let raw = only_inside(&Inputs { values, inside, queried: None }, slope.raw.clone())?;
        let raw_gradient = match order {
            Order::Density => not_requested(&raw, &[3])?,
            Order::Gradient | Order::Laplacian => slopes.gradient(&slope.slope)?,
        };
        let raw_laplacian = match order {
            Order::Density | Order::Gradient => not_requested(&raw, &[])?,
            Order::Laplacian => slopes.laplacian(&slope.slope)?,
        };
        let activated = Activated::new(config.density_activation, &raw)?;
        let (gradient, laplacian) = activated.chain(&raw_gradient, &raw_laplacian)?;
        let at = DensityAt { density: activated.value.clone(), gradient, laplacian };
        Ok((at, Tape { slopes, raw: slope, activated, raw_gradient, raw_laplacian }))
    }
}

impl Tape {
    /// Returns the gradients of a loss with the derivatives of `field`, in the order of [`Field::parameter_names`], except
    /// that of a hash grid's table, which is a record.
    pub(in crate::field) fn weight_gradients(
        &self,
        field: &Field,
        loss: &Cotangents,
    ) -> Result<(Vec<Option<Tensor>>, Option<TableRecord>)> {
        let raw = self.activated.backward(loss, &self.raw_gradient, &self.raw_laplacian)?;
        let cotangent = self.slopes.backward(&raw)?;
        let mut gradients = vec![None; Field::parameter_names(field.config()).len()];
        if cotangent.is_none() && raw.density.is_none() {
            return Ok((gradients, None));
        }
        let layer_gradients = &mut gradients[usize::from(field.grid.is_some())..];
        let values_of_layers = self.raw.gradients(cotangent.as_ref(), raw.density.as_ref())?;
        for ((gradient, values), parameter) in
            layer_gradients.iter_mut().zip(values_of_layers).zip(field.parameters_of_layers())
        {
            *gradient = Some(Tensor::from_vec(values, parameter.shape(), &Device::Cpu)?);
        }
        field.hide(layer_gradients)?;
        let record = match &self.slopes {
            Slopes::Waves(_) => None,
            Slopes::Grid(grid) => Some(grid.record(&raw, &self.raw.slope)?),
        };
        Ok((gradients, record))
    }
}

/// The derivatives of an encoding at `n` points.
enum Slopes {
    /// Of the positional encoding.
    Waves(Waves),
    /// Of a hash grid, computed when they are needed.
    Grid(GridSlopes),
}

impl Slopes {
    /// Returns the gradient `[n, 3]` of a quantity whose derivative in the encoding is `e_bar [n, channels]`.
    fn gradient(&self, e_bar: &Tensor) -> Result<Tensor> {
        match self {
            Slopes::Waves(waves) => Ok((e_bar * &waves.first)?.matmul(&waves.axes)?),
            Slopes::Grid(grid) => grid.gradient(e_bar),
        }
    }

    /// Returns its Laplacian `[n]`, which not every encoding has
    /// ([`FieldConfig::has_laplacian`](crate::field::settings::FieldConfig::has_laplacian)).
    fn laplacian(&self, e_bar: &Tensor) -> Result<Tensor> {
        match self {
            Slopes::Waves(waves) => Ok((e_bar * &waves.second)?.sum(1)?),
            Slopes::Grid(grid) => Ok((e_bar * grid.laplacian()?)?.sum(1)?),
        }
    }

    /// Returns dL/d e_bar `[n, channels]` of a loss with these derivatives in the gradient and the Laplacian.
    fn backward(&self, Cotangents { gradient, laplacian, .. }: &Cotangents) -> Result<Option<Tensor>> {
        match self {
            Slopes::Waves(waves) => waves_backward(waves, gradient, laplacian),
            Slopes::Grid(_) if gradient.is_none() && laplacian.is_none() => Ok(None),
            Slopes::Grid(grid) => {
                let (gradient, laplacian) = (gradient.clone(), laplacian.clone());
                Ok(Some(grid.operate(&Cotangents { density: None, gradient, laplacian })?))
            }
        }
    }
}

fn waves_backward(waves: &Waves, gradient: &Option<Tensor>, laplacian: &Option<Tensor>) -> Result<Option<Tensor>> {
    let through_gradient =
        gradient.as_ref().map(|gradient| gradient.matmul(&waves.axes.t()?)? * &waves.first).transpose()?;
    let through_laplacian =
        laplacian.as_ref().map(|laplacian| waves.second.broadcast_mul(&laplacian.unsqueeze(1)?)).transpose()?;
    sum(through_gradient, through_laplacian)
}

/// A hash grid at `n` points.
struct GridSlopes {
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

    fn gradient(&self, e_bar: &Tensor) -> Result<Tensor> {
        let Grid { shape, domain, table } = &self.grid;
        let (e_bar, table) = (e_bar.contiguous()?, table.contiguous()?);
        let mut single = vec![0f32; self.unit.len()];
        let (table, e_bar) = (Values::of(&table), Values::of(&e_bar));
        shape.point_gradient(table.slice()?, &narrowed(&self.unit), e_bar.slice()?, &mut single);
        let d_unit: Vec<f64> = single.into_iter().map(f64::from).collect();
        let mut d_points = vec![0.0; d_unit.len()];
        domain.backward(&self.points, &d_unit, &mut d_points);
        Ok(Tensor::from_vec(narrowed(&d_points), (d_points.len() / 3, 3), &Device::Cpu)?)
    }

    fn laplacian(&self) -> Result<Tensor> {
        let laplacian = Some(Tensor::ones(self.points.len() / 3, DType::F64, &Device::Cpu)?);
        self.operate(&Cotangents { laplacian, ..Cotangents::default() })
    }

    /// Returns the sum of encoding, its derivatives along the axes and its Laplacian, times `factors` at each point,
    /// `[n, channels]`.
    fn operate(&self, factors: &Cotangents) -> Result<Tensor> {
        let Grid { shape, table, .. } = &self.grid;
        let n = self.points.len() / 3;
        let mut out = vec![0f32; n * shape.channels()];
        let table = table.contiguous()?;
        let operators = self.operators(factors)?;
        shape.encode(Values::of(&table).slice()?, &narrowed(&self.unit), Some(&operators), &mut out);
        Ok(Tensor::from_vec(out, (n, shape.channels()), &Device::Cpu)?)
    }

    /// Returns the record of a loss with derivatives `raw` in raw density, its gradient and its Laplacian, where raw density is
    /// `e_bar [n, channels]` in the encoding.
    fn record(&self, raw: &Cotangents, e_bar: &Tensor) -> Result<TableRecord> {
        Ok(TableRecord {
            points: narrowed(&self.unit),
            gradient: Values::of(&e_bar.contiguous()?).slice()?.to_vec(),
            operators: Some(self.operators(raw)?),
            is_of_second_pass: false,
        })
    }

    fn operators(&self, factors: &Cotangents) -> Result<Vec<Operator<f32>>> {
        let numbers = |factor: &Option<Tensor>| factor.as_ref().map(values).transpose();
        let (value, gradient) = (numbers(&factors.density)?, numbers(&factors.gradient)?);
        let laplacian = numbers(&factors.laplacian)?;
        let operator_at = |(i, point): (usize, &[f64; 3])| {
            let factor = |factors: &Option<Vec<f64>>, i: usize| factors.as_ref().map_or(0.0, |factors| factors[i]);
            let slope = std::array::from_fn(|axis| factor(&gradient, 3 * i + axis));
            let operator = self.grid.domain.operator(*point, factor(&value, i), slope, factor(&laplacian, i));
            operator.map(|number| number as f32)
        };
        Ok(self.points.as_chunks().0.iter().enumerate().map(operator_at).collect())
    }
}

fn values(tensor: &Tensor) -> Result<Vec<f64>> {
    Ok(tensor.detach().to_dtype(DType::F64)?.contiguous()?.flatten_all()?.to_vec1()?)
}

fn narrowed(values: &[f64]) -> Vec<f32> {
    values.iter().map(|value| *value as f32).collect()
}
