//! One unit for captures: the box that most cameras look at gets the size of a Blender scene's.

use augnerf_base::{Error, Result};

use super::Scene;

/// Width of the box, and that of a Blender scene's hash grid.
const WIDTH: f64 = 3.0;

/// Moves and scales a scene so that the box that most cameras look at is around the origin, and its longest side 3. It is not
/// for scenes whose format states its unit: NDC, Blender's and the built-in ones.
///
/// # Errors
/// [`Error::Data`]: a capture whose cameras look at no common point has no box.
pub(super) fn rescale(scene: &mut Scene) -> Result<()> {
    let Some([lower, upper]) = scene.space.domain else {
        return Err(Error::Data(format!(
            "data.rescale: the cameras of {} look at no common point, so there is no box to scale by; set \
             data.rescale=false (the preset few-views sets it to true)",
            scene.name
        )));
    };
    let longest = lower.iter().zip(&upper).map(|(low, high)| high - low).fold(0.0, f64::max);
    let factor = WIDTH / longest;
    let middle: [f64; 3] = std::array::from_fn(|axis| (lower[axis] + upper[axis]) / 2.0);
    let placed = |point: [f64; 3]| -> [f64; 3] { std::array::from_fn(|axis| (point[axis] - middle[axis]) * factor) };
    let views = scene.train.iter_mut().chain(&mut scene.test);
    for view in views {
        view.depth.iter_mut().flatten().for_each(|depth| *depth *= factor as f32);
        place(&mut view.camera.pose, placed);
    }
    scene.path.iter_mut().for_each(|camera| place(&mut camera.pose, placed));
    for point in &mut scene.space.points {
        *point = placed(point.map(f64::from)).map(|value| value as f32);
    }
    scene.space.domain = Some([placed(lower), placed(upper)]);
    let mut motion = crate::WorldToScene::default().rotation_and_origin;
    motion.iter_mut().zip(middle).for_each(|(row, middle)| row[3] = -middle);
    scene.space.world = scene.space.world.moved(&motion).scaled(factor);
    (scene.near, scene.far) = (scene.near * factor, scene.far * factor);
    scene.space.note("rescaled", format!("by {factor:.4}: the box that most cameras look at is {WIDTH} wide"));
    Ok(())
}

fn place(pose: &mut super::pose::Pose, placed: impl Fn([f64; 3]) -> [f64; 3]) {
    let origin = placed(pose.map(|row| row[3]));
    pose.iter_mut().zip(origin).for_each(|(row, value)| row[3] = value);
}
