//! How well a predicted standard deviation says where errors are: Spearman's correlation, sparsification, fractions within
//! standard deviations, and error against spread.

use serde::Serialize;

/// A pixel's predicted standard deviation, and the size of its error in the same unit. Both are finite and not negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted {
    /// Standard deviation.
    pub spread: f32,
    /// Size of the error.
    pub error: f32,
}

/// Returns Spearman's rank correlation of spread and error; equal values share their mean rank. `None` if all spreads or
/// all errors are equal.
pub fn spearman(pixels: &[Predicted]) -> Option<f64> {
    let ranks = [ranks(pixels, |pixel| pixel.spread), ranks(pixels, |pixel| pixel.error)];
    // Ranks from 1 to n, with ties, have this mean.
    let middle = (pixels.len() as f64 + 1.0) / 2.0;
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - middle) * (b - middle)).sum::<f64>();
    let size = product(&ranks[0], &ranks[0]).sqrt() * product(&ranks[1], &ranks[1]).sqrt();
    (size > 0.0).then(|| product(&ranks[0], &ranks[1]) / size)
}

/// Returns ranks from 1; equal values share their mean rank.
fn ranks(pixels: &[Predicted], value: fn(&Predicted) -> f32) -> Vec<f64> {
    let mut order: Vec<usize> = (0..pixels.len()).collect();
    order.sort_unstable_by(|&a, &b| value(&pixels[a]).total_cmp(&value(&pixels[b])));
    let mut ranks = vec![0.0; pixels.len()];
    let mut before = 0;
    for ties in order.chunk_by(|&a, &b| value(&pixels[a]) == value(&pixels[b])) {
        let rank = before as f64 + (ties.len() as f64 + 1.0) / 2.0;
        ties.iter().for_each(|&pixel| ranks[pixel] = rank);
        before += ties.len();
    }
    ranks
}

/// Areas under sparsification error curves, in units of the root mean square error of all pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sparsification {
    /// AUSE of the spread. It is 0 if the spread orders pixels as their errors do.
    pub ause: f64,
    /// AUSE of a constant spread, which says nothing.
    pub ause_constant: f64,
}

/// Measures how well spread orders pixels by error: AUSE, the area under the sparsification error (Ilg et al. 2018,
/// "Uncertainty estimates and multi-hypotheses networks for optical flow"), with root mean square errors.
///
/// The sparsification curve removes the fraction f of the pixels with the largest spread and takes the root mean square
/// error of the others, divided by that of all. The sparsification error is this curve minus the one that removes the
/// largest errors first. AUSE is its mean over f = 0, 1/n, ..., (n - 1)/n. Pixels of equal spread have no order, so each
/// counts with their mean squared error. `None` if all errors are 0.
pub fn sparsification(pixels: &[Predicted]) -> Option<Sparsification> {
    let total = root_mean_square(pixels.iter().map(|pixel| pixel.error));
    if total.is_nan() || total <= 0.0 {
        return None;
    }
    let by_error = area(pixels, |pixel| pixel.error);
    let area = |key| (area(pixels, key) - by_error) / total;
    Some(Sparsification { ause: area(|pixel| pixel.spread), ause_constant: area(|_| 0.0) })
}

/// Returns the mean, over all numbers of pixels from 1, of the root mean square error of those with the smallest keys.
fn area(pixels: &[Predicted], key: fn(&Predicted) -> f32) -> f64 {
    let mut pixels = pixels.to_vec();
    // Errors decide within ties, so that sums do not depend on the order of the pixels.
    pixels.sort_unstable_by(|a, b| key(a).total_cmp(&key(b)).then(a.error.total_cmp(&b.error)));
    let (mut sum, mut count, mut area) = (0.0, 0.0, 0.0);
    for ties in pixels.chunk_by(|a, b| key(a) == key(b)) {
        let each = mean_square(ties.iter().map(|pixel| pixel.error));
        for _ in ties {
            sum += each;
            count += 1.0;
            area += f64::sqrt(sum / count);
        }
    }
    area / count
}

/// Returns the fraction of pixels whose error is at most `times` their spread; NaN without pixels.
pub fn within(pixels: &[Predicted], times: f64) -> f64 {
    let inside = |pixel: &&Predicted| f64::from(pixel.error) <= times * f64::from(pixel.spread);
    pixels.iter().filter(inside).count() as f64 / pixels.len() as f64
}

/// A bin of a calibration curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CalibrationBin {
    /// Lowest spread.
    pub spread_lowest: f64,
    /// Highest spread.
    pub spread_highest: f64,
    /// Mean spread.
    pub spread_mean: f64,
    /// Root mean square spread. If the truth were one more of n seeds, `error_rms` of their mean would be this times sqrt(1 + 1/n).
    pub spread_rms: f64,
    /// Root mean square error.
    pub error_rms: f64,
    /// Number of pixels.
    pub pixels: usize,
}

/// Returns error against spread in at most `bins` bins of equal numbers of pixels, from the lowest spread up. Numbers
/// differ by one if the pixels cannot be divided evenly. Sorts the pixels in place.
pub fn calibration_curve(pixels: &mut [Predicted], bins: usize) -> Vec<CalibrationBin> {
    pixels.sort_unstable_by(|a, b| a.spread.total_cmp(&b.spread).then(a.error.total_cmp(&b.error)));
    let end = |bin: usize| (bin as u128 * pixels.len() as u128 / bins as u128) as usize;
    let parts = (0..bins).map(|bin| &pixels[end(bin)..end(bin + 1)]);
    let bin = |part: &[Predicted]| CalibrationBin {
        spread_lowest: part[0].spread.into(),
        spread_highest: part[part.len() - 1].spread.into(),
        spread_mean: part.iter().map(|pixel| f64::from(pixel.spread)).sum::<f64>() / part.len() as f64,
        spread_rms: root_mean_square(part.iter().map(|pixel| pixel.spread)),
        error_rms: root_mean_square(part.iter().map(|pixel| pixel.error)),
        pixels: part.len(),
    };
    parts.filter(|part| !part.is_empty()).map(bin).collect()
}

/// Returns the root mean square; NaN without values.
pub fn root_mean_square(values: impl ExactSizeIterator<Item = f32>) -> f64 {
    mean_square(values).sqrt()
}

fn mean_square(values: impl ExactSizeIterator<Item = f32>) -> f64 {
    let count = values.len() as f64;
    values.map(|value| f64::from(value).powi(2)).sum::<f64>() / count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(spreads: &[f32], errors: &[f32]) -> Vec<Predicted> {
        spreads.iter().zip(errors).map(|(&spread, &error)| Predicted { spread, error }).collect()
    }

    fn close(value: Option<f64>, expected: f64) {
        let value = value.unwrap();
        assert!((value - expected).abs() <= 1e-12 * expected.abs().max(1.0), "{value} is not {expected}");
    }

    #[test]
    fn an_order_that_agrees_has_correlation_1_and_ause_0() {
        // Not linear: only ranks count.
        let agree = pixels(&[0.1, 0.4, 0.2, 0.3], &[1.0, 9.0, 2.0, 2.5]);
        close(spearman(&agree), 1.0);
        close(sparsification(&agree).map(|found| found.ause), 0.0);
        let opposed = pixels(&[0.4, 0.1, 0.3, 0.2], &[1.0, 9.0, 2.0, 2.5]);
        close(spearman(&opposed), -1.0);
        let (worst, constant) = sparsification(&opposed).map(|found| (found.ause, found.ause_constant)).unwrap();
        assert!(worst > constant && constant > 0.0, "{worst} {constant}");
    }

    /// Errors 3, 4 and 0 have the squares 9, 16 and 0 and the mean 25/3.
    #[test]
    fn ause_is_the_closed_form_of_three_pixels() {
        let total = (25.0f64 / 3.0).sqrt();
        let oracle = (total + (9.0f64 / 2.0).sqrt() + 0.0) / 3.0;
        // Removes 4, then 0, then 3.
        let order = (total + (9.0f64 / 2.0).sqrt() + 3.0) / 3.0;
        let found = sparsification(&pixels(&[0.1, 0.3, 0.2], &[3.0, 4.0, 0.0])).unwrap();
        close(Some(found.ause), (order - oracle) / total);
        close(Some(found.ause_constant), (total - oracle) / total);
    }

    #[test]
    fn equal_spreads_have_no_order() {
        let constant = sparsification(&pixels(&[0.5; 4], &[0.0, 1.0, 2.0, 3.0])).unwrap();
        assert_eq!(constant.ause, constant.ause_constant);
        // The last two tie, so either counts with the mean square of 1 and 3.
        let tied = |errors: &[f32]| sparsification(&pixels(&[0.1, 0.2, 0.2], errors)).unwrap().ause;
        assert_eq!(tied(&[0.0, 1.0, 3.0]), tied(&[0.0, 3.0, 1.0]));
        let total = (10.0f64 / 3.0).sqrt();
        let (order, oracle) = (total + (5.0f64 / 2.0).sqrt(), total + (1.0f64 / 2.0).sqrt());
        close(Some(tied(&[0.0, 1.0, 3.0])), (order - oracle) / 3.0 / total);
    }

    #[test]
    fn nothing_is_measured_of_constants() {
        assert_eq!(spearman(&pixels(&[0.5; 3], &[0.0, 1.0, 2.0])), None);
        assert_eq!(spearman(&pixels(&[0.0, 1.0, 2.0], &[0.5; 3])), None);
        assert_eq!((sparsification(&pixels(&[0.1, 0.2], &[0.0; 2])), sparsification(&[])), (None, None));
    }

    /// The ranks are 1, 2.5, 2.5, 4, 5 and 2, 1, 4, 4, 4. Around their mean of 3, their product is 5.5 and their squares 9.5 and 8.
    #[test]
    fn tied_ranks_are_their_mean() {
        let tied = pixels(&[1.0, 2.0, 2.0, 3.0, 5.0], &[2.0, 1.0, 4.0, 4.0, 4.0]);
        close(spearman(&tied), 5.5 / (9.5f64 * 8.0).sqrt());
    }

    #[test]
    fn a_bound_is_within() {
        let pixels = pixels(&[1.0, 1.0, 1.0, 0.0], &[1.0, 2.0, 2.5, 0.0]);
        assert_eq!((within(&pixels, 1.0), within(&pixels, 2.0)), (0.5, 0.75));
    }

    #[test]
    fn bins_have_equal_numbers_of_pixels_in_the_order_of_spread() {
        let mut all = pixels(&[4.0, 0.0, 3.0, 1.0, 2.0], &[5.0, 0.0, 1.0, 1.0, 7.0]);
        let curve = calibration_curve(&mut all, 2);
        let bin = |spread_lowest, spread_highest, spread_mean, spread_rms, error_rms, pixels| CalibrationBin {
            spread_lowest,
            spread_highest,
            spread_mean,
            spread_rms,
            error_rms,
            pixels,
        };
        let expected =
            [bin(0.0, 1.0, 0.5, 0.5f64.sqrt(), 0.5f64.sqrt(), 2), bin(2.0, 4.0, 3.0, (29.0f64 / 3.0).sqrt(), 5.0, 3)];
        assert_eq!(curve, expected);
        let single = calibration_curve(&mut all[..2], 20);
        assert_eq!(single.iter().map(|bin| bin.pixels).collect::<Vec<_>>(), [1, 1], "no empty bins");
        assert!(calibration_curve(&mut [], 20).is_empty());
    }
}
