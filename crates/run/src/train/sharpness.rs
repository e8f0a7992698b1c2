//! Steps whose gradient is that at worse weights (sharpness-aware minimization: Foret et al. 2021).

use candle_core::{Tensor, Var};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::methods::Gradients;
use crate::settings::{Config, SamDirection};

/// Moves weights up the gradient of a step, or as far at random:
///
/// ```text
///     displacement = radius * g / |g|
/// ```
///
/// The norm is over all parameters. A random direction is normal in the numbers at which g is not 0. Entries of a table
/// that no ray of the step reads therefore stay in both.
pub(super) struct Sharpness {
    radius: f64,
    direction: SamDirection,
    seed: u64,
}

/// Parts of the random stream.
#[derive(Clone, Copy)]
pub(super) enum Draw {
    /// The displacement of a step.
    Step = 0,
    /// The random one that a step's gain is compared with.
    Compared = 1,
}

impl Sharpness {
    /// Returns `None` if the weights do not move.
    pub(super) fn of(config: &Config) -> Option<Sharpness> {
        let (radius, direction) = (config.train.sam_radius, config.train.sam_direction);
        (radius > 0.0).then_some(Sharpness { radius, direction, seed: config.seed })
    }

    /// Returns the displacement of each parameter in the step after `step` finished ones.
    pub(super) fn displacement(&self, gradients: &Gradients, step: u64) -> Result<Gradients> {
        match self.direction {
            SamDirection::Gradient => self.scaled(Gradients(gradients.0.clone())),
            SamDirection::Random => self.random(gradients, step, Draw::Step),
        }
    }

    /// Returns a random displacement of the same length.
    pub(super) fn random(&self, gradients: &Gradients, step: u64, draw: Draw) -> Result<Gradients> {
        let of_parameter = |(index, gradient): (usize, &Option<Tensor>)| -> Result<Option<Tensor>> {
            let Some(gradient) = gradient else { return Ok(None) };
            let part = 2 * index as u64 + draw as u64;
            let mut random = Random::part(self.seed, Stream::Sharpness, step, part);
            let normal = random.normal_tensor(gradient.dims(), gradient.dtype(), gradient.device())?;
            Ok(Some((normal * gradient.ne(0f64)?.to_dtype(gradient.dtype())?)?))
        };
        self.scaled(Gradients(gradients.0.iter().enumerate().map(of_parameter).collect::<Result<_>>()?))
    }

    fn scaled(&self, direction: Gradients) -> Result<Gradients> {
        let norm = direction.norm()?;
        let factor = if norm > 0.0 { self.radius / norm } else { 0.0 };
        let scaled = direction.0.into_iter().map(|part| part.map(|part| part * factor).transpose());
        Ok(Gradients(scaled.collect::<candle_core::Result<_>>()?))
    }
}

/// Calls `work` at moved parameters, which afterwards are as before, whatever it returns.
pub(super) fn at_moved<T>(
    variables: &[(String, Var)],
    displacement: &Gradients,
    work: impl FnOnce() -> Result<T>,
) -> Result<T> {
    let before: Vec<Tensor> =
        variables.iter().map(|(_, var)| var.as_tensor().copy()).collect::<candle_core::Result<_>>()?;
    let moved = || -> Result<()> {
        for (((_, var), before), by) in variables.iter().zip(&before).zip(&displacement.0) {
            if let Some(by) = by {
                var.set(&(before + by)?)?;
            }
        }
        Ok(())
    };
    let result = moved().and_then(|()| work());
    for ((_, var), before) in variables.iter().zip(&before) {
        var.set(before)?;
    }
    result
}

/// Limits gradients: each number to `value`, then all together to the norm `norm`. 0 is no limit.
pub(super) fn clipped(gradients: Gradients, value: f64, norm: f64) -> Result<Gradients> {
    let each = |change: &dyn Fn(Tensor) -> candle_core::Result<Tensor>, gradients: Gradients| -> Result<Gradients> {
        let changed = gradients.0.into_iter().map(|part| part.map(change).transpose());
        Ok(Gradients(changed.collect::<candle_core::Result<_>>()?))
    };
    let mut gradients = gradients;
    if value > 0.0 {
        gradients = each(&|part| part.clamp(-value, value), gradients)?;
    }
    if norm > 0.0 {
        let found = gradients.norm()?;
        if found > norm {
            gradients = each(&|part| part * (norm / found), gradients)?;
        }
    }
    Ok(gradients)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    fn row(values: &[f64]) -> Tensor {
        Tensor::from_slice(values, values.len(), &Device::Cpu).unwrap()
    }

    fn flat(gradients: &Gradients) -> Vec<f64> {
        gradients.0.iter().flatten().flat_map(|part| part.to_vec1::<f64>().unwrap()).collect()
    }

    /// Of the loss w'Hw / 2 the gradient at moved weights is H (w + radius Hw / |Hw|).
    #[test]
    fn a_quadratic_has_its_closed_form() {
        let (h, w, radius) = ([4.0, 1.0, 0.5], [0.3, -2.0, 1.0], 0.05);
        let var = Var::from_tensor(&row(&w)).unwrap();
        let variables = vec![("w".to_string(), var.clone())];
        let gradient = || Gradients(vec![Some((var.as_tensor() * row(&h)).unwrap().copy().unwrap())]);
        let sharpness = Sharpness { radius, direction: SamDirection::Gradient, seed: 0 };
        let displacement = sharpness.displacement(&gradient(), 0).unwrap();
        let found = at_moved(&variables, &displacement, || Ok(gradient())).unwrap();
        let norm = h.iter().zip(w).map(|(h, w)| (h * w).powi(2)).sum::<f64>().sqrt();
        for (i, found) in flat(&found).into_iter().enumerate() {
            assert!((found - h[i] * (w[i] + radius * h[i] * w[i] / norm)).abs() < 1e-12);
        }
        assert_eq!(var.to_vec1::<f64>().unwrap(), w);
        // What fails leaves no trace.
        let failed =
            at_moved(&variables, &displacement, || -> Result<()> { Err(crate::base::Error::Config("no".into())) });
        assert!(failed.is_err() && var.to_vec1::<f64>().unwrap() == w);
    }

    #[test]
    fn a_random_displacement_is_as_long_and_stays_where_nothing_is_read() {
        let gradients = Gradients(vec![Some(row(&[0.1, 0.0, -3.0])), None, Some(row(&[0.0, 2.0]))]);
        let sharpness = Sharpness { radius: 0.2, direction: SamDirection::Random, seed: 4 };
        let of = |step: u64| flat(&sharpness.displacement(&gradients, step).unwrap());
        let found = of(7);
        assert!((found.iter().map(|x| x * x).sum::<f64>().sqrt() - 0.2).abs() < 1e-12);
        assert_eq!((found[1], found[3]), (0.0, 0.0));
        assert_eq!(found, of(7));
        assert_ne!(found, of(8));
        assert_ne!(found, flat(&sharpness.random(&gradients, 7, Draw::Compared).unwrap()));
        let nothing = sharpness.displacement(&Gradients(vec![Some(row(&[0.0, 0.0]))]), 0).unwrap();
        assert_eq!(flat(&nothing), [0.0, 0.0]);
    }

    #[test]
    fn gradients_are_clipped_by_number_and_by_norm() {
        let gradients = || Gradients(vec![Some(row(&[3.0, -0.2])), None, Some(row(&[-4.0]))]);
        let of = |value: f64, norm: f64| flat(&clipped(gradients(), value, norm).unwrap());
        assert_eq!(of(0.0, 0.0), [3.0, -0.2, -4.0]);
        assert_eq!(of(1.0, 0.0), [1.0, -0.2, -1.0]);
        let short = of(0.0, 1.0);
        let norm = (9.0f64 + 0.04 + 16.0).sqrt();
        assert!(short.iter().zip([3.0, -0.2, -4.0]).all(|(a, b)| (a - b / norm).abs() < 1e-12));
        assert_eq!(of(0.0, 9.0), [3.0, -0.2, -4.0]);
    }
}
