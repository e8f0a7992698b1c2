//! Rigid poses: camera-to-world matrices `[R | origin]` with columns right, up, back.

pub use super::vector::{Vec3, cross, dot, length, sub};

/// A camera-to-world matrix; see [`crate::Camera::pose`].
pub type Pose = [[f64; 4]; 3];

/// How far a rotation's columns may be from orthonormal, since files print few digits.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// Returns `a + s * b`.
pub fn add_scaled(a: Vec3, s: f64, b: Vec3) -> Vec3 {
    std::array::from_fn(|i| a[i] + s * b[i])
}

/// Returns `a` at unit length, or `None` if it has no direction.
pub fn normalized(a: Vec3) -> Option<Vec3> {
    let length = length(a);
    (length.is_finite() && length > 1e-12).then(|| a.map(|v| v / length))
}

/// Returns the mean of a non-empty list.
pub fn mean(vectors: impl Iterator<Item = Vec3>) -> Vec3 {
    let (sum, count) = vectors.fold(([0.0; 3], 0usize), |(sum, n), v| (add_scaled(sum, 1.0, v), n + 1));
    sum.map(|v| v / count as f64)
}

/// Returns column `i`: 0 right, 1 up, 2 back (against the viewing direction), 3 the origin.
pub fn column(pose: &Pose, i: usize) -> Vec3 {
    [pose[0][i], pose[1][i], pose[2][i]]
}

/// Returns the pose with these columns.
pub fn from_columns(columns: [Vec3; 4]) -> Pose {
    std::array::from_fn(|row| std::array::from_fn(|col| columns[col][row]))
}

/// Returns the pose at `origin` that looks along `-back`, with its second column as near to `up` as possible. `None` if
/// `back` and `up` are parallel or zero.
pub fn look_along(back: Vec3, up: Vec3, origin: Vec3) -> Option<Pose> {
    let back = normalized(back)?;
    let right = normalized(cross(up, back))?;
    let up = normalized(cross(back, right))?;
    Some(from_columns([right, up, back, origin]))
}

/// Applies `pose` to a point.
pub fn transform(pose: &Pose, point: Vec3) -> Vec3 {
    pose.map(|r| r[0] * point[0] + r[1] * point[1] + r[2] * point[2] + r[3])
}

/// Returns `a * b`, both with the implied last row (0, 0, 0, 1).
pub fn compose(a: &Pose, b: &Pose) -> Pose {
    let rotate = |v: Vec3| a.map(|r| r[0] * v[0] + r[1] * v[1] + r[2] * v[2]);
    from_columns([rotate(column(b, 0)), rotate(column(b, 1)), rotate(column(b, 2)), transform(a, column(b, 3))])
}

/// Returns the inverse of a rigid pose (its rotation is transposed).
pub fn inverse_rigid(pose: &Pose) -> Pose {
    let origin = column(pose, 3);
    std::array::from_fn(|row| {
        let axis = column(pose, row);
        [axis[0], axis[1], axis[2], -dot(axis, origin)]
    })
}

/// Returns the mean pose of a capture: mean origin, mean viewing direction, and up as near to the mean up as possible.
/// `None` if the directions cancel out.
pub fn average(poses: &[Pose]) -> Option<Pose> {
    let along = |i: usize| mean(poses.iter().map(|p| column(p, i)));
    look_along(along(2), along(1), along(3))
}

/// Returns the point with the least mean squared distance to all viewing axes, or `None` if they are parallel.
pub fn focus_point(poses: &[Pose]) -> Option<Vec3> {
    let mut matrix = [[0.0; 3]; 3];
    let mut vector = [0.0; 3];
    for pose in poses {
        let (axis, origin) = (column(pose, 2), column(pose, 3));
        for i in 0..3 {
            for j in 0..3 {
                let projector = f64::from(i == j) - axis[i] * axis[j];
                matrix[i][j] += projector / poses.len() as f64;
                vector[i] += projector * origin[j] / poses.len() as f64;
            }
        }
    }
    solve(matrix, vector)
}

/// Solves a symmetric 3x3 system by Cramer's rule. `None` if it is singular.
pub fn solve(m: [Vec3; 3], v: Vec3) -> Option<Vec3> {
    let determinant = dot(m[0], cross(m[1], m[2]));
    if !determinant.is_finite() || determinant.abs() < 1e-9 {
        return None;
    }
    let with = |i: usize| {
        let mut replaced = m;
        replaced[i] = v;
        dot(replaced[0], cross(replaced[1], replaced[2])) / determinant
    };
    Some([with(0), with(1), with(2)])
}

/// Returns what is wrong unless the left 3x3 part is a rotation.
pub fn check_rotation(pose: &Pose) -> Result<(), String> {
    let [x, y, z, _] = [0, 1, 2, 3].map(|i| column(pose, i));
    let lengths = [x, y, z].map(length);
    if lengths.iter().any(|l| (l - 1.0).abs() > ROTATION_TOLERANCE) {
        return Err(format!("columns of length {:.4}, {:.4} and {:.4}", lengths[0], lengths[1], lengths[2]));
    }
    let skew = [dot(x, y), dot(y, z), dot(z, x)].map(f64::abs).into_iter().fold(0.0, f64::max);
    if skew > ROTATION_TOLERANCE {
        return Err(format!("columns that are not perpendicular (inner product {skew:.4})"));
    }
    if dot(cross(x, y), z) < 0.0 {
        return Err("mirrored (left-handed) axes".into());
    }
    Ok(())
}

/// Returns the pose without the scale that its axes share, and that scale. It is 1 if it is rounding, or not shared.
pub fn unscaled(pose: &Pose) -> (Pose, f64) {
    let lengths = [0, 1, 2].map(|i| length(column(pose, i)));
    let scale = lengths.iter().sum::<f64>() / 3.0;
    let within = |of: f64| lengths.iter().all(|length| (length / of - 1.0).abs() <= ROTATION_TOLERANCE);
    match scale.is_finite() && scale > 0.0 && !within(1.0) && within(scale) {
        true => (pose.map(|[a, b, c, t]| [a / scale, b / scale, c / scale, t]), scale),
        false => (*pose, 1.0),
    }
}

/// Returns a camera's pose with y and z turned round: from OpenCV's axes (y down, z ahead) to OpenGL's, or back.
pub fn flipped(pose: &Pose) -> Pose {
    pose.map(|[x, y, z, t]| [x, -y, -z, t])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted() -> Pose {
        look_along([0.3, -0.5, 0.9], [0.1, 1.0, 0.2], [1.0, 2.0, -3.0]).unwrap()
    }

    #[test]
    fn inverse_undoes_the_pose() {
        let identity = compose(&inverse_rigid(&tilted()), &tilted());
        for (i, row) in identity.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((value - f64::from(i == j)).abs() < 1e-14);
            }
        }
        assert_eq!(check_rotation(&tilted()), Ok(()));
    }

    #[test]
    fn focus_point_is_where_the_axes_meet() {
        let target = [0.5, -1.0, 2.0];
        let at = |origin: Vec3| look_along(sub(origin, target), [0.0, 1.0, 0.1], origin).unwrap();
        let found = focus_point(&[at([4.0, 0.0, 0.0]), at([0.0, 3.0, 1.0]), at([-2.0, 1.0, 7.0])]).unwrap();
        assert!(length(sub(found, target)) < 1e-12);
        assert!(focus_point(&[tilted(), tilted()]).is_none());
    }

    #[test]
    fn mirrored_and_scaled_matrices_are_no_rotations() {
        let mut mirrored = tilted();
        mirrored.iter_mut().for_each(|row| row[0] = -row[0]);
        assert!(check_rotation(&mirrored).unwrap_err().contains("mirrored"));
        let scaled = tilted().map(|row| row.map(|v| 2.0 * v));
        assert!(check_rotation(&scaled).unwrap_err().contains("2.0000"));
    }
}
