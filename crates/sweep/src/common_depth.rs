//! Depth errors over the pixels that are solid in all rows. A row's own errors cover only the pixels where it is
//! solid, so a row that skips hard pixels would look better.

use crate::base::{Error, Result};
use crate::metrics::{
    DEPTH_LEFT_OUT, DEPTH_LEFT_OUT_COMMON, DEPTH_MAE_COMMON, DEPTH_RMSE_COMMON, Metric, Needs, Scope, mean,
};
use crate::report::{Record, Status, distinct};
use crate::run::DepthErrors;

/// Returns whether the table is about depth: it has a metric over a view's own pixels or over the common ones.
pub fn wants_depth(metrics: &[String]) -> bool {
    let about_depth = |metric: &Metric| metric.scope == Scope::Common || matches!(metric.needs, Needs::Depth);
    metrics
        .iter()
        .filter_map(|key| Metric::find(key))
        .any(|metric| about_depth(metric) && metric.scope != Scope::Surface)
}

/// Adds the [`Scope::Common`] metrics to measured points. They cover the pixels of each held-out view at which every
/// measured point of the scene and seed is solid. `errors_of` returns a point's errors. If one point has no errors or
/// other views, no point of its seed gets the metrics.
///
/// # Errors
/// The errors cover another number of views than the point was measured on.
pub fn add_common_depth(records: &mut [Record], errors_of: impl Fn(&str) -> Result<Option<DepthErrors>>) -> Result<()> {
    let groups = distinct(records.iter().filter(|r| r.status == Status::Done).map(|r| (r.scene.clone(), r.seed)));
    for (scene, seed) in groups {
        let of_group = |r: &&Record| r.status == Status::Done && (&r.scene, r.seed) == (&scene, seed);
        let ids = distinct(records.iter().filter(of_group).map(|record| record.id.clone()));
        let checked = |id: &str| -> Result<Option<DepthErrors>> {
            let errors = errors_of(id)?;
            let measured = records.iter().filter(of_group).find(|record| record.id == id).zip(errors.as_ref());
            measured.map_or(Ok(()), |(record, errors)| check_views(record, errors))?;
            Ok(errors)
        };
        let Some(mask) = common_mask(&ids, &checked)? else { continue };
        for id in ids {
            let Some(errors) = errors_of(&id)? else { continue };
            let metrics = measured(&errors, &mask);
            for record in records.iter_mut().filter(|record| record.id == id && record.status == Status::Done) {
                record.result.metrics.extend(metrics.iter().map(|(key, value)| (key.to_string(), *value)));
            }
        }
    }
    Ok(())
}

/// Checks that a point's errors cover the views that it was measured on. Views without a depth of their own have no
/// errors; in that case the point has no mean depth.
fn check_views(record: &Record, errors: &DepthErrors) -> Result<()> {
    let Ok(measured) = record.protocol("views_evaluated").parse::<usize>() else { return Ok(()) };
    let found = errors.views.len();
    let all_have_depth = record.metric(DEPTH_LEFT_OUT.key).is_some();
    if found > measured || all_have_depth && found < measured {
        return Err(Error::Checkpoint(format!(
            "depth_errors.gz of point {} is damaged: it has {found} views, its measurement {measured}; delete it, or \
             measure the run again with `augnerf eval`",
            record.id
        )));
    }
    Ok(())
}

/// Returns where all points are solid, view by view, or `None` if a point has no errors or other views. One point is
/// in memory at a time.
fn common_mask(
    ids: &[String],
    errors_of: &impl Fn(&str) -> Result<Option<DepthErrors>>,
) -> Result<Option<Vec<Vec<bool>>>> {
    let mut mask: Option<Vec<Vec<bool>>> = None;
    for id in ids {
        let Some(errors) = errors_of(id)? else { return Ok(None) };
        let solid: Vec<Vec<bool>> =
            errors.views.iter().map(|view| view.iter().map(|error| error.is_finite()).collect()).collect();
        match &mut mask {
            None => mask = Some(solid),
            Some(mask) if !mask.iter().map(Vec::len).eq(solid.iter().map(Vec::len)) => return Ok(None),
            Some(mask) => {
                let pixels = mask.iter_mut().flatten().zip(solid.iter().flatten());
                pixels.for_each(|(common, own)| *common &= own);
            }
        }
    }
    Ok(mask)
}

/// Returns means over views of a point's errors at the common pixels, and of the fraction that these skip. If a view
/// has no common pixel, its error and the mean are missing.
fn measured(errors: &DepthErrors, mask: &[Vec<bool>]) -> [(&'static str, Option<f64>); 3] {
    let at_common = |(view, mask): (&Vec<f32>, &Vec<bool>)| -> Vec<f64> {
        view.iter().zip(mask).filter(|(_, common)| **common).map(|(error, _)| f64::from(*error)).collect()
    };
    let views: Vec<Vec<f64>> = errors.views.iter().zip(mask).map(at_common).collect();
    let mean_of = |of_view: &dyn Fn(&[f64]) -> Option<f64>| -> Option<f64> {
        let values: Option<Vec<f64>> = views.iter().map(|view| of_view(view)).collect();
        mean(values?.into_iter())
    };
    let left_out = errors.views.iter().zip(&views).filter(|(all, _)| !all.is_empty());
    let left_out = left_out.map(|(all, common)| 1.0 - common.len() as f64 / all.len() as f64);
    [
        (DEPTH_MAE_COMMON.key, mean_of(&|view| mean(view.iter().map(|error| error.abs())))),
        (DEPTH_RMSE_COMMON.key, mean_of(&|view| mean(view.iter().map(|error| error * error)).map(f64::sqrt))),
        (DEPTH_LEFT_OUT_COMMON.key, mean(left_out)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::PointResult;

    const NAN: f32 = f32::NAN;

    fn record(id: &str, seed: u64) -> Record {
        Record {
            id: id.into(),
            scene: "s".into(),
            row: id.into(),
            seed: Some(seed),
            status: Status::Done,
            ..Record::default()
        }
    }

    fn values(record: &Record) -> Vec<Option<f64>> {
        ["depth_mae_common", "depth_rmse_common", "depth_left_out_common"].map(|key| record.metric(key)).to_vec()
    }

    /// The row that skips its worst pixel has the smaller error over its own pixels, and the larger one over common
    /// pixels.
    #[test]
    fn who_leaves_its_errors_out_gains_nothing() {
        let errors = |id: &str| {
            let views = match id {
                "honest" => vec![vec![0.0, 0.5, -4.0, 0.5], vec![0.5, 0.5]],
                "hiding" => vec![vec![1.0, -1.0, NAN, 1.0], vec![1.0, 1.0]],
                "other seed" => vec![vec![0.25, NAN, NAN, NAN], vec![0.25, NAN]],
                _ => return Ok(None),
            };
            Ok(Some(DepthErrors { views }))
        };
        let mut records = vec![record("honest", 0), record("hiding", 0), record("other seed", 1)];
        add_common_depth(&mut records, errors).unwrap();
        // Over its own pixels the first has a mean error of (5 / 4 + 0.5) / 2 = 0.875, the second one of 1.
        let honest = [Some((1.0 / 3.0 + 0.5) / 2.0), Some(((0.5f64 / 3.0).sqrt() + 0.5) / 2.0), Some(0.125)];
        assert_eq!(values(&records[0]), honest);
        assert_eq!(values(&records[1]), [Some(1.0), Some(1.0), Some(0.125)]);
        assert_eq!(values(&records[2]), [Some(0.25), Some(0.25), Some((0.75 + 0.5) / 2.0)]);

        // A measured point without errors leaves no common pixel; a point that is not measured does not count.
        let mut records = vec![record("honest", 0), record("unknown", 0)];
        add_common_depth(&mut records, errors).unwrap();
        assert_eq!(values(&records[0]), [None; 3]);
        records[1].status = Status::Failed;
        add_common_depth(&mut records, errors).unwrap();
        assert_eq!(records[0].metric("depth_left_out_common"), Some(0.0));
    }

    #[test]
    fn errors_of_another_number_of_views_than_were_measured_are_damage() {
        let errors = |id: &str| Ok(Some(DepthErrors { views: vec![vec![1.0]; id.len()] }));
        let measured = |id: &str, depth: Option<f64>| Record {
            result: PointResult {
                protocol: vec![("views_evaluated".into(), "2".into())],
                metrics: vec![("depth_left_out".into(), depth)],
                ..PointResult::default()
            },
            ..record(id, 0)
        };
        let said = |id: &str, depth| add_common_depth(&mut [measured(id, depth)], errors).err().map(|e| e.to_string());
        assert_eq!((said("ab", Some(0.0)), said("ab", None), said("a", None)), (None, None, None));
        for (id, depth) in [("a", Some(0.0)), ("abc", Some(0.0)), ("abc", None)] {
            let said = said(id, depth).unwrap();
            assert!(said.contains(&format!("point {id} is damaged: it has {} views", id.len())), "{said}");
            assert!(said.contains("its measurement 2; delete it"), "{said}");
        }
    }

    #[test]
    fn other_views_and_empty_masks_have_no_number() {
        let errors = |id: &str| {
            Ok(Some(DepthErrors { views: if id == "a" { vec![vec![1.0, NAN]] } else { vec![vec![NAN, 1.0]] } }))
        };
        let mut records = vec![record("a", 0), record("b", 0)];
        add_common_depth(&mut records, errors).unwrap();
        assert_eq!(values(&records[0]), [None, None, Some(1.0)]);
        let longer = |id: &str| Ok(Some(DepthErrors { views: vec![vec![1.0; id.len()]] }));
        let mut records = vec![record("a", 0), record("bb", 0)];
        add_common_depth(&mut records, longer).unwrap();
        assert_eq!(values(&records[0]), [None; 3]);
    }
}
