//! Terms in space of one field: values and weight gradients.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::field::{Cotangents, DensityAt, Field, Order, TableRecord};
use crate::space::{Quadrature, over_chunks};

use super::SpaceTerm;

/// A term in space with its weight.
pub type WeightedSpaceTerm<'a> = (&'a dyn SpaceTerm, f64);

/// Terms, and the gradients of their weighted sum.
pub struct Regularized {
    /// Value of each term, unweighted: f64 `[terms]`. It stays on the field's device until it is read.
    pub values: Tensor,
    /// In the order of [`Field::parameter_names`].
    pub gradients: Vec<Option<Tensor>>,
}

/// Returns values and weight gradients of weighted terms of one field, integrated with `points`.
pub fn regularize(field: &Field, points: &Quadrature, terms: &[WeightedSpaceTerm]) -> Result<Regularized> {
    regularize_unless(field, points, terms, || Ok(()))
}

/// The same with a check that is called regularly. Its error ends the work.
pub fn regularize_unless(
    field: &Field,
    points: &Quadrature,
    terms: &[WeightedSpaceTerm],
    stop_check: impl Fn() -> Result<()>,
) -> Result<Regularized> {
    let volume = points.volume_each();
    let field = &field.prepared()?;
    let mut sum: Option<Chunk> = None;
    over_chunks(
        points,
        field.dtype(),
        field.device(),
        |points| chunk_at(field, points, terms, volume),
        |chunk| {
            stop_check()?;
            match &mut sum {
                None => sum = Some(chunk),
                Some(sum) => sum.add(chunk, field)?,
            }
            Ok(())
        },
    )?;
    sum.expect("there are points").finish(field)
}

/// The same at `points [n, 3]`, each of which stands for `volume`.
pub fn regularize_at(field: &Field, points: &Tensor, terms: &[WeightedSpaceTerm], volume: f64) -> Result<Regularized> {
    chunk_at(field, points, terms, volume)?.finish(field)
}

/// The result of some points.
struct Chunk {
    regularized: Regularized,
    /// Records that are still to be added to a hash grid's table gradient.
    records: Vec<TableRecord>,
}

/// Largest number of points with waiting records. Adding up a table's gradient takes as long as a few thousand of them.
const MOST_RECORDED: usize = 1 << 16;

fn chunk_at(field: &Field, points: &Tensor, terms: &[WeightedSpaceTerm], volume: f64) -> Result<Chunk> {
    let order = terms.iter().map(|(term, _)| term.order()).max().unwrap_or(Order::Density);
    let spatial = field.spatial_up_to(order, points)?;
    let values: Vec<Tensor> = terms.iter().map(|(term, _)| term_sum(*term, &spatial.at)).collect::<Result<_>>()?;
    let values = (Tensor::stack(&values, 0)? * volume)?;
    let (gradients, record) = spatial.weight_gradients(&cotangents(&spatial.at, terms, volume)?)?;
    Ok(Chunk { regularized: Regularized { values, gradients }, records: record.into_iter().collect() })
}

impl Chunk {
    fn add(&mut self, other: Chunk, field: &Field) -> Result<()> {
        let sum = &mut self.regularized;
        sum.values = (&sum.values + other.regularized.values)?;
        for (sum, gradient) in sum.gradients.iter_mut().zip(other.regularized.gradients) {
            *sum = plus(sum.take(), gradient)?;
        }
        self.records.extend(other.records);
        if self.records.iter().map(TableRecord::count).sum::<usize>() >= MOST_RECORDED {
            self.settle(field)?;
        }
        Ok(())
    }

    /// Adds the records to the table's gradient, which is the first.
    fn settle(&mut self, field: &Field) -> Result<()> {
        if let Some(gradient) = field.table_gradient(&std::mem::take(&mut self.records))? {
            let sum = &mut self.regularized.gradients[0];
            *sum = plus(sum.take(), Some(gradient))?;
        }
        Ok(())
    }

    fn finish(mut self, field: &Field) -> Result<Regularized> {
        self.settle(field)?;
        Ok(self.regularized)
    }
}

/// Returns the sum of tensors that may be absent.
fn plus(a: Option<Tensor>, b: Option<Tensor>) -> Result<Option<Tensor>> {
    Ok(match (a, b) {
        (Some(a), Some(b)) => Some((a + b)?),
        (a, b) => a.or(b),
    })
}

/// Returns the sum of a term over points. It is in f64, because Laplacians reach 4^9 and more.
pub(super) fn term_sum(term: &dyn SpaceTerm, at: &DensityAt) -> Result<Tensor> {
    Ok(term.at_points(at)?.to_dtype(DType::F64)?.sum_all()?)
}

/// Returns the derivatives of the sum of `volume * weight * term` over points.
fn cotangents(at: &DensityAt, terms: &[WeightedSpaceTerm], volume: f64) -> Result<Cotangents> {
    let mut sum = Cotangents::default();
    for &(term, weight) in terms {
        let scale = volume * weight;
        let scaled = |slope: Option<Tensor>| slope.map(|slope| slope * scale).transpose();
        let own = term.cotangents(at)?;
        sum.density = plus(sum.density.take(), scaled(own.density)?)?;
        sum.gradient = plus(sum.gradient.take(), scaled(own.gradient)?)?;
        sum.laplacian = plus(sum.laplacian.take(), scaled(own.laplacian)?)?;
    }
    Ok(sum)
}
