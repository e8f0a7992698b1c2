//! Density with its exact gradient and Laplacian in space, and the weight gradients of any function of the three.
//!
//! A trunk of ReLU layers is linear between its kinks. Three tangents of the encoding and the sum of its second derivatives
//! therefore pass through it as its input does, without biases and with the masks of active units. Masks are constant almost
//! everywhere, so that holding them loses nothing. The jumps of the gradient on the kinks themselves are ignored.

use candle_core::{Tensor, Var};
use candle_nn::Module;

use crate::base::Result;
use crate::base::tensors::relu;

use super::activation::{Activated, Cotangents};
use super::encoding::encode;
use super::fast::Tape;
use super::waves::Waves;
use super::{Field, TableRecord, tensor_error};

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

impl Order {
    /// Returns the number of derivatives: along three axes, and the Laplacian.
    pub(super) fn derivatives(self) -> usize {
        match self {
            Order::Density => 0,
            Order::Gradient => 3,
            Order::Laplacian => 4,
        }
    }
}

/// [`DensityAt`], detached, with what is needed for the weight gradients of any function of it.
pub struct Spatial<'a> {
    /// Density, gradient and Laplacian at the points.
    pub at: DensityAt,
    field: &'a Field,
    backward: Backward,
}

/// How weight gradients are computed.
enum Backward {
    /// By candle, from the same derivatives in its graph.
    Graph(DensityAt),
    /// By the fused core.
    Tape(Box<Tape>),
}

impl Field {
    /// Returns the gradient of density in space, `[n, 3]`, of a field queried at `positions`: points `[n, 3]`, or
    /// Gaussians `[n, 6]` whose means move.
    pub fn density_gradient(&self, positions: &Tensor) -> Result<Tensor> {
        let tracked = Var::from_tensor(positions)?;
        let density = self.activate_density(&self.frozen()?.raw_density(&tracked)?)?;
        let gradients = density.sum_all()?.backward()?;
        let gradient =
            gradients.get(&tracked).map_or_else(|| positions.zeros_like(), |gradient| Ok(gradient.clone()))?;
        Ok(gradient.narrow(1, 0, 3)?)
    }

    /// Returns density, gradient and Laplacian at `points [n, 3]`. A prepared field ([`Field::prepared`]) computes them by
    /// the fused core.
    pub fn spatial(&self, points: &Tensor) -> Result<Spatial<'_>> {
        self.spatial_up_to(Order::Laplacian, points)
    }

    /// Returns the same up to a derivative, without work for higher ones.
    pub fn spatial_up_to(&self, order: Order, points: &Tensor) -> Result<Spatial<'_>> {
        if self.config.encoding.queries_gaussians() {
            return Err(tensor_error("density's derivatives are those of a field that is queried at points".into()));
        }
        let order = if self.config.has_laplacian() { order } else { order.min(Order::Gradient) };
        if let Some(fast) = &self.fast {
            let (at, tape) = fast.spatial(self, order, points)?;
            return Ok(Spatial { at, field: self, backward: Backward::Tape(Box::new(tape)) });
        }
        let graph = self.spatial_in_graph(order, &points.detach())?;
        let DensityAt { density, gradient, laplacian } = &graph;
        let at = DensityAt { density: density.detach(), gradient: gradient.detach(), laplacian: laplacian.detach() };
        Ok(Spatial { at, field: self, backward: Backward::Graph(graph) })
    }

    fn spatial_in_graph(&self, order: Order, points: &Tensor) -> Result<DensityAt> {
        let derivatives = self.encoding_derivatives(order, points)?;
        let (encoded, start) = derivatives.split_first().expect("the encoding itself");
        let (mut hidden, mut tangents) = (encoded.clone(), start.to_vec());
        for (i, layer) in self.nerf.trunk.iter().enumerate() {
            if self.config.skips.contains(&i) {
                hidden = Tensor::cat(&[encoded, &hidden], 1)?;
                for (tangent, start) in tangents.iter_mut().zip(start) {
                    *tangent = Tensor::cat(&[start, tangent], 1)?;
                }
            }
            let before = layer.forward(&hidden)?;
            let is_active = before.detach().gt(0f64)?.to_dtype(before.dtype())?;
            hidden = relu(&before)?;
            for tangent in &mut tangents {
                *tangent = (tangent.matmul(&layer.weight().t()?)? * &is_active)?;
            }
        }
        let raw = self.nerf.raw_density(&hidden)?;
        let raw = match self.grid.as_ref().map(|grid| grid.inside(points)).transpose()?.flatten() {
            Some(inside) => inside.only(&raw)?,
            None => raw,
        };
        let head = self.nerf.density.weight().t()?;
        let slopes = tangents.iter().map(|tangent| tangent.matmul(&head)).collect::<candle_core::Result<Vec<_>>>()?;
        let gradient = match slopes.get(..3) {
            Some(slopes) => Tensor::cat(slopes, 1)?,
            None => not_requested(&raw, &[3])?,
        };
        let laplacian = match slopes.get(3) {
            Some(laplacian) => laplacian.squeeze(1)?,
            None => not_requested(&raw, &[])?,
        };
        let activated = Activated::new(self.config.density_activation, &raw)?;
        let (gradient, laplacian) = activated.chain(&gradient, &laplacian)?;
        Ok(DensityAt { density: activated.value, gradient, laplacian })
    }

    /// Returns the encoding of points `[n, 3]`, its derivative along each axis and its Laplacian, up to `order`, each
    /// `[n, channels]`.
    fn encoding_derivatives(&self, order: Order, points: &Tensor) -> Result<Vec<Tensor>> {
        let Some(grid) = &self.grid else {
            let encoded = encode(points, self.config.position_octaves)?;
            let derivatives = Waves::new(&encoded, self.config.position_octaves)?.derivatives()?;
            return Ok([encoded].into_iter().chain(derivatives).take(1 + order.derivatives()).collect());
        };
        Ok(grid.derivatives(points, order)?)
    }
}

impl Spatial<'_> {
    /// Returns the gradients of a loss with these derivatives, in the order of [`Field::parameter_names`]. Entries are
    /// `None` for layers on which density does not depend. That of a hash grid's table may be a record for
    /// [`Field::table_gradient`]: it is as large as the table, and is best made of many records at once.
    ///
    /// # Errors
    /// The field is frozen, and the fused core does not compute it. Also errors of candle.
    pub fn weight_gradients(&self, loss: &Cotangents) -> Result<(Vec<Option<Tensor>>, Option<TableRecord>)> {
        let graph = match &self.backward {
            Backward::Tape(tape) => return tape.weight_gradients(self.field, loss),
            Backward::Graph(graph) => graph,
        };
        let variables = self.field.variables();
        if variables.is_empty() {
            return Err(tensor_error("a frozen field has weight gradients only if the fused core computes it".into()));
        }
        let pairs =
            [(&graph.density, &loss.density), (&graph.gradient, &loss.gradient), (&graph.laplacian, &loss.laplacian)];
        let requested = pairs.into_iter().filter_map(|(value, slope)| Some((value, slope.as_ref()?)));
        let products =
            requested.map(|(value, slope)| (value * slope)?.sum_all()).collect::<candle_core::Result<Vec<_>>>()?;
        if products.is_empty() {
            return Ok((vec![None; variables.len()], None));
        }
        let store = Tensor::stack(&products, 0)?.sum_all()?.backward()?;
        Ok((variables.iter().map(|(_, variable)| store.get(variable).cloned()).collect(), None))
    }
}

/// Returns NaN of `shape` for each number of `raw [n]`.
pub(super) fn not_requested(raw: &Tensor, shape: &[usize]) -> Result<Tensor> {
    let shape = [&[raw.dim(0)?], shape].concat();
    Ok(Tensor::full(f64::NAN, shape, raw.device())?.to_dtype(raw.dtype())?)
}
