//! Density with its exact gradient and Laplacian in space, and the weight gradients of any function of the three.
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
//! Both are first-order, so that candle's second derivatives are never needed. If a hash grid is the encoding, e is
//! linear in its table. With e_bar held, the table's gradient is that through the encoding D e with the cotangent
//! e_bar. The operator is D = dL/d raw + dL/d gradient . nabla + dL/d Laplacian nabla^2 at each point.
//! [`spatial_reference`] computes the same with forward tangents in plain candle operations.

use candle_core::{Device, Tensor, Var};
use candle_nn::Linear;

use crate::base::Result;
use crate::base::place::is_host;
use crate::field::settings::{DensityActivation, Encoding};

use super::activation::{Activated, Cotangents};
use super::dense::mask_where_zero;
use super::nerf::bias;
use super::slopes::Slopes;
use super::{Field, Nerf, TableRecord, encode_reference, tensor_error};
use augnerf_fast::fused::Slope;

/// The highest requested derivative of density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Order {
    /// Density only.
    Density,
    /// Density and its gradient.
    Gradient,
    /// Density, its gradient and its Laplacian.
    Laplacian,
}

/// Density and its derivatives in space at `n` points. Those that were not requested are NaN.
pub struct DensityAt {
    /// After the activation, `[n]`, 1 / length.
    pub density: Tensor,
    /// `[n, 3]`, 1 / length^2.
    pub gradient: Tensor,
    /// `[n]`, 1 / length^3. NaN for a linearly interpolated hash grid, which has none.
    pub laplacian: Tensor,
}

/// [`DensityAt`], detached, with what is needed for the weight gradients of any function of it.
pub struct Spatial<'a> {
    /// Density, gradient and Laplacian at the points.
    pub at: DensityAt,
    tape: Tape<'a>,
}

/// What the weight gradients of a loss need.
struct Tape<'a> {
    field: &'a Field,
    slopes: Slopes,
    /// d raw / d encoding, `[n, channels]`.
    e_bar: Tensor,
    trunk: Trunk,
    activated: Activated,
    raw_gradient: Tensor,
    raw_laplacian: Tensor,
}

/// The trunk's part of the tape.
enum Trunk {
    Plain {
        /// Encoding of the points, `[n, channels]`.
        encoded: Tensor,
        /// Output of each layer, `[n, width]`.
        hidden: Vec<Tensor>,
        /// d raw / d (layer's output before its ReLU), `[n, width]`.
        adjoints: Vec<Tensor>,
    },
    Fused(Slope),
}

impl Field {
    /// Returns the gradient of density in space, `[n, 3]`, of a field queried at `positions`: points `[n, 3]`, or
    /// Gaussians `[n, 6]` whose means move.
    pub fn density_gradient(&self, positions: &Tensor) -> Result<Tensor> {
        let moved = Var::from_tensor(positions)?;
        let density = self.activate_density(&self.detached().raw_density(&moved)?)?;
        let gradients = density.sum_all()?.backward()?;
        let gradient = gradients.get(&moved).map_or_else(|| positions.zeros_like(), |gradient| Ok(gradient.clone()))?;
        Ok(gradient.narrow(1, 0, 3)?)
    }

    /// Returns density, gradient and Laplacian at `points [n, 3]`. It uses the fused core if the field is prepared for
    /// it ([`Field::prepared`]).
    pub fn spatial(&self, points: &Tensor) -> Result<Spatial<'_>> {
        self.spatial_up_to(Order::Laplacian, points)
    }

    /// Returns the same up to a derivative, without work for higher ones.
    pub fn spatial_up_to(&self, order: Order, points: &Tensor) -> Result<Spatial<'_>> {
        if self.config.encoding == Encoding::Hash && !is_host(points.device()) {
            return Err(tensor_error(
                "the derivatives of a hash grid are computed with --device cpu, or --device gpu for l1 and tv".into(),
            ));
        }
        if self.config.encoding == Encoding::Integrated {
            return Err(tensor_error("density's derivatives are those of a field that is queried at points".into()));
        }
        let (points, frozen) = (points.detach(), self.detached());
        let inputs = frozen.inputs(&points)?;
        let encoded = self.encoded(&inputs)?;
        let slopes = Slopes::of(&frozen, &points, &encoded)?;
        let (raw, e_bar, trunk) = match &self.network {
            Some(network) => {
                // After a ReLU only positive raw density has derivatives.
                let positive_alone = self.config.density_activation == DensityActivation::Relu;
                let fused = Slope::new(network.clone(), &inputs.values, positive_alone)?;
                (fused.raw.clone(), fused.slope.clone(), Trunk::Fused(fused))
            }
            None => plain_slope(&frozen.nerf, encoded)?,
        };
        let raw = inputs.only_inside(raw)?;
        let (raw_gradient, raw_laplacian) = match order {
            Order::Density => (unasked(&raw, &[3])?, unasked(&raw, &[])?),
            Order::Laplacian if self.config.has_laplacian() => (slopes.gradient(&e_bar)?, slopes.laplacian(&e_bar)?),
            Order::Gradient | Order::Laplacian => (slopes.gradient(&e_bar)?, unasked(&raw, &[])?),
        };
        let activated = Activated::new(self.config.density_activation, &raw)?;
        let (gradient, laplacian) = activated.chain(&raw_gradient, &raw_laplacian)?;
        let density = activated.value.clone();
        let tape = Tape { field: self, slopes, e_bar, trunk, activated, raw_gradient, raw_laplacian };
        Ok(Spatial { at: DensityAt { density, gradient, laplacian }, tape })
    }
}

/// Returns raw density `[n]` and its slope in the encoding, `[n, channels]`.
fn plain_slope(nerf: &Nerf, encoded: Tensor) -> Result<(Tensor, Tensor, Trunk)> {
    let mut hidden: Vec<Tensor> = Vec::with_capacity(nerf.trunk.len());
    for i in 0..nerf.trunk.len() {
        hidden.push(nerf.trunk_layer(i, &encoded, hidden.last())?);
    }
    let last = hidden.last().expect("a trunk has layers");
    let raw = nerf.raw_density(last)?;

    let slope = nerf.density.weight().broadcast_as(last.shape())?;
    let mut adjoints = vec![mask_where_zero(&slope, last)?];
    let mut e_bar: Option<Tensor> = None;
    for i in (0..nerf.trunk.len()).rev() {
        let (of_encoding, of_hidden) = nerf.split_inputs(i)?;
        let adjoint = adjoints.last().expect("starts with one");
        if let Some(weight) = of_encoding {
            let share = adjoint.matmul(&weight)?;
            e_bar = Some(match e_bar {
                Some(sum) => (sum + share)?,
                None => share,
            });
        }
        if let Some(weight) = of_hidden {
            adjoints.push(mask_where_zero(&adjoint.matmul(&weight)?, &hidden[i - 1])?);
        }
    }
    adjoints.reverse();
    Ok((raw, e_bar.expect("the first layer reads the encoding"), Trunk::Plain { encoded, hidden, adjoints }))
}

impl Spatial<'_> {
    /// Returns the gradients of a loss with these derivatives, in the order of [`Field::parameter_names`]. Entries are
    /// `None` for layers on which density does not depend.
    pub fn weight_gradients(&self, loss: &Cotangents) -> Result<Vec<Option<Tensor>>> {
        let (mut gradients, record) = self.recorded_gradients(loss)?;
        if let Some(record) = record {
            gradients[0] = self.tape.field.table_gradient(&[record])?;
        }
        Ok(gradients)
    }

    /// The same for a field that records ([`Field::recording`]): what a hash grid's table gets is left with its records.
    pub fn recording_gradients(&self, loss: &Cotangents) -> Result<Vec<Option<Tensor>>> {
        let (mut gradients, record) = self.recorded_gradients(loss)?;
        if let (Some(record), Some(grid)) = (record, &self.tape.field.grid) {
            gradients[0] = grid.leave(record)?;
        }
        Ok(gradients)
    }

    /// The same, except that the gradient of a hash grid's table may be a record for [`Field::table_gradient`]. That
    /// gradient is as large as the table, and is best made of many records at once.
    pub fn recorded_gradients(&self, loss: &Cotangents) -> Result<(Vec<Option<Tensor>>, Option<TableRecord>)> {
        let tape = &self.tape;
        let raw = tape.activated.backward(loss, &tape.raw_gradient, &tape.raw_laplacian)?;
        let cotangent = tape.slopes.backward(&raw.gradient, &raw.laplacian)?;
        let field = tape.field;
        let mut gradients = vec![None; Field::parameter_names(&field.config).len()];
        if cotangent.is_none() && raw.density.is_none() {
            return Ok((gradients, None));
        }
        let (of_table, of_layers) = gradients.split_at_mut(usize::from(field.grid.is_some()));
        let mut record = None;
        if let (Slopes::Grid(grid), [of_table]) = (&tape.slopes, of_table) {
            (*of_table, record) = grid.table_gradient(&raw, &tape.e_bar)?;
        }
        match &tape.trunk {
            Trunk::Plain { encoded, hidden, adjoints } => {
                plain_gradients(
                    &field.detached().nerf,
                    (encoded, hidden, adjoints),
                    cotangent,
                    raw.density,
                    of_layers,
                )?;
            }
            Trunk::Fused(slope) => {
                let found = slope.gradients(cotangent.as_ref(), raw.density.as_ref())?;
                for ((gradient, values), parameter) in of_layers.iter_mut().zip(found).zip(field.parameters_of_layers())
                {
                    *gradient = Some(Tensor::from_vec(values, parameter.shape(), &Device::Cpu)?);
                }
            }
        }
        field.hide(of_layers)?;
        Ok((gradients, record))
    }
}

/// Returns NaN of `shape` for each number of `raw [n]`.
fn unasked(raw: &Tensor, shape: &[usize]) -> Result<Tensor> {
    let shape = [&[raw.dim(0)?], shape].concat();
    Ok(Tensor::full(f64::NAN, shape, raw.device())?.to_dtype(raw.dtype())?)
}

/// Runs the forward recursion on the weights' gradients. At least one of the gradients is present.
fn plain_gradients(
    nerf: &Nerf,
    (encoded, hidden, adjoints): (&Tensor, &[Tensor], &[Tensor]),
    cotangent: Option<Tensor>,
    d_raw: Option<Tensor>,
    gradients: &mut [Option<Tensor>],
) -> Result<()> {
    let d_raw = d_raw.map(|d| d.unsqueeze(1)).transpose()?; // [n, 1]
    let of_raw = d_raw.as_ref().map(|d| encoded.broadcast_mul(d)).transpose()?;
    let u_0 = match (&cotangent, of_raw) {
        (Some(cotangent), Some(of_raw)) => (cotangent + of_raw)?,
        (cotangent, of_raw) => cotangent.clone().or(of_raw).expect("one of them has a gradient"),
    };
    let mut u: Option<Tensor> = None;
    for (i, layer) in nerf.trunk.iter().enumerate() {
        let input = nerf.trunk_input(i, &u_0, u.as_ref())?;
        let adjoint = adjoints[i].t()?;
        gradients[2 * i] = Some(adjoint.matmul(&input)?);
        gradients[2 * i + 1] = d_raw.as_ref().map(|d| adjoint.matmul(d)?.squeeze(1)).transpose()?;
        u = Some(match (&cotangent, &d_raw) {
            (Some(_), _) => {
                let moved = input.matmul(&layer.weight().t()?)?;
                let moved = match &d_raw {
                    Some(d) => (moved + d.matmul(&bias(layer).unsqueeze(0)?)?)?,
                    None => moved,
                };
                mask_where_zero(&moved, &hidden[i])?
            }
            // For raw density alone, the recursion is the forward pass, scaled point by point.
            (None, Some(d)) => hidden[i].broadcast_mul(d)?,
            (None, None) => unreachable!("one of them has a gradient"),
        });
    }
    let head = 2 * nerf.trunk.len();
    let u = u.expect("a trunk has layers");
    let ones = Tensor::ones((1, u.dim(0)?), u.dtype(), u.device())?;
    gradients[head] = Some(ones.matmul(&u)?);
    gradients[head + 1] = d_raw.map(|d| ones.matmul(&d)?.squeeze(0)).transpose()?;
    Ok(())
}

/// Returns density, gradient and Laplacian (`[n]`, `[n, 3]`, `[n]`) by forward tangents in plain candle operations,
/// differentiable in the weights. It is slow and obvious. The Laplacian of a linearly interpolated hash grid is that
/// within its cells.
pub fn spatial_reference(field: &Field, points: &Tensor) -> Result<(Tensor, Tensor, Tensor)> {
    let config = field.config();
    let inputs = field.inputs(points)?;
    let encoded = match &field.grid {
        Some(_) => inputs.values.clone(),
        None => encode_reference(points, config.position_octaves)?,
    };
    // Three tangents and the sum of second derivatives: linear maps and masks apply to all four.
    let start = Slopes::of(field, points, &encoded)?.tangents()?;
    let (mut hidden, mut tangents) = (encoded.clone(), start.clone());
    let linear = |x: &Tensor, layer: &Linear| x.matmul(&layer.weight().t()?);
    for (i, layer) in field.nerf.trunk.iter().enumerate() {
        if config.skips.contains(&i) {
            hidden = Tensor::cat(&[&encoded, &hidden], 1)?;
            for (tangent, start) in tangents.iter_mut().zip(&start) {
                *tangent = Tensor::cat(&[start, &*tangent], 1)?;
            }
        }
        let before = linear(&hidden, layer)?.broadcast_add(bias(layer))?;
        let mask = before.detach().gt(0f64)?.to_dtype(before.dtype())?;
        hidden = (before * &mask)?;
        for tangent in &mut tangents {
            *tangent = (linear(tangent, layer)? * &mask)?;
        }
    }
    let density = &field.nerf.density;
    let raw = inputs.only_inside(linear(&hidden, density)?.broadcast_add(bias(density))?.squeeze(1)?)?;
    let [x, y, z, laplacian] = tangents.map(|tangent| linear(&tangent, density));
    let gradient = Tensor::cat(&[x?, y?, z?], 1)?;
    let activated = Activated::new(config.density_activation, &raw)?;
    let (gradient, laplacian) = activated.chain(&gradient, &laplacian?.squeeze(1)?)?;
    Ok((activated.value, gradient, laplacian))
}
