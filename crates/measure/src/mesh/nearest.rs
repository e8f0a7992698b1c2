//! The nearest of many points, by a k-d tree (Bentley 1975, Multidimensional binary search trees) of tight boxes.

use augnerf_scenes::vector::{Vec3, dot, sub};

/// Cells with this few points are searched one by one.
const LEAF: usize = 16;

/// Points in the order of a balanced tree. The two halves of a cell are separated along its widest axis, so that flat
/// clouds and equal coordinates work as well.
pub struct PointTree {
    points: Vec<Vec3>,
    /// Boxes of all cells: each before its lower half, and that before its upper half.
    boxes: Vec<Extent>,
}

/// The smallest and the largest coordinate on each axis.
#[derive(Clone, Copy)]
struct Extent {
    lowest: Vec3,
    highest: Vec3,
}

impl Extent {
    const NONE: Extent = Extent { lowest: [f64::INFINITY; 3], highest: [f64::NEG_INFINITY; 3] };

    fn of(points: &[Vec3]) -> Extent {
        points.iter().fold(Extent::NONE, |Extent { lowest, highest }, point| Extent {
            lowest: [0, 1, 2].map(|axis| lowest[axis].min(point[axis])),
            highest: [0, 1, 2].map(|axis| highest[axis].max(point[axis])),
        })
    }

    /// Returns a bound on the squared distance, as rounded, to all points of the box. Each difference is rounded in the
    /// same order, and they are summed as a distance's are.
    fn squared_distance(&self, to: Vec3) -> f64 {
        let away = [0, 1, 2].map(|axis| (self.lowest[axis] - to[axis]).max(to[axis] - self.highest[axis]).max(0.0));
        dot(away, away)
    }
}

impl PointTree {
    pub fn new(points: &[Vec3]) -> PointTree {
        let mut points = points.to_vec();
        let mut boxes = vec![Extent::NONE; cells(points.len())];
        arrange(&mut points, &mut boxes);
        PointTree { points, boxes }
    }

    /// Returns the square of the distance to the nearest point. It is infinite without points.
    ///
    /// It is the smallest of all distances to the last bit, for any shape of the tree. [`search`] skips only cells
    /// whose bound no point falls below.
    pub fn squared_distance(&self, to: Vec3) -> f64 {
        let mut nearest = f64::INFINITY;
        search(&self.points, &self.boxes, to, &mut nearest);
        nearest
    }
}

/// Returns the number of cells of a tree with this many points. All its leaves are at the same depth.
fn cells(points: usize) -> usize {
    let leaves = points.div_ceil(LEAF).max(1).next_power_of_two();
    2 * leaves - 1
}

fn arrange(points: &mut [Vec3], boxes: &mut [Extent]) {
    let all = Extent::of(points);
    let (own, boxes) = boxes.split_first_mut().expect("a box for each cell");
    *own = all;
    if boxes.is_empty() {
        return;
    }
    let spread = sub(all.highest, all.lowest);
    let axis = (0..3).fold(0, |widest, axis| if spread[axis] > spread[widest] { axis } else { widest });
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis]));
    let (below, above) = points.split_at_mut(middle);
    let (boxes_below, boxes_above) = boxes.split_at_mut(boxes.len() / 2);
    rayon::join(|| arrange(below, boxes_below), || arrange(above, boxes_above));
}

/// Lowers `nearest` to the smallest squared distance between `to` and a cell's points.
fn search(points: &[Vec3], boxes: &[Extent], to: Vec3, nearest: &mut f64) {
    let boxes = &boxes[1..];
    if boxes.is_empty() {
        for &point in points {
            let apart = sub(to, point);
            *nearest = nearest.min(dot(apart, apart));
        }
        return;
    }
    let middle = points.len() / 2;
    let (below, above) = points.split_at(middle);
    let (boxes_below, boxes_above) = boxes.split_at(boxes.len() / 2);
    let halves = [(below, boxes_below), (above, boxes_above)]
        .map(|(points, boxes)| (boxes[0].squared_distance(to), points, boxes));
    let order = if halves[1].0 < halves[0].0 { [1, 0] } else { [0, 1] };
    for (bound, points, boxes) in order.map(|half| halves[half]) {
        if bound < *nearest {
            search(points, boxes, to, nearest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use augnerf_base::rng::{Random, Stream};

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
