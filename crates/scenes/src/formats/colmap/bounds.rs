//! Ends of rays and the box of a COLMAP scene, from its points.

use super::model::Model;
use crate::rig::percentile;
use crate::{Camera, Rig, SceneSpace, WorldToScene};

/// Range of a view's depths that counts, as quantiles: a few points are always wrong.
const SHARES: [f64; 2] = [0.01, 0.99];
/// Range of the views' depths that counts, as quantiles.
const VIEWS: [f64; 2] = [0.02, 0.98];
/// Margin before the nearest and behind the farthest depth, as a factor.
const ROOM: [f64; 2] = [0.8, 1.25];
/// A view with fewer points is ignored.
const LEAST_POINTS: usize = 8;
/// Range of the points in the box along each axis, as quantiles; a tenth of its sides is added.
const BOX: [f64; 2] = [0.01, 0.99];
const BOX_ROOM: f64 = 0.1;
/// Largest distance of the box from what the cameras look at, in radii of what fills their images.
const BOX_REACH: f64 = 2.0;

/// Returns the scene's space and the ends of its rays: from the points, otherwise from the cameras, otherwise
/// `unknown`.
pub(super) fn of(
    model: &Model,
    cameras: &[Camera],
    world: WorldToScene,
    unknown: [f64; 2],
) -> (SceneSpace, (f64, f64)) {
    let (mut space, by_cameras) = SceneSpace::of_cameras(cameras, world, unknown);
    let points: Vec<[f64; 3]> = model.points.iter().map(|point| world.point(point.place)).collect();
    space.points = points.iter().map(|point| point.map(|v| v as f32)).collect();
    let ends: Vec<[f64; 2]> = model
        .depths()
        .iter()
        .map(|depths| depths.iter().copied().filter(|depth| *depth > 0.0).collect::<Vec<f64>>())
        .filter(|depths| depths.len() >= LEAST_POINTS)
        .map(|depths| SHARES.map(|share| world.scale * percentile(&depths, share)))
        .collect();
    let over_views = |end: usize| {
        let mut values: Vec<f64> = ends.iter().map(|ends| ends[end]).collect();
        values.sort_by(f64::total_cmp);
        (!values.is_empty()).then(|| ROOM[end] * percentile(&values, VIEWS[end]))
    };
    let Some((near, far)) = over_views(0).zip(over_views(1)).filter(|(near, far)| near < far) else {
        return (space, by_cameras);
    };
    space.domain = Some(domain(&points, cameras));
    space.notes.clear();
    space.note(
        "bounds from",
        format!(
            "depths of {} points in {} views, 1 % to 99 % of each, with a fifth of room before and a quarter behind",
            points.len(),
            ends.len()
        ),
    );
    (space, (near, far))
}

/// Returns the box of the points, without outliers far from the others and from what the cameras look at.
fn domain(points: &[[f64; 3]], cameras: &[Camera]) -> [[f64; 3]; 2] {
    let subject = Rig::of(cameras).subject;
    let mut domain = [[0.0; 3]; 2];
    for axis in 0..3 {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        let [low, high] = BOX.map(|share| percentile(&values, share));
        let room = BOX_ROOM * (high - low);
        let (mut low, mut high) = (low - room, high + room);
        if let Some(subject) = subject {
            let reach = BOX_REACH * subject.radius;
            let (least, most) = (subject.focus[axis] - reach, subject.focus[axis] + reach);
            // If all points are beyond that, the cameras do not look at them, or their axes miss them: the points are
            // right.
            if low < most && high > least {
                (low, high) = (low.max(least), high.min(most));
            }
        }
        // A flat scene also needs a box.
        let least_side = 1e-3 * (1.0 + low.abs().max(high.abs()));
        (domain[0][axis], domain[1][axis]) =
            if high - low < least_side { (low - least_side, high + least_side) } else { (low, high) };
    }
    domain
}
