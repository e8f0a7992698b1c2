//! What the chunks of a step add up to.

use crate::base::Result;
use crate::field::TableRecord;
use crate::methods::Extremes;
use crate::methods::diagnostics::SiteSums;
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

/// Losses weighted with the chunk's fraction, and extremes of the rays.
#[derive(Default)]
pub(super) struct Losses {
    pub(super) coarse: Option<f64>,
    pub(super) fine: Option<f64>,
    pub(super) perturbed: Option<f64>,
    /// Values of the terms on rays, unweighted, in their order.
    pub(super) on_rays: Vec<f64>,
    pub(super) extremes: Option<Extremes>,
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
        self.losses.add(other.losses);
        self.add_tables(other.tables);
        if let Some(other) = other.diagnostics {
            self.diagnostics.get_or_insert_default().merge(other);
        }
        Ok(())
    }

    /// Adds records of each field.
    pub(super) fn add_tables(&mut self, tables: Vec<Vec<TableRecord>>) {
        self.tables.resize_with(tables.len().max(self.tables.len()), Vec::new);
        self.tables.iter_mut().zip(tables).for_each(|(records, more)| records.extend(more));
    }
}

impl Losses {
    fn add(&mut self, other: Losses) {
        self.coarse = plus(self.coarse, other.coarse);
        self.fine = plus(self.fine, other.fine);
        self.perturbed = plus(self.perturbed, other.perturbed);
        self.add_on_rays(&other.on_rays);
        self.extremes = match (self.extremes, other.extremes) {
            (Some(a), Some(b)) => Some(a.join(b)),
            (a, b) => a.or(b),
        };
    }

    /// Adds values of the terms on rays. Those of no rays yet are 0.
    pub(super) fn add_on_rays(&mut self, values: &[f64]) {
        self.on_rays.resize(self.on_rays.len().max(values.len()), 0.0);
        self.on_rays.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }

    /// Returns the loss of the clean passes, with the coarse one weighted.
    pub(super) fn clean(&self, coarse_weight: f64) -> Option<f64> {
        plus(self.coarse.map(|loss| loss * coarse_weight), self.fine)
    }
}

/// Returns the sum of numbers that may be absent.
pub(super) fn plus(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.zip(b).map(|(a, b)| a + b).or(a).or(b)
}
