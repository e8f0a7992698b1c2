//! The nearest of many points, by a k-d tree (Bentley 1975, Multidimensional binary search trees).

use crate::data::vector::{Vec3, dot, sub};

/// Cells of so few points are searched one by one.
const LEAF: usize = 8;

/// Points in the order of a balanced tree: the middle one of a cell parts the others along the axis on which they are
/// spread widest, so that flat clouds and equal coordinates part as well as any.
pub struct PointTree {
    points: Vec<Vec3>,
    /// The axis of each point that parts a cell.
    axes: Vec<u8>,
    lowest: Vec3,
    highest: Vec3,
}

impl PointTree {
    pub fn new(points: &[Vec3]) -> PointTree {
        let (lowest, highest) = extent(points);
        let (mut points, mut axes) = (points.to_vec(), vec![0; points.len()]);
        arrange(&mut points, &mut axes);
        PointTree { points, axes, lowest, highest }
    }

    /// The square of the distance to the nearest point; infinite without points.
    ///
    /// It is the smallest of all distances to the last bit, however the tree is built: rounding keeps order, so that
    /// what [`search`] passes over was bounded by a number that no point behind it falls below.
    pub fn squared_distance(&self, to: Vec3) -> f64 {
        let away = |axis: usize| (self.lowest[axis] - to[axis]).max(to[axis] - self.highest[axis]).max(0.0);
        let mut nearest = f64::INFINITY;
        search((&self.points, &self.axes), to, [0, 1, 2].map(away), &mut nearest);
        nearest
    }
}

/// The smallest and the largest coordinate on each axis.
fn extent(points: &[Vec3]) -> (Vec3, Vec3) {
    let over = |pick: fn(f64, f64) -> f64, start: f64| {
        points.iter().fold([start; 3], |ends, point| [0, 1, 2].map(|axis| pick(ends[axis], point[axis])))
    };
    (over(f64::min, f64::INFINITY), over(f64::max, f64::NEG_INFINITY))
}

fn arrange(points: &mut [Vec3], axes: &mut [u8]) {
    if points.len() <= LEAF {
        return;
    }
    let (lowest, highest) = extent(points);
    let spread = sub(highest, lowest);
    let axis = (0..3).fold(0, |widest, axis| if spread[axis] > spread[widest] { axis } else { widest });
    let middle = points.len() / 2;
    axes[middle] = axis as u8;
    let (below, _, above) = points.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis]));
    let (axes_below, axes_above) = axes.split_at_mut(middle);
    rayon::join(|| arrange(below, axes_below), || arrange(above, &mut axes_above[1..]));
}

/// Lowers `nearest` to the smallest squared distance between `to` and a cell's points. On each axis they are all at
/// least `away` from it.
fn search((points, axes): (&[Vec3], &[u8]), to: Vec3, mut away: Vec3, nearest: &mut f64) {
    let meet = |point: Vec3, nearest: &mut f64| {
        let apart = sub(to, point);
        *nearest = nearest.min(dot(apart, apart));
    };
    if points.len() <= LEAF {
        return points.iter().for_each(|&point| meet(point, nearest));
    }
    let middle = points.len() / 2;
    let axis = usize::from(axes[middle]);
    let beyond = to[axis] - points[middle][axis];
    let below = (&points[..middle], &axes[..middle]);
    let above = (&points[middle + 1..], &axes[middle + 1..]);
    let (near, far) = if beyond < 0.0 { (below, above) } else { (above, below) };
    search(near, to, away, nearest);
    away[axis] = away[axis].max(beyond.abs());
    // In the order of a distance's own sum: otherwise the bound could come out above it.
    if dot(away, away) < *nearest {
        meet(points[middle], nearest);
        search(far, to, away, nearest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};

    fn cloud(count: usize, seed: u64, point: impl Fn(&mut Random) -> Vec3) -> Vec<Vec3> {
        let mut random = Random::new(seed, Stream::Surface, 0);
        (0..count).map(|_| point(&mut random)).collect()
    }

    #[test]
    fn it_is_the_smallest_of_all_distances_to_the_last_bit() {
        let cube = |r: &mut Random| [0; 3].map(|_| r.uniform());
        let steps = |r: &mut Random| [0; 3].map(|_| (6.0 * r.uniform()).floor());
        let flat = |r: &mut Random| [r.uniform(), 0.5, r.uniform()];
        let far = |r: &mut Random| [r.uniform() + 30.0, 1e-9 * r.uniform(), -1e3];
        let same = |_: &mut Random| [0.5; 3];
        let clouds = |seed: u64| {
            let others = [cloud(700, seed, flat), cloud(700, seed, far), cloud(700, seed, same)];
            [cloud(700, seed, cube), cloud(700, seed, steps), cloud(5, seed, cube)].into_iter().chain(others)
        };
        for to in clouds(0) {
            let tree = PointTree::new(&to);
            for from in clouds(1).flatten() {
                let all = to.iter().map(|&point| dot(sub(from, point), sub(from, point)));
                assert_eq!(tree.squared_distance(from), all.fold(f64::INFINITY, f64::min), "{from:?}");
            }
        }
    }

    #[test]
    fn the_tree_keeps_every_point() {
        let cube = |r: &mut Random| [0; 3].map(|_| r.uniform());
        let points = cloud(50_000, 0, cube);
        let tree = PointTree::new(&points);
        assert!(points.iter().all(|&point| tree.squared_distance(point) == 0.0));
        let order = |points: &[Vec3]| {
            let mut points = points.to_vec();
            points.sort_by(|a, b| a.partial_cmp(b).unwrap());
            points
        };
        assert_eq!(order(&tree.points), order(&points));
    }
}
