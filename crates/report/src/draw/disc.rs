//! Discs as paths.
//!
//! resvg drew figures at first. The curves here are exactly its curves, so that figures keep their bytes.

use std::f64::consts::{FRAC_PI_2, TAU};

use tiny_skia::{Path, PathBuilder};

/// Returns a circle as four arcs between its leftmost, top, rightmost and bottom points.
pub fn path((x, y): (f64, f64), radius: f64) -> Option<Path> {
    let (x, y, radius) = (x as f32, y as f32, radius as f32);
    let mut path = PathBuilder::new();
    path.move_to(x + radius, y);
    for to in [(x, y + radius), (x - radius, y), (x, y - radius), (x + radius, y)] {
        arc(&mut path, (f64::from(to.0), f64::from(to.1)), f64::from(radius))?;
    }
    path.close();
    path.finish()
}

/// Adds a clockwise arc from the path's end. Its ends are rounded to 32 bits, so that it may be slightly more than a
/// quarter of a circle; it then has two curves.
fn arc(path: &mut PathBuilder, to: (f64, f64), radius: f64) -> Option<()> {
    let from = path.last_point()?;
    let from = (f64::from(from.x), f64::from(from.y));
    // The chord from `to` to `from` gives the centre of the circle, in 64 bits.
    let half = ((from.0 - to.0) * 0.5, (from.1 - to.1) * 0.5);
    let scaled = (radius * half.0, radius * half.1);
    let square = scaled.1 * scaled.1 + scaled.0 * scaled.0;
    let ratio = ((radius * radius * (radius * radius) - square) / square).abs().sqrt();
    let side = (ratio * scaled.1 / radius, -ratio * scaled.0 / radius);
    let middle = (side.0 + (from.0 + to.0) * 0.5, side.1 + (from.1 + to.1) * 0.5);
    let mut angle = ((half.1 - side.1) / radius).atan2((half.0 - side.0) / radius);
    let end = ((-half.1 - side.1) / radius).atan2((-half.0 - side.0) / radius);
    let sweep = (end - angle).rem_euclid(TAU);
    let curves = (3.999_999 * sweep * (1.0 / TAU)).ceil();
    let step = sweep / curves;
    // Distance of a control point along the tangent, in radii.
    let arm = 4.0 / 3.0 * (0.25 * step).tan();
    let on = |angle: f64| (radius * angle.cos(), radius * angle.sin());
    let place = |(x, y): (f64, f64), (dx, dy): (f64, f64), arm: f64| {
        ((middle.0 + (x + arm * dx)) as f32, (middle.1 + (y + arm * dy)) as f32)
    };
    for _ in 0..curves as usize {
        let next = angle + step;
        let leave = place(on(angle), on(angle + FRAC_PI_2), arm);
        let reach = place(on(next), on(next + FRAC_PI_2), -arm);
        let end = place(on(next), (0.0, 0.0), 0.0);
        path.cubic_to(leave.0, leave.1, reach.0, reach.1, end.0, end.1);
        angle = next;
    }
    Some(())
}
