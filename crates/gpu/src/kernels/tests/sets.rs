//! Constraint sets and their radii: random points, steps of the search, and what is at its bound.

use augnerf_nerf::perturb::{DeltaSet, Norm};

use super::*;

/// A set and its parameters: boxes or balls of `size` numbers, `per_ray` of them a ray.
#[derive(Clone, Copy)]
struct Case {
    norm: Norm,
    size: usize,
    per_ray: usize,
    radius: Radius,
    masks_last: bool,
    relative: bool,
}

/// The radius of a set.
#[derive(Clone, Copy, PartialEq)]
enum Radius {
    One,
    /// A pixel, or a part of the ray if that is shorter.
    Pixel,
    /// Of positions, which are bounded by near - t and far - t: by one of the three rules of `set.wgsl`.
    OfGaps(usize),
}

const PLAIN: Case =
    Case { norm: Norm::Linf, size: 3, per_ray: 5, radius: Radius::One, masks_last: false, relative: false };

const CASES: [Case; 7] = [
    PLAIN,
    Case { norm: Norm::L2, relative: true, ..PLAIN },
    Case { norm: Norm::L2, radius: Radius::Pixel, ..PLAIN },
    Case { size: 1, radius: Radius::OfGaps(0), relative: true, ..PLAIN },
    Case { size: 1, radius: Radius::OfGaps(1), relative: true, ..PLAIN },
    Case { size: 1, radius: Radius::OfGaps(2), ..PLAIN },
    Case { size: 1, masks_last: true, ..PLAIN },
];

const RAYS: usize = 14;
/// The first ray of the chunk.
const RAY0: usize = 5;
const RADIUS: f64 = 0.3;
const PIXEL: f64 = 0.2;
const CAP: f64 = 0.5;
/// Share, coarse, drawn, coarse gap, reach.
const GAPS: [f64; 5] = [0.4, 1.5, 2.5, 0.25, 0.05];
const STEP: f64 = 0.25;
const BOUNDS: (f64, f64) = (2.0, 4.0);

impl Case {
    fn vectors(self) -> usize {
        RAYS * self.per_ray
    }

    fn is_bounded(self) -> bool {
        matches!(self.radius, Radius::OfGaps(_))
    }

    fn rays(self) -> Vec<f32> {
        numbers((RAY0 + RAYS) * RAY, 1.0, 150).iter().map(|x| x.abs()).collect()
    }

    /// Positions that grow along each ray.
    fn t_vals(self) -> Vec<f32> {
        let gaps: Vec<f32> = numbers(self.vectors(), 0.3, 149).iter().map(|x| x.abs() + 0.01).collect();
        let grown =
            |gaps: &[f32]| -> Vec<f32> { (1..=gaps.len()).map(|k| 2.0 + gaps[..k].iter().sum::<f32>()).collect() };
        gaps.chunks(self.per_ray).flat_map(grown).collect()
    }

    fn radii(self) -> Vec<f64> {
        let (rays, t_vals) = (self.rays(), self.t_vals());
        let of = |v: usize| match self.radius {
            Radius::One => f64::from(RADIUS as f32),
            Radius::Pixel => f64::min(CAP * f64::from(rays[RAY * (RAY0 + v / self.per_ray) + 18]), PIXEL),
            Radius::OfGaps(kind) => {
                let gap = |from: usize| f64::from(t_vals[from + 1]) - f64::from(t_vals[from]);
                let (before, after) = match v % self.per_ray {
                    0 => (gap(v), gap(v)),
                    k if k + 1 == self.per_ray => (gap(v - 1), gap(v - 1)),
                    _ => (gap(v - 1), gap(v)),
                };
                let ([share, coarse, drawn, coarse_gap, reach], nearer) = (GAPS, before.min(after));
                match kind {
                    0 => nearer * share,
                    1 => {
                        let of_coarse = (0.5 * (before + after) / coarse_gap).min(1.0);
                        nearer * (share / (of_coarse * coarse + (1.0 - of_coarse) * drawn)).min(0.5)
                    }
                    _ => (nearer * share).min(reach),
                }
            }
        };
        (0..self.vectors()).map(of).collect()
    }

    /// The same set in f64.
    fn set(self) -> DeltaSet {
        let vectors = self.vectors();
        let radii = Tensor::from_vec(self.radii(), (vectors, 1), &Device::Cpu).unwrap();
        let mut set = DeltaSet::new(self.norm, radii, &[vectors, self.size]);
        if self.is_bounded() {
            let t_vals = wide(&self.t_vals(), &[vectors, 1]);
            let to = |end: f64| (t_vals.neg().unwrap() + end).unwrap();
            set.bounds = Some((to(BOUNDS.0).minimum(0.0).unwrap(), to(BOUNDS.1).maximum(0.0).unwrap()));
        }
        if self.masks_last {
            let moves: Vec<f32> =
                (0..vectors).map(|v| f32::from(u8::from(v % self.per_ray < self.per_ray - 1))).collect();
            set.mask = Some(wide(&moves, &[vectors, 1]));
        }
        set
    }

    /// The parameters that all kernels of sets have. `rest` are those that a test needs beside.
    fn params(self, rest: Params, (near, far): (f64, f64)) -> Params {
        let kind = if let Radius::OfGaps(kind) = self.radius { kind } else { 0 };
        let [share, coarse, drawn, coarse_gap, reach] = GAPS;
        let masks_last = if self.masks_last { self.per_ray } else { 0 };
        let (vectors, size, ball, per_ray) = (self.vectors(), self.size, self.norm == Norm::L2, self.per_ray);
        params! { vectors, size, ball, per_ray, radius: RADIUS, near, far, masks_last, step: STEP, relative: self.relative }
            .and(params! { ray0: RAY0, pixel: PIXEL, cap: CAP, kind, share, coarse, drawn, coarse_gap, reach })
            .and(rest.rest_is_zero())
    }

    fn kernel(self, name: &'static str) -> Kernel {
        let each = self.norm == Norm::Linf && name != "at_bound";
        let kernel = Kernel::new(name).with("PIXEL", self.radius == Radius::Pixel);
        kernel.with("BOUNDED", self.is_bounded()).with("EACH", each)
    }

    /// Runs a kernel on a delta, with the rays, the positions and more buffers.
    fn run(self, gpu: &Gpu, kernel: Kernel, params: Params, delta: &Buffer, more: &[(u32, &Buffer)]) {
        let (rays, t_vals) = (gpu.storage(&self.rays()), gpu.storage(&self.t_vals()));
        let mut buffers = vec![(1, delta)];
        buffers.extend((self.radius == Radius::Pixel).then_some((2, &rays)));
        buffers.extend(self.is_bounded().then_some((3, &t_vals)));
        buffers.extend_from_slice(more);
        run(gpu, kernel, params, &buffers, groups(self.vectors() * self.size));
    }
}

/// A step up the gradient from where the pass put the delta, and back onto the set.
#[test]
fn steps_of_the_search() {
    let gpu = gpu();
    for case in CASES {
        let (vectors, size) = (case.vectors(), case.size);
        let (stride, offset) = (size + 2, 1);
        let start = numbers(vectors * size, 0.2, 142);
        let mut gradient = numbers(vectors * stride, 1.0, 143);
        gradient[..2 * stride].fill(0.0);
        for takes_used in [false, true] {
            let (delta, used) = (gpu.storage(&start), gpu.storage(&start));
            if takes_used {
                gpu.clear(&delta);
            }
            let gradient_buffer = gpu.storage(&gradient);
            let mut more = vec![(4, &gradient_buffer)];
            more.extend(takes_used.then_some((5, &used)));
            let kernel = case.kernel("ascend").with("USED", takes_used);
            case.run(&gpu, kernel, case.params(params! { stride, offset }, BOUNDS), &delta, &more);
            let set = case.set();
            let along: Vec<f32> = gradient.chunks(stride).flat_map(|row| row[offset..offset + size].to_vec()).collect();
            let direction = set.direction(&wide(&along, &[vectors, size])).unwrap();
            let step = (if case.relative { direction.broadcast_mul(&set.radius) } else { Ok(direction) }).unwrap();
            let moved = (wide(&start, &[vectors, size]) + (step * STEP).unwrap()).unwrap();
            let expected = flat(&set.project(&moved).unwrap());
            near("ascend", &gpu.read_f32(&delta, vectors * size).unwrap(), &expected, 1e-6);
        }
    }
}

/// Random points of sets, from numbers in chunks of the host's.
#[test]
fn random_points() {
    let gpu = gpu();
    for case in CASES {
        let (vectors, size) = (case.vectors(), case.size);
        let (chunk, first) = (vectors / 2, 3);
        // Numbers of a chunk are padded to an even count.
        let of_chunk = (chunk * size).next_multiple_of(2);
        for gaussian in [false, true] {
            let is_ball = case.norm == Norm::L2 && !gaussian;
            let centred = gaussian || is_ball;
            let values: Vec<f32> = numbers(first + 2 * of_chunk, 1.0, 144)
                .iter()
                .map(|x| if centred { 2.0 * x } else { 0.5 + 0.499 * x })
                .collect();
            let distances: Vec<f32> = numbers(vectors, 1.0, 145).iter().map(|x| x.abs()).collect();
            let all: Vec<f32> = values.iter().chain(&distances).copied().collect();
            let (delta, drawn) = (gpu.numbers(vectors * size), gpu.storage(&all));
            let rest = params! { gaussian, chunk, normals: of_chunk, first, first_distance: values.len() };
            case.run(&gpu, case.kernel("draw"), case.params(rest, BOUNDS), &delta, &[(4, &drawn)]);
            let own: Vec<f32> = (0..vectors * size)
                .map(|i| values[first + i / (chunk * size) * of_chunk + i % (chunk * size)])
                .collect();
            let (set, own) = (case.set(), wide(&own, &[vectors, size]));
            let point = match (gaussian, case.norm, &set.bounds) {
                (true, ..) => (own.broadcast_mul(&set.radius).unwrap() / 3f64.sqrt()).unwrap(),
                (false, Norm::L2, _) => {
                    let distance = wide(&distances, &[vectors, 1]).powf(1.0 / size as f64).unwrap();
                    let along = set.direction(&own).unwrap().broadcast_mul(&distance).unwrap();
                    along.broadcast_mul(&set.radius).unwrap()
                }
                (false, Norm::Linf, Some((lower, upper))) => {
                    let low = lower.maximum(&set.radius.neg().unwrap()).unwrap();
                    let width = (upper.minimum(&set.radius).unwrap() - &low).unwrap();
                    ((own * width).unwrap() + low).unwrap()
                }
                (false, Norm::Linf, None) => own.affine(2.0, -1.0).unwrap().broadcast_mul(&set.radius).unwrap(),
            };
            let expected = flat(&set.project(&point).unwrap());
            near("draw", &gpu.read_f32(&delta, vectors * size).unwrap(), &expected, 1e-5);
        }
    }
}

/// Counts of numbers (of balls: vectors) at their bounds, and of those that may move.
#[test]
fn counts_at_bounds() {
    let gpu = gpu();
    let case_of_output = Case { size: 1, ..PLAIN };
    for case in CASES {
        let (vectors, size, first) = (case.vectors(), case.size, 2);
        let set = case.set();
        let delta = flat(&set.project(&wide(&numbers(vectors * size, 0.5, 146), &[vectors, size])).unwrap());
        let delta: Vec<f32> = delta.iter().map(|x| *x as f32).collect();
        let (buffer, counts) = (gpu.storage(&delta), gpu.numbers(4));
        case.run(&gpu, case.kernel("at_bound"), case.params(params! { first }, BOUNDS), &buffer, &[(4, &counts)]);
        let counted: Vec<u32> = bytemuck::pod_collect_to_vec(&gpu.read(&[&counts]).unwrap()[0]);
        let share = f64::from(counted[first]) / f64::from(counted[first + 1]);
        let masked = if case.masks_last { RAYS } else { 0 };
        let numbers = if case.norm == Norm::L2 { 1 } else { size };
        assert_eq!(counted[first + 1] as usize, (vectors - masked) * numbers);
        let expected = set.share_at_bound(&wide(&delta, &[vectors, size])).unwrap().unwrap();
        assert!(counted[first] > 0 && (share - expected).abs() < 1e-12, "{share} for {expected}");
    }
    // Colours on the edge of what they can be are at a bound, too.
    let (vectors, range) = (case_of_output.vectors(), (0.1, 0.9));
    let (delta, values) = (numbers(vectors, 0.5, 147), numbers(4 * vectors, 1.0, 148));
    let (buffer, values_buffer, counts) = (gpu.storage(&delta), gpu.storage(&values), gpu.numbers(4));
    let kernel = case_of_output.kernel("at_bound").with("OUTPUT", true);
    let params = case_of_output.params(params! { offset: 3usize }, range);
    case_of_output.run(&gpu, kernel, params, &buffer, &[(4, &counts), (5, &values_buffer)]);
    let at = |i: &usize| {
        let (delta, value) = (f64::from(delta[*i]), f64::from(values[4 * i + 3]));
        delta.abs() >= 0.999 * RADIUS || value <= range.0 || value >= range.1
    };
    let counted: Vec<u32> = bytemuck::pod_collect_to_vec(&gpu.read(&[&counts]).unwrap()[0]);
    assert_eq!(counted[..2], [(0..vectors).filter(at).count() as u32, vectors as u32]);
}
