//! Compositing as one differentiable operation on the CPU: a scan along each ray, and one back.

use augnerf_base::tensors::slice;
use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor};

/// The operation of [`composite`].
struct Scan {
    /// Lengths of the rays' directions.
    direction_norm: Vec<f64>,
    /// Length of the last interval of samples at points, in units of `t_vals`.
    last_interval: f64,
    /// Colour behind the samples.
    background: Option<[f32; 3]>,
}

/// One ray's samples.
struct Ray<'a> {
    rgb: &'a [f32],
    density: &'a [f32],
    t_vals: &'a [f32],
    norm: f64,
    last_interval: f64,
}

/// The contribution of one sample to a ray.
struct Contribution {
    /// T_k alpha_k, its weight.
    weight: f64,
    /// T_k (1 - alpha_k), transmittance behind it.
    behind: f64,
}

impl Ray<'_> {
    /// Returns interval `k` in scene units.
    fn interval(&self, k: usize) -> f32 {
        let length = match self.t_vals.get(k + 1) {
            Some(next) => f64::from(*next - self.t_vals[k]),
            None => self.last_interval,
        };
        (length * self.norm) as f32
    }

    /// Returns the position of sample `k`: its point, or the middle of its interval.
    fn position(&self, k: usize) -> f64 {
        if self.has_edges() { 0.5 * f64::from(self.t_vals[k] + self.t_vals[k + 1]) } else { f64::from(self.t_vals[k]) }
    }

    /// Returns whether samples are intervals between `t_vals`, not points at them.
    fn has_edges(&self) -> bool {
        self.t_vals.len() > self.density.len()
    }

    /// Visits the samples from the near end.
    fn scan(&self, mut visit: impl FnMut(usize, Contribution)) {
        let mut before = 0.0;
        for (k, density) in self.density.iter().enumerate() {
            let optical = *density * self.interval(k);
            let (kept, transmittance) = ((-optical).exp(), (-(before as f32)).exp());
            let alpha = 1.0 - kept;
            visit(
                k,
                Contribution { weight: f64::from(alpha * transmittance), behind: f64::from(kept * transmittance) },
            );
            before += f64::from(optical);
        }
    }
}

/// Composites f32 colours `[rays, samples, 3]`, densities `[rays, samples]` and positions on the CPU in candle's graph
/// to one flat tensor. Positions are points `[rays, samples]`, or edges of intervals `[rays, samples + 1]`. The tensor
/// holds colour `[3 rays]`, depth `[rays]`, acc `[rays]` and weights `[rays * samples]`.
///
/// # Errors
/// Those of candle.
pub fn composite(
    [rgb, density, t_vals]: [&Tensor; 3],
    direction_norm: &Tensor,
    last_interval: f64,
    background: Option<[f32; 3]>,
) -> Result<Tensor> {
    let direction_norm = direction_norm.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    let scan = Scan { direction_norm, last_interval, background };
    rgb.contiguous()?.apply_op3(&density.contiguous()?, &t_vals.contiguous()?, scan)
}

impl Scan {
    fn ray<'a>(&self, ray: usize, samples: usize, rgb: &'a [f32], density: &'a [f32], t_vals: &'a [f32]) -> Ray<'a> {
        let row = ray * samples..(ray + 1) * samples;
        let columns = t_vals.len() / self.direction_norm.len();
        Ray {
            rgb: &rgb[3 * row.start..3 * row.end],
            density: &density[row],
            t_vals: &t_vals[ray * columns..][..columns],
            norm: self.direction_norm[ray],
            last_interval: self.last_interval,
        }
    }

    fn fill(&self) -> [f64; 3] {
        self.background.unwrap_or_default().map(f64::from)
    }

    /// Returns the flat output, and the transmittance behind each sample.
    fn forward(&self, rgb: &[f32], density: &[f32], t_vals: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let rays = self.direction_norm.len();
        let samples = density.len().checked_div(rays).unwrap_or(0);
        let mut out = vec![0.0; rays * (5 + samples)];
        let mut all_behind = Vec::with_capacity(density.len());
        let (colours, rest) = out.split_at_mut(3 * rays);
        let (depths, rest) = rest.split_at_mut(rays);
        let (accs, weights) = rest.split_at_mut(rays);
        for i in 0..rays {
            let ray = self.ray(i, samples, rgb, density, t_vals);
            let (mut colour, mut depth, mut acc) = ([0f64; 3], 0.0, 0.0);
            let weights = &mut weights[i * samples..][..samples];
            ray.scan(|k, Contribution { weight, behind }| {
                weights[k] = weight as f32;
                all_behind.push(behind as f32);
                for (sum, c) in colour.iter_mut().zip(&ray.rgb[3 * k..3 * k + 3]) {
                    *sum += weight * f64::from(*c);
                }
                depth += weight * ray.position(k);
                acc += weight;
            });
            for (out, (sum, fill)) in colours[3 * i..][..3].iter_mut().zip(colour.into_iter().zip(self.fill())) {
                *out = (sum + (1.0 - acc) * fill) as f32;
            }
            depths[i] = depth as f32;
            accs[i] = acc as f32;
        }
        (out, all_behind)
    }

    /// Returns the gradients of colours, densities and, if `wants_t_vals`, positions (zeros otherwise), from the
    /// `gradient` of the flat output. With G_k the gradient of weight k, that of the optical depth
    /// o_k = density_k * interval_k is G_k T_k exp(-o_k) - sum over l > k of G_l w_l. The last interval's o is in no
    /// other weight.
    fn backward(&self, [rgb, density, t_vals]: [&[f32]; 3], gradient: &[f32], wants_t_vals: bool) -> [Vec<f32>; 3] {
        let rays = self.direction_norm.len();
        let samples = density.len().checked_div(rays).unwrap_or(0);
        let (out, behind) = self.forward(rgb, density, t_vals);
        let weights = &out[5 * rays..];
        let (g_colours, rest) = gradient.split_at(3 * rays);
        let (g_depths, rest) = rest.split_at(rays);
        let (g_accs, g_weights) = rest.split_at(rays);
        let zeros = |n: usize| vec![0.0; n];
        let mut out = [zeros(rgb.len()), zeros(density.len()), zeros(t_vals.len())];
        let [d_rgb, d_density, d_t] = &mut out;
        for i in 0..rays {
            let ray = self.ray(i, samples, rgb, density, t_vals);
            let g_colour: [f64; 3] = std::array::from_fn(|c| f64::from(g_colours[3 * i + c]));
            let (g_depth, fill) = (f64::from(g_depths[i]), self.fill());
            let g_acc = f64::from(g_accs[i]) - (0..3).map(|c| g_colour[c] * fill[c]).sum::<f64>();
            let row = i * samples;
            // Contribution of the samples behind; 0 behind the last.
            let mut later = 0.0;
            for k in (0..samples).rev() {
                let colour = &ray.rgb[3 * k..3 * k + 3];
                let weight = f64::from(weights[row + k]);
                let of_colour: f64 = (0..3).map(|c| g_colour[c] * f64::from(colour[c])).sum();
                let g_weight = of_colour + g_depth * ray.position(k) + g_acc + f64::from(g_weights[row + k]);
                for c in 0..3 {
                    d_rgb[3 * (row + k) + c] = (weight * g_colour[c]) as f32;
                }
                let d_optical = g_weight * f64::from(behind[row + k]) - later;
                d_density[row + k] = (d_optical * f64::from(ray.interval(k))) as f32;
                later += g_weight * weight;
                if !wants_t_vals {
                    continue;
                }
                let d_length = d_optical * f64::from(ray.density[k]) * ray.norm;
                let mut add = |column: usize, value: f64| {
                    let at = &mut d_t[i * ray.t_vals.len() + column];
                    *at = (f64::from(*at) + value) as f32;
                };
                let along = g_depth * weight;
                if ray.has_edges() {
                    add(k, 0.5 * along);
                    add(k + 1, 0.5 * along);
                } else {
                    add(k, along);
                }
                if k + 1 < ray.t_vals.len() {
                    add(k, -d_length);
                    add(k + 1, d_length);
                }
            }
        }
        out
    }
}

impl CustomOp3 for Scan {
    fn name(&self) -> &'static str {
        "composite"
    }

    fn cpu_fwd(
        &self,
        rgb: &CpuStorage,
        rgb_layout: &Layout,
        density: &CpuStorage,
        density_layout: &Layout,
        t_vals: &CpuStorage,
        t_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (rgb, density) = (slice(rgb, rgb_layout)?, slice(density, density_layout)?);
        let (out, _) = self.forward(rgb, density, slice(t_vals, t_layout)?);
        let n = out.len();
        Ok((CpuStorage::F32(out), Shape::from(n)))
    }

    fn bwd(
        &self,
        rgb: &Tensor,
        density: &Tensor,
        t_vals: &Tensor,
        _out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let values = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        let passed = [&values(rgb)?[..], &values(density)?, &values(t_vals)?];
        let [d_rgb, d_density, d_t] = self.backward(passed, &values(gradient)?, t_vals.track_op());
        let tensor = |values: Vec<f32>, like: &Tensor| {
            like.track_op().then(|| Tensor::from_vec(values, like.shape(), like.device())).transpose()
        };
        Ok((tensor(d_rgb, rgb)?, tensor(d_density, density)?, tensor(d_t, t_vals)?))
    }
}
