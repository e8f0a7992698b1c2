//! Density near the cameras (FreeNeRF: Yang, Pavone and Wang 2023, section 3.4).

use candle_core::{D, DType, Tensor};

use crate::base::Result;

use super::{RayPass, RayTerm};

/// The integral of density over the `share` of near..far that is next to the camera:
///
/// ```text
///     sum over samples of density_k abs([s_k, s_(k+1)] within [0, share]),   s = (t - near) / (far - near)
/// ```
///
/// FreeNeRF takes the mean over the first M samples instead, times M / N. Importance sampling moves these, so that of a
/// hash grid's 32 they are most of the ray. With N evenly spaced samples and share = M / N both are the same.
pub struct Occlusion {
    /// Share of near..far in which density counts.
    pub share: f64,
}

impl RayTerm for Occlusion {
    fn name(&self) -> &str {
        "occlusion"
    }

    fn is_of_evaluated_pass(&self) -> bool {
        true
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let density = &pass.output.density;
        // The part of each interval that is in the share.
        let inside = pass.edges()?.clamp(0.0, self.share)?.to_dtype(DType::F64)?;
        let samples = pass.samples()?;
        let lengths = (inside.narrow(1, 1, samples)? - inside.narrow(1, 0, samples)?)?;
        Ok((density.to_dtype(DType::F64)? * lengths)?.sum(D::Minus1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{between_edges, rays};
    use super::*;

    #[test]
    fn closed_forms() {
        // Five evenly spaced samples between near and far: those of the first 2 / 5 are the first two.
        let of = |density: &[f64], share: f64| rays(density, 5.0).value(&Occlusion { share });
        assert!((of(&[3.0; 5], 0.4) - 3.0 * 0.4).abs() < 1e-12);
        assert!((of(&[0.0, 0.0, 7.0, 7.0, 7.0], 0.4)).abs() < 1e-12);
        assert!((of(&[1.0, 2.0, 0.0, 0.0, 0.0], 0.4) - 3.0 / 5.0).abs() < 1e-12);
        assert!(
            (between_edges(&[1.0, 2.0, 0.0, 0.0, 0.0], 5.0).value(&Occlusion { share: 0.4 }) - 3.0 / 5.0).abs() < 1e-12
        );
        // A part of an interval counts as a part.
        assert!((of(&[1.0, 2.0, 0.0, 0.0, 0.0], 0.3) - (1.0 + 0.5 * 2.0) / 5.0).abs() < 1e-12);
    }
}
