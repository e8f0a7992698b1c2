//! What the chunks of a step add up to.

use candle_core::Tensor;

use crate::base::Result;
use crate::base::tensors::sum;
use crate::field::TableRecord;
use crate::methods::Extremes;
use crate::methods::diagnostics::Sums as SiteSums;
use crate::methods::gradients::Gradients;

/// The contribution of one chunk, or of several, to a step.
pub(super) struct Sums {
    pub(super) gradients: Gradients,
    pub(super) losses: Losses,
    /// For each field, what its hash grid's gradient is made of.
    pub(super) tables: Vec<Vec<TableRecord>>,
    /// Of the hash grids' entries that a step changes, the share that only its second pass changes, if requested.
    pub(super) only_second: Option<f64>,
    /// Diagnostics, if requested.
    pub(super) diagnostics: Option<SiteSums>,
}

/// Losses weighted with the chunk's fraction, and extremes of the rays. They are f64 tensors that stay on the device
/// until the step is over.
#[derive(Default)]
pub(super) struct Losses {
    pub(super) coarse: Option<Tensor>,
    pub(super) fine: Option<Tensor>,
    pub(super) perturbed: Option<Tensor>,
    /// Terms on rays, unweighted, `[terms]`.
    pub(super) on_rays: Option<Tensor>,
    /// [`Extremes::tensor`].
    pub(super) extremes: Option<Tensor>,
}

impl Sums {
    /// Returns those of nothing, for a model with so many parameters.
    pub(super) fn new(parameters: usize) -> Sums {
        let gradients = Gradients::none(parameters);
        Sums { gradients, losses: Losses::default(), tables: Vec::new(), only_second: None, diagnostics: None }
    }

    pub(super) fn with_diagnostics(self, requested: bool) -> Sums {
        Sums { diagnostics: requested.then(SiteSums::default), ..self }
    }

    /// Sums the parts of a step in their order. There is at least one.
    pub(super) fn sum(parts: Vec<Sums>) -> Result<Sums> {
        let (mut gradients, mut rest) = (Vec::with_capacity(parts.len()), Sums::new(0));
        for mut part in parts {
            gradients.push(std::mem::replace(&mut part.gradients, Gradients::none(0)));
            rest.add(part)?;
        }
        Ok(Sums { gradients: Gradients::sum(gradients)?, ..rest })
    }

    pub(super) fn add(&mut self, other: Sums) -> Result<()> {
        self.gradients.merge(other.gradients)?;
        self.losses.add(other.losses)?;
        self.tables.resize_with(other.tables.len().max(self.tables.len()), Vec::new);
        self.tables.iter_mut().zip(other.tables).for_each(|(records, more)| records.extend(more));
        if let Some(other) = other.diagnostics {
            self.diagnostics.get_or_insert_default().merge(other);
        }
        Ok(())
    }
}

impl Losses {
    fn add(&mut self, other: Losses) -> Result<()> {
        self.coarse = sum(self.coarse.take(), other.coarse)?;
        self.fine = sum(self.fine.take(), other.fine)?;
        self.perturbed = sum(self.perturbed.take(), other.perturbed)?;
        self.on_rays = sum(self.on_rays.take(), other.on_rays)?;
        self.extremes = match (self.extremes.take(), other.extremes) {
            (Some(a), Some(b)) => Some(a.maximum(&b)?),
            (a, b) => a.or(b),
        };
        Ok(())
    }

    /// Returns the values of the terms on rays, in their order.
    pub(super) fn on_rays(&self) -> Result<Vec<f64>> {
        Ok(self.on_rays.as_ref().map(Tensor::to_vec1).transpose()?.unwrap_or_default())
    }

    /// Returns the loss of the clean passes, with the coarse one weighted.
    pub(super) fn clean(&self, coarse_weight: f64) -> Result<Option<Tensor>> {
        let coarse = self.coarse.as_ref().map(|loss| loss * coarse_weight).transpose()?;
        sum(coarse, self.fine.clone())
    }

    /// Reads coarse, fine and perturbed loss and the extremes in one transfer.
    pub(super) fn read(&self) -> Result<([Option<f64>; 3], Extremes)> {
        let losses = [&self.coarse, &self.fine, &self.perturbed];
        let mut there =
            losses.into_iter().flatten().map(|loss| loss.reshape(1)).collect::<candle_core::Result<Vec<_>>>()?;
        there.push(self.extremes.clone().expect("every chunk has a pass that is evaluated"));
        let values = Tensor::cat(&there, 0)?.to_vec1::<f64>()?;
        let (mut scalars, extremes) = (values[..there.len() - 1].iter(), &values[there.len() - 1..]);
        Ok((losses.map(|loss| loss.as_ref().and_then(|_| scalars.next().copied())), Extremes::read(extremes)))
    }
}
