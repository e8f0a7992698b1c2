//! Adam with moments that can be saved, and the learning-rate curve.

use candle_core::{CpuStorage, InplaceOp2, InplaceOp3, Layout, Tensor, Var};
use rayon::prelude::*;

use crate::config::TrainConfig;
use crate::error::Result;

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// The learning rate of the update that follows `step` finished ones:
/// learning_rate * decay_rate^(step / decay_steps).
pub fn learning_rate(config: &TrainConfig, step: u64) -> f64 {
    let decay_steps = config.decay_steps.expect("resolved") as f64;
    config.learning_rate * config.decay_rate.powf(step as f64 / decay_steps)
}

/// First and second moment of one parameter.
pub struct Moments {
    /// Mean of gradients.
    pub first: Tensor,
    /// Mean of squared gradients.
    pub second: Tensor,
}

/// Adam (Kingma and Ba 2015) without weight decay.
pub struct Adam {
    variables: Vec<(String, Var)>,
    moments: Vec<Moments>,
}

impl Adam {
    /// Moments at zero.
    pub fn new(variables: Vec<(String, Var)>) -> Result<Adam> {
        let zero = |(_, var): &(String, Var)| -> Result<Moments> {
            Ok(Moments { first: var.zeros_like()?, second: var.zeros_like()? })
        };
        let moments = variables.iter().map(zero).collect::<Result<_>>()?;
        Ok(Adam { variables, moments })
    }

    /// Saved moments, in the order of the variables.
    pub fn restore(variables: Vec<(String, Var)>, moments: Vec<Moments>) -> Adam {
        assert_eq!(variables.len(), moments.len(), "one pair of moments a parameter");
        Adam { variables, moments }
    }

    /// The parameters that are updated.
    pub fn variables(&self) -> &[(String, Var)] {
        &self.variables
    }

    /// The moments, in the order of the variables.
    pub fn moments(&self) -> &[Moments] {
        &self.moments
    }

    /// One update with `gradients` in the order of the variables; `updates` counts this one, too
    /// (1 for the first). A parameter without gradient has gradient 0.
    pub fn update(&mut self, gradients: &[Option<Tensor>], learning_rate: f64, updates: u64) -> Result<()> {
        let correction1 = 1.0 - BETA1.powf(updates as f64);
        let correction2 = 1.0 - BETA2.powf(updates as f64);
        if self.variables.iter().all(|(_, var)| var.device().is_cpu()) {
            let update = Update { rate: learning_rate / correction1, correction2 };
            let all = self.variables.par_iter().zip(&self.moments).zip(gradients);
            return all.try_for_each(|(((_, var), moments), gradient)| update.apply(var, moments, gradient.as_ref()));
        }
        for (((_, var), moments), gradient) in self.variables.iter().zip(&mut self.moments).zip(gradients) {
            let zero;
            let gradient = match gradient {
                Some(gradient) => gradient,
                None => {
                    zero = var.zeros_like()?;
                    &zero
                }
            };
            moments.first = ((&moments.first * BETA1)? + (gradient * (1.0 - BETA1))?)?;
            moments.second = ((&moments.second * BETA2)? + (gradient.sqr()? * (1.0 - BETA2))?)?;
            let scale = ((&moments.second / correction2)?.sqrt()? + EPSILON)?;
            let step = ((&moments.first * (learning_rate / correction1))? / scale)?;
            var.set(&(var.as_tensor() - step)?)?;
        }
        Ok(())
    }
}

/// The update in place, on a processor.
struct Update {
    /// The learning rate over the first moment's correction.
    rate: f64,
    correction2: f64,
}

/// A moment moves towards the gradient, or its square.
struct Move {
    beta: f64,
    squared: bool,
}

impl Update {
    fn apply(&self, var: &Var, moments: &Moments, gradient: Option<&Tensor>) -> Result<()> {
        let zero;
        let gradient = match gradient {
            Some(gradient) => &gradient.contiguous()?,
            None => {
                zero = var.zeros_like()?;
                &zero
            }
        };
        moments.first.inplace_op2(gradient, &Move { beta: BETA1, squared: false })?;
        moments.second.inplace_op2(gradient, &Move { beta: BETA2, squared: true })?;
        Ok(var.inplace_op3(&moments.first, &moments.second, self)?)
    }
}

/// The values of whole tensors: one to change, others to read.
macro_rules! whole {
    ($storage:expr, $layout:expr, $kind:ident) => {
        match ($storage, $layout.contiguous_offsets()) {
            (CpuStorage::$kind(values), Some((start, end))) => &values[start..end],
            _ => candle_core::bail!("adam: parameters, moments and gradients are of one type and whole"),
        }
    };
}

impl InplaceOp2 for Move {
    fn name(&self) -> &'static str {
        "adam-moment"
    }

    fn cpu_fwd(
        &self,
        moment: &mut CpuStorage,
        at: &Layout,
        gradient: &CpuStorage,
        layout: &Layout,
    ) -> candle_core::Result<()> {
        macro_rules! update {
            ($kind:ident, $real:ty, $moments:expr) => {{
                let gradient = whole!(gradient, layout, $kind);
                let (keep, take) = (self.beta as $real, (1.0 - self.beta) as $real);
                for (moment, g) in $moments[at.start_offset()..].iter_mut().zip(gradient) {
                    *moment = *moment * keep + take * if self.squared { g * g } else { *g };
                }
                Ok(())
            }};
        }
        match moment {
            CpuStorage::F32(moments) => update!(F32, f32, moments),
            CpuStorage::F64(moments) => update!(F64, f64, moments),
            _ => candle_core::bail!("adam is for f32 and f64"),
        }
    }
}

impl InplaceOp3 for Update {
    fn name(&self) -> &'static str {
        "adam-update"
    }

    fn cpu_fwd(
        &self,
        parameters: &mut CpuStorage,
        at: &Layout,
        first: &CpuStorage,
        first_layout: &Layout,
        second: &CpuStorage,
        second_layout: &Layout,
    ) -> candle_core::Result<()> {
        macro_rules! update {
            ($kind:ident, $real:ty, $parameters:expr) => {{
                let (first, second) = (whole!(first, first_layout, $kind), whole!(second, second_layout, $kind));
                let (rate, correction2, epsilon) = (self.rate as $real, self.correction2 as $real, EPSILON as $real);
                for ((p, m), v) in $parameters[at.start_offset()..].iter_mut().zip(first).zip(second) {
                    *p -= m * rate / ((v / correction2).sqrt() + epsilon);
                }
                Ok(())
            }};
        }
        match parameters {
            CpuStorage::F32(parameters) => update!(F32, f32, parameters),
            CpuStorage::F64(parameters) => update!(F64, f64, parameters),
            _ => candle_core::bail!("adam is for f32 and f64"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    /// By hand: with one gradient g the first step is learning_rate * sign(g), whatever |g|.
    #[test]
    fn the_first_step_is_the_learning_rate() {
        let var = Var::new(&[1.0f64, -2.0, 3.0], &Device::Cpu).unwrap();
        let mut adam = Adam::new(vec![("p".into(), var.clone())]).unwrap();
        let gradient = Tensor::new(&[4.0f64, -0.5, 0.0], &Device::Cpu).unwrap();
        adam.update(&[Some(gradient)], 0.1, 1).unwrap();
        let found = var.to_vec1::<f64>().unwrap();
        assert!(found.iter().zip([0.9, -1.9, 3.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
    }

    /// The scalar recursion of the paper, algorithm 1, written out.
    #[test]
    fn many_steps_follow_the_scalar_recursion() {
        let var = Var::new(&[0.3f64], &Device::Cpu).unwrap();
        let mut adam = Adam::new(vec![("p".into(), var.clone())]).unwrap();
        let (mut p, mut m, mut v) = (0.3f64, 0.0f64, 0.0f64);
        for t in 1..=20 {
            let g = (t as f64).sin();
            m = 0.9 * m + 0.1 * g;
            v = 0.999 * v + 0.001 * g * g;
            p -= 0.01 * (m / (1.0 - 0.9f64.powi(t))) / ((v / (1.0 - 0.999f64.powi(t))).sqrt() + 1e-8);
            adam.update(&[Some(Tensor::new(&[g], &Device::Cpu).unwrap())], 0.01, t as u64).unwrap();
        }
        assert!((var.to_vec1::<f64>().unwrap()[0] - p).abs() < 1e-12);
    }
}
