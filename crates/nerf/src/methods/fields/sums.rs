//! What the chunks of a step add up to.

use crate::base::Result;
use crate::field::TableRecord;
use crate::methods::Extremes;
use crate::methods::diagnostics::SiteSums;
use crate::methods::gradients::Gradients;

use super::report::StepLosses;

/// The contribution of one chunk, or of several, to a step.
pub(super) struct Sums {
    pub(super) gradients: Gradients,
    /// Weighted with the chunk's fraction.
    pub(super) losses: StepLosses,
    /// Values of the terms on rays, unweighted, in their order. Those of no rays yet are missing.
    pub(super) on_rays: Vec<f64>,
    /// Of the rays.
    pub(super) extremes: Option<Extremes>,
    /// For each field, what its hash grid's gradient is made of.
    pub(super) tables: Vec<Vec<TableRecord>>,
    /// Of the hash grids' entries that a step changes, the share that only its second pass changes, if requested.
    pub(super) only_second: Option<f64>,
    /// Diagnostics, if requested.
    pub(super) diagnostics: Option<SiteSums>,
}

impl Sums {
    /// Returns those of nothing, for a model with so many parameters.
    pub(super) fn new(parameters: usize) -> Sums {
        Sums {
            gradients: Gradients::none(parameters),
            losses: StepLosses::default(),
            on_rays: Vec::new(),
            extremes: None,
            tables: Vec::new(),
            only_second: None,
            diagnostics: None,
        }
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
        self.losses.coarse = plus(self.losses.coarse, other.losses.coarse);
        self.losses.fine = plus(self.losses.fine, other.losses.fine);
        self.losses.perturbed = plus(self.losses.perturbed, other.losses.perturbed);
        self.add_on_rays(&other.on_rays);
        self.extremes = match (self.extremes, other.extremes) {
            (Some(a), Some(b)) => Some(a.join(b)),
            (a, b) => a.or(b),
        };
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

    /// Adds values of the terms on rays.
    pub(super) fn add_on_rays(&mut self, values: &[f64]) {
        self.on_rays.resize(self.on_rays.len().max(values.len()), 0.0);
        self.on_rays.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
}

/// Returns the sum of numbers that may be absent.
pub(super) fn plus(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.zip(b).map(|(a, b)| a + b).or(a).or(b)
}
