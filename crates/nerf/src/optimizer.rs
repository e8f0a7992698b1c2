//! Adam with moments that can be saved, and the learning-rate schedule.

use augnerf_fast::adam;
use candle_core::{Tensor, Var};
use rayon::prelude::*;

use crate::base::Result;
use crate::base::place::is_ours_in_f32;
use crate::settings::{Resolved, Schedule, TrainConfig};

use crate::methods::OCCUPANCY;

const BETA1: f64 = 0.9;

/// The settings of Adam in a run.
#[derive(Clone, Copy, Debug)]
pub struct AdamSettings {
    /// Decay of squared gradients.
    pub beta2: f64,
    /// Added to the divisor.
    pub epsilon: f64,
    /// Decoupled decay of layers' weights (Loshchilov and Hutter 2019, algorithm 2): before an update they are multiplied by 1
    /// minus this times the learning rate. Biases and tables do not decay.
    pub weight_decay: f64,
}

impl AdamSettings {
    /// Returns the settings of a run.
    pub fn of(train: &TrainConfig) -> AdamSettings {
        AdamSettings { beta2: train.adam_beta2, epsilon: train.adam_epsilon, weight_decay: train.weight_decay }
    }
}

/// Returns the learning rate of the update after `step` finished ones.
///
/// - Exponential: learning_rate * decay_rate^(step / decay_steps).
/// - Log-linear (Barron et al. 2021): learning_rate^(1 - s) * final_learning_rate^s at the fraction s of the steps,
///   times warmup_from + (1 - warmup_from) sin(pi/2 min(s / warmup_share, 1)).
pub fn learning_rate(config: &Resolved, step: u64) -> f64 {
    let train = &config.train;
    match train.schedule {
        Schedule::Exponential => {
            let decay_steps = config.decay_steps as f64;
            train.learning_rate * train.decay_rate.powf(step as f64 / decay_steps)
        }
        Schedule::LogLinear => {
            let fraction = step as f64 / train.steps as f64;
            let log_linear = train.learning_rate.powf(1.0 - fraction) * train.final_learning_rate.powf(fraction);
            if fraction >= train.warmup_share {
                return log_linear;
            }
            let warmup = (std::f64::consts::FRAC_PI_2 * fraction / train.warmup_share).sin();
            log_linear * (train.warmup_from + (1.0 - train.warmup_from) * warmup)
        }
    }
}

/// First and second moment of one parameter.
pub struct Moments {
    /// Mean of gradients.
    pub first: Tensor,
    /// Mean of squared gradients.
    pub second: Tensor,
}

impl Moments {
    /// Returns moments of 0, in the order of the variables.
    ///
    /// # Errors
    /// Those of candle.
    pub fn zero(variables: &[(String, Var)]) -> Result<Vec<Moments>> {
        let zero = |(_, var): &(String, Var)| Ok(Moments { first: var.zeros_like()?, second: var.zeros_like()? });
        variables.iter().map(zero).collect()
    }
}

/// Adam (Kingma and Ba 2015).
pub struct Adam {
    settings: AdamSettings,
    variables: Vec<(String, Var)>,
    moments: Vec<Moments>,
}

impl Adam {
    /// Creates an optimizer with moments of zero.
    pub fn new(settings: AdamSettings, variables: Vec<(String, Var)>) -> Result<Adam> {
        let moments = Moments::zero(&variables)?;
        Ok(Adam { settings, variables, moments })
    }

    /// Creates an optimizer with saved moments, in the order of the variables.
    pub fn restore(settings: AdamSettings, variables: Vec<(String, Var)>, moments: Vec<Moments>) -> Adam {
        assert_eq!(variables.len(), moments.len(), "one pair of moments a parameter");
        Adam { settings, variables, moments }
    }

    /// Returns the parameters that are updated.
    pub fn variables(&self) -> &[(String, Var)] {
        &self.variables
    }

    /// Returns the moments, in the order of the variables.
    pub fn moments(&self) -> &[Moments] {
        &self.moments
    }

    /// Updates the parameters with `gradients`, in the order of the variables. `updates` counts this update as well (1
    /// for the first). A missing gradient counts as 0.
    pub fn update(&mut self, gradients: &[Option<Tensor>], learning_rate: f64, updates: u64) -> Result<()> {
        let correction1 = 1.0 - BETA1.powf(updates as f64);
        let AdamSettings { beta2, epsilon, weight_decay } = self.settings;
        for (_, var) in self.variables.iter().filter(|(name, _)| weight_decay > 0.0 && decays(name)) {
            var.set(&(var.as_tensor() * (1.0 - learning_rate * weight_decay))?)?;
        }
        let correction2 = 1.0 - beta2.powf(updates as f64);
        if self.variables.iter().all(|(_, var)| is_ours_in_f32(var)) {
            let update =
                adam::Update { betas: [BETA1, beta2], epsilon, rate: learning_rate / correction1, correction2 };
            let parameters = self.variables.par_iter().zip(&self.moments).zip(gradients);
            return parameters.try_for_each(|(((name, var), moments), gradient)| {
                Ok(update.apply(var, [&moments.first, &moments.second], gradient.as_ref(), is_table(name))?)
            });
        }
        for (((name, var), moments), gradient) in self.variables.iter().zip(&mut self.moments).zip(gradients) {
            let gradient = match gradient {
                Some(gradient) => gradient.clone(),
                None if is_table(name) => continue,
                None => var.zeros_like()?,
            };
            let mut first = ((&moments.first * BETA1)? + (&gradient * (1.0 - BETA1))?)?;
            let mut second = ((&moments.second * beta2)? + (gradient.sqr()? * (1.0 - beta2))?)?;
            let scale = ((&second / correction2)?.sqrt()? + epsilon)?;
            let mut updated = (var.as_tensor() - ((&first * (learning_rate / correction1))? / scale)?)?;
            if is_table(name) {
                // An entry without a gradient keeps its values and its moments.
                let has_gradient = gradient.ne(0f64)?.to_dtype(gradient.dtype())?.max_keepdim(1)?.gt(0f64)?;
                let has_gradient = has_gradient.broadcast_as(gradient.shape())?;
                first = has_gradient.where_cond(&first, &moments.first)?;
                second = has_gradient.where_cond(&second, &moments.second)?;
                updated = has_gradient.where_cond(&updated, var.as_tensor())?;
            }
            *moments = Moments { first, second };
            var.set(&updated)?;
        }
        Ok(())
    }
}

/// Returns whether the parameter is a layer's weights. Those of an LSTM are `weight_ih` and `weight_hh`.
fn decays(name: &str) -> bool {
    name.rsplit('.').next().is_some_and(|part| part.starts_with("weight"))
}

/// Returns whether an update leaves entries without gradient as they are, including moments: those of a hash grid's table
/// (Mueller et al. 2022), and occupied cells, which have none.
fn is_table(name: &str) -> bool {
    name.ends_with(".table") || name == OCCUPANCY
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    /// By hand: with one gradient g the first step is learning_rate * sign(g), whatever |g|.
    #[test]
    fn the_first_step_is_the_learning_rate() {
        let var = Var::new(&[1.0f64, -2.0, 3.0], &Device::Cpu).unwrap();
        let mut adam = Adam::new(AdamSettings::of(&TrainConfig::default()), vec![("p".into(), var.clone())]).unwrap();
        let gradient = Tensor::new(&[4.0f64, -0.5, 0.0], &Device::Cpu).unwrap();
        adam.update(&[Some(gradient)], 0.1, 1).unwrap();
        let values = var.to_vec1::<f64>().unwrap();
        assert!(values.iter().zip([0.9, -1.9, 3.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{values:?}");
    }

    /// The scalar recursion of the paper, algorithm 1, written out.
    #[test]
    fn many_steps_follow_the_scalar_recursion() {
        let var = Var::new(&[0.3f64], &Device::Cpu).unwrap();
        let mut adam = Adam::new(AdamSettings::of(&TrainConfig::default()), vec![("p".into(), var.clone())]).unwrap();
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

    /// Without a gradient a weight falls by the rate times the decay, times itself; a bias and a table keep their size, and
    /// so do other parameters of a head that is called weights.
    #[test]
    fn weights_alone_decay() {
        const NAMES: [&str; 7] = [
            "coarse.trunk.0.weight",
            "lstm.weight_ih",
            "lstm.weight_hh",
            "coarse.trunk.0.bias",
            "lstm.bias_ih",
            "volume.warp.weights.0.bias",
            "coarse.table",
        ];
        let variables = NAMES.map(|name| (name.to_string(), Var::new(&[[2.0f64]], &Device::Cpu).unwrap()));
        let train = TrainConfig { weight_decay: 0.5, ..TrainConfig::default() };
        let mut adam = Adam::new(AdamSettings::of(&train), variables.to_vec()).unwrap();
        let zero = Tensor::new(&[[0.0f64]], &Device::Cpu).unwrap();
        for updates in 1..=2 {
            adam.update(&[Some(zero.clone()), None, None, None, None, None, None], 0.1, updates).unwrap();
        }
        let values = variables.map(|(_, var)| var.to_vec2::<f64>().unwrap()[0][0]);
        let decayed = 2.0 * 0.95 * 0.95;
        assert_eq!(values, [decayed, decayed, decayed, 2.0, 2.0, 2.0, 2.0]);
    }
}
