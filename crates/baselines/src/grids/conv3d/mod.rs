//! Convolutions in three dimensions, plain and transposed, as products over taps.
//!
//! Row `r` of the result is `bias + sum over taps of x[cell(r, tap)] W[tap]`, where a cell outside the grid holds
//! zeros. A transposed convolution that doubles the sides is eight such products of 2 x 2 x 2 taps, one for each parity
//! of the result's cells. No tap then reads an inserted zero.

mod plain;
mod plan;
mod product;

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp3, Device, Layout, Result, Shape, Tensor};

use crate::base::place::is_ours_in_f32;

use plan::Plan;
use product::Rhs;

use super::values::{Values, slice};

/// A convolution on grids of one size, with weights `[taps, inputs, outputs]`.
#[derive(Clone)]
pub struct Conv3d {
    plan: Arc<Plan>,
    /// The plan of the input's gradient.
    reversed: Arc<Plan>,
    /// Position of each matrix of the weights in the convolution's kernel, along z, y, x.
    kernel: Vec<[usize; 3]>,
    slope: f64,
}

impl Conv3d {
    /// Creates a convolution of 3 x 3 x 3 taps, `dilation` cells apart, at every `stride`-th cell of a grid. Padding is
    /// zero, as with TensorFlow's `SAME`: on either side, and with stride 2, which is of grids of even sides, after the last
    /// cell alone.
    pub fn convolution(sides: [usize; 3], stride: usize, dilation: usize) -> Conv3d {
        let kernel = plan::cube(3).collect();
        Conv3d::new(Plan::convolution(sides, stride, dilation), kernel)
    }

    /// Creates a transposed convolution of 4 x 4 x 4 taps with stride 2 and padding 1, which doubles the sides.
    pub fn transposed(sides: [usize; 3]) -> Conv3d {
        let (plan, kernel) = Plan::transposed(sides);
        Conv3d::new(plan, kernel)
    }

    fn new(plan: Plan, kernel: Vec<[usize; 3]>) -> Conv3d {
        Conv3d { reversed: Arc::new(plan.reversed()), plan: Arc::new(plan), kernel, slope: 1.0 }
    }

    /// Adds a leaky ReLU: negative results are multiplied by `slope`, a positive number.
    pub fn leaky(self, slope: f64) -> Conv3d {
        Conv3d { slope, ..self }
    }

    /// Returns the position of each matrix of the weights in a kernel `[.., z, y, x]`: which entry to read for the
    /// first, the second and so on.
    pub fn kernel(&self) -> &[[usize; 3]] {
        &self.kernel
    }

    /// Applies the convolution: `x [z, y, x, inputs]`, `weight [taps, inputs, outputs]` in the order of
    /// [`Conv3d::kernel`], `bias [outputs]` -> `[z', y', x', outputs]`.
    pub fn forward(&self, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
        if !is_ours_in_f32(x) {
            return self.plain(x, weight, bias);
        }
        let operation = Fast {
            product: self.clone(),
            wants_x: x.track_op(),
            wants_weight: weight.track_op(),
            wants_bias: bias.track_op(),
        };
        x.contiguous()?.apply_op3(&weight.contiguous()?, &bias.contiguous()?, operation)
    }

    /// The same in candle's own operations.
    pub fn plain(&self, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
        plain::product(&self.plan, self.slope, x, weight, bias)
    }
}

/// The convolution in f32 with the requested gradients.
struct Fast {
    product: Conv3d,
    wants_x: bool,
    wants_weight: bool,
    wants_bias: bool,
}

impl CustomOp3 for Fast {
    fn name(&self) -> &'static str {
        "tap-product"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (x, weight) = (slice::<f32>(x, x_layout)?, slice::<f32>(weight, weight_layout)?);
        let bias = slice::<f32>(bias, bias_layout)?;
        let Conv3d { plan, slope, .. } = &self.product;
        let (channels, outputs) = (x_layout.dims()[3], bias.len());
        let finish = |rows: &mut [f32]| product::add_bias(rows, bias, *slope as f32);
        let out = product::product(plan, x, channels, &Rhs::Straight(weight), outputs, &finish);
        let [z, y, x] = plan.sides;
        Ok((CpuStorage::F32(plan.interleaved(out, outputs)), Shape::from((z, y, x, outputs))))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let Conv3d { plan, reversed, slope, .. } = &self.product;
        let (channels, outputs) = (x.dim(3)?, bias.elem_count());
        let gradient = gradient.contiguous()?;
        let d_rows =
            plan.deinterleaved(Values::of(&gradient).slice()?, Values::of(out).slice()?, outputs, *slope as f32);
        let like = |values: Vec<f32>, tensor: &Tensor| Tensor::from_vec(values, tensor.shape(), &Device::Cpu);
        let d_x = self.wants_x.then(|| {
            let weight = Values::of(weight);
            let right = Rhs::turned(weight.slice()?, reversed, channels, outputs);
            let d_x = product::product(reversed, &d_rows, outputs, &right, channels, &|_| {});
            like(reversed.interleaved(d_x, channels), x)
        });
        let d_weight = self.wants_weight.then(|| {
            let x = Values::of(x);
            like(product::weight_gradient(plan, x.slice()?, channels, &d_rows, outputs), weight)
        });
        let d_bias = self.wants_bias.then(|| like(product::bias_gradient(&d_rows, outputs), bias));
        Ok((d_x.transpose()?, d_weight.transpose()?, d_bias.transpose()?))
    }
}

#[cfg(test)]
mod tests;
