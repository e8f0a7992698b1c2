//! Whether cells of `points.csv` and `timing.csv` that are made of others are what these make.

use super::Verifier;
use super::files::Collected;
use super::findings::Findings;
use crate::base::Result;
use crate::metrics::{AVERAGE, Backbone, LPIPS, Metric, PSNR, PSNR_FLOAT, SSIM, average, split_metrics};
use crate::report::{Record, Status};

/// Largest relative difference by rounding.
const ROUNDING: f64 = 1e-9;
/// Root mean square of the error that rounding two images to 8 bits makes in colours from 0 to 1, doubled.
const EIGHT_BIT: f64 = 2.0 * 2.0 / (255.0 * 3.464);

/// Checks gaps against their parts, averages against their three metrics, PSNR against that of the unrounded image, and speed
/// against seconds.
pub fn check(_: &Verifier, sweep: &Collected, findings: &mut Findings) -> Result<()> {
    let (mut wrong, mut count) = (Vec::new(), 0);
    let done = sweep.archive.outputs.records.iter().filter(|record| record.status == Status::Done);
    for record in done {
        let of = |metric: &Metric| record.metric(metric.key);
        for metric in split_metrics() {
            let parts = of(metric.train()).zip(of(metric)).map(|(train, held_out)| train - held_out);
            expect(record, metric.gap(), parts, &mut count, &mut wrong);
        }
        for backbone in Backbone::ALL {
            let parts = of(&PSNR).zip(of(&SSIM)).zip(of(LPIPS.get(backbone)));
            let made = parts.map(|((psnr, ssim), lpips)| average(psnr, ssim, lpips));
            expect(record, AVERAGE.get(backbone), made, &mut count, &mut wrong);
        }
        if let Some((psnr, float)) = of(&PSNR).zip(of(&PSNR_FLOAT)) {
            count += 1;
            // What the error of rounding can make of the error that is there.
            let most = 20.0 * (1.0 + EIGHT_BIT / 10f64.powf(-float.max(psnr) / 20.0)).log10();
            if (psnr - float).abs() > most {
                let point = record.point_label();
                wrong.push(format!(
                    "points.csv: psnr of {point} is {psnr}, which 8 bits do not make of psnr_float {float}"
                ));
            }
        }
    }
    findings.of(format!("{count} cells of points.csv are what others make"), wrong);
    speed(sweep, findings);
    Ok(())
}

/// Rays per second are the steps' rays over their seconds.
fn speed(sweep: &Collected, findings: &mut Findings) {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (id, clocks) in &sweep.archive.outputs.timing {
        let Some(point) = sweep.archive.points.iter().find(|point| point.id == *id) else { continue };
        let of = |name: &str| clocks.iter().find(|(known, _)| known == name).and_then(|(_, value)| *value);
        let Some((seconds, speed)) = of("seconds_training").zip(of("rays_per_second")) else { continue };
        count += 1;
        let rays = point.config.train.steps as f64 * point.config.rays_per_step() as f64;
        if (rays / seconds - speed).abs() > ROUNDING * speed {
            let point = point.label();
            wrong.push(format!(
                "timing.csv: rays_per_second of {point} is {speed}, but its {rays} rays in {seconds} s are {} a second",
                rays / seconds
            ));
        }
    }
    if count > 0 {
        findings.of(format!("{count} speeds of timing.csv are what its seconds make"), wrong);
    }
}

/// Compares a cell, if it and its parts are there, with what the parts make.
fn expect(record: &Record, metric: &Metric, made: Option<f64>, count: &mut usize, wrong: &mut Vec<String>) {
    let Some((found, made)) = record.metric(metric.key).zip(made) else { return };
    *count += 1;
    if (found - made).abs() > ROUNDING * made.abs().max(1.0) {
        let point = record.point_label();
        wrong.push(format!("points.csv: {} of {point} is {found}, its parts make {made}", metric.key));
    }
}
