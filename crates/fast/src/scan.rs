//! Compositing as one differentiable operation on the CPU: a scan along each ray, and one back.

use augnerf_base::place::is_ours;
use augnerf_base::tensors::slice;
use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor, WithDType};

/// Number types of the scans. Sums along a ray are in f64.
pub trait Real: WithDType {
    /// Returns exp(-self).
    fn exp_neg(self) -> Self;
}

impl Real for f32 {
    fn exp_neg(self) -> f32 {
        (-self).exp()
    }
}

impl Real for f64 {
    fn exp_neg(self) -> f64 {
        (-self).exp()
    }
}

/// From colours `[rays, samples, 3]`, densities `[rays, samples]` and positions to one flat tensor. Positions are
/// points `[rays, samples]`, or edges of intervals `[rays, samples + 1]`. The tensor holds colour `[3 rays]`, depth
/// `[rays]`, acc `[rays]` and weights `[rays * samples]`.
pub struct Scan {
    /// Lengths of the rays' directions.
    pub direction_norm: Vec<f64>,
    /// Length of the last interval of samples at points, in units of `t_vals`.
    pub last_interval: f64,
    /// Colour behind the samples.
    pub background: Option<[f32; 3]>,
}

/// Inputs and results of a forward pass.
pub struct Passed<'a, T> {
    /// `[rays, samples, 3]`.
    pub rgb: &'a [T],
    /// `[rays, samples]`.
    pub density: &'a [T],
    /// `[rays, samples]`, or edges `[rays, samples + 1]`.
    pub t_vals: &'a [T],
    /// `[rays, samples]`.
    pub weights: &'a [T],
    /// Transmittance behind each sample.
    pub behind: &'a [T],
}

/// Gradients of rendered rays. A missing one counts as 0.
pub struct Gradients<'a, T> {
    /// `[rays, 3]`.
    pub colours: &'a [T],
    /// `[rays]`.
    pub depths: Option<&'a [T]>,
    /// `[rays]`.
    pub accs: Option<&'a [T]>,
    /// `[rays, samples]`.
    pub weights: Option<&'a [T]>,
    /// Whether positions need a gradient. It stays 0 otherwise.
    pub wants_t_vals: bool,
}

/// One ray's samples.
struct Ray<'a, T> {
    rgb: &'a [T],
    density: &'a [T],
    t_vals: &'a [T],
    norm: f64,
    last_interval: f64,
}

/// The contribution of one sample to a ray.
struct Contribution {
    /// T_k, transmittance before it.
    before: f64,
    /// T_k alpha_k, its weight.
    weight: f64,
    /// T_k (1 - alpha_k), transmittance behind it.
    behind: f64,
}

impl<T: Real> Ray<'_, T> {
    /// Returns interval `k` in scene units.
    fn interval(&self, k: usize) -> T {
        let length = match self.t_vals.get(k + 1) {
            Some(next) => (*next - self.t_vals[k]).to_f64(),
            None => self.last_interval,
        };
        T::from_f64(length * self.norm)
    }

    /// Returns the position of sample `k`: its point, or the middle of its interval.
    fn position(&self, k: usize) -> f64 {
        if self.has_edges() { 0.5 * (self.t_vals[k] + self.t_vals[k + 1]).to_f64() } else { self.t_vals[k].to_f64() }
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
            let kept = optical.exp_neg();
            let transmittance = T::from_f64(before).exp_neg();
            let alpha = T::from_f64(1.0) - kept;
            let before_it = transmittance.to_f64();
            visit(
                k,
                Contribution {
                    before: before_it,
                    weight: (alpha * transmittance).to_f64(),
                    behind: (kept * transmittance).to_f64(),
                },
            );
            before += optical.to_f64();
        }
    }
}

/// Composites colours, densities and positions in candle's graph, to what a [`Scan`] returns. `None` if candle's own
/// operations have to.
///
/// # Errors
/// Those of candle.
pub fn composite(
    [rgb, density, t_vals]: [&Tensor; 3],
    direction_norm: &Tensor,
    last_interval: f64,
    background: Option<[f32; 3]>,
) -> Result<Option<Tensor>> {
    if !is_ours(rgb) {
        return Ok(None);
    }
    let direction_norm = direction_norm.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    let scan = Scan { direction_norm, last_interval, background };
    Ok(Some(rgb.contiguous()?.apply_op3(&density.contiguous()?, &t_vals.contiguous()?, scan)?))
}

impl Scan {
    fn ray<'a, T>(&self, ray: usize, samples: usize, rgb: &'a [T], density: &'a [T], t_vals: &'a [T]) -> Ray<'a, T> {
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
    pub fn forward<T: Real>(&self, rgb: &[T], density: &[T], t_vals: &[T]) -> (Vec<T>, Vec<T>) {
        let rays = self.direction_norm.len();
        let samples = density.len().checked_div(rays).unwrap_or(0);
        let mut out = vec![T::from_f64(0.0); rays * (5 + samples)];
        let mut all_behind = Vec::with_capacity(density.len());
        let (colours, rest) = out.split_at_mut(3 * rays);
        let (depths, rest) = rest.split_at_mut(rays);
        let (accs, weights) = rest.split_at_mut(rays);
        for i in 0..rays {
            let ray = self.ray(i, samples, rgb, density, t_vals);
            let (mut colour, mut depth, mut acc) = ([0f64; 3], 0.0, 0.0);
            let weights = &mut weights[i * samples..][..samples];
            ray.scan(|k, Contribution { weight, behind, .. }| {
                weights[k] = T::from_f64(weight);
                all_behind.push(T::from_f64(behind));
                for (sum, c) in colour.iter_mut().zip(&ray.rgb[3 * k..3 * k + 3]) {
                    *sum += weight * c.to_f64();
                }
                depth += weight * ray.position(k);
                acc += weight;
            });
            for (out, (sum, fill)) in colours[3 * i..][..3].iter_mut().zip(colour.into_iter().zip(self.fill())) {
                *out = T::from_f64(sum + (1.0 - acc) * fill);
            }
            depths[i] = T::from_f64(depth);
            accs[i] = T::from_f64(acc);
        }
        (out, all_behind)
    }

    /// Returns the accumulation of each ray, the sum of its weights.
    pub fn accumulations<T: Real>(&self, density: &[T], t_vals: &[T]) -> Vec<T> {
        let rays = self.direction_norm.len();
        let [samples, columns] = [density, t_vals].map(|values| values.len().checked_div(rays).unwrap_or(0));
        let acc = |(i, &norm): (usize, &f64)| {
            let (density, t_vals) = (&density[i * samples..][..samples], &t_vals[i * columns..][..columns]);
            let ray = Ray { rgb: &[], density, t_vals, norm, last_interval: self.last_interval };
            let mut acc = 0.0;
            ray.scan(|_, sample| acc += sample.weight);
            T::from_f64(acc)
        };
        self.direction_norm.iter().enumerate().map(acc).collect()
    }

    /// Returns the gradients of colours, densities and positions. With G_k the gradient of weight k, that of the
    /// optical depth o_k = density_k * interval_k is G_k T_k exp(-o_k) - sum over l > k of G_l w_l. The last interval's
    /// o is in no other weight.
    pub fn backward<T: Real>(&self, passed: Passed<T>, gradients: Gradients<T>) -> [Vec<T>; 3] {
        let Passed { rgb, density, t_vals, weights, behind } = passed;
        let rays = self.direction_norm.len();
        let samples = density.len().checked_div(rays).unwrap_or(0);
        let zeros = |n: usize| vec![T::from_f64(0.0); n];
        let mut out = [zeros(rgb.len()), zeros(density.len()), zeros(t_vals.len())];
        let [d_rgb, d_density, d_t] = &mut out;
        let entry = |gradient: Option<&[T]>, at: usize| gradient.map_or(0.0, |gradient| gradient[at].to_f64());
        for i in 0..rays {
            let ray = self.ray(i, samples, rgb, density, t_vals);
            let g_colour: [f64; 3] = std::array::from_fn(|c| gradients.colours[3 * i + c].to_f64());
            let (g_depth, fill) = (entry(gradients.depths, i), self.fill());
            let g_acc = entry(gradients.accs, i) - (0..3).map(|c| g_colour[c] * fill[c]).sum::<f64>();
            let row = i * samples;
            // Contribution of the samples behind; 0 behind the last.
            let mut later = 0.0;
            for k in (0..samples).rev() {
                let colour = &ray.rgb[3 * k..3 * k + 3];
                let weight = weights[row + k].to_f64();
                let of_colour: f64 = (0..3).map(|c| g_colour[c] * colour[c].to_f64()).sum();
                let g_weight = of_colour + g_depth * ray.position(k) + g_acc + entry(gradients.weights, row + k);
                for c in 0..3 {
                    d_rgb[3 * (row + k) + c] = T::from_f64(weight * g_colour[c]);
                }
                let d_optical = g_weight * behind[row + k].to_f64() - later;
                d_density[row + k] = T::from_f64(d_optical * ray.interval(k).to_f64());
                later += g_weight * weight;
                if !gradients.wants_t_vals {
                    continue;
                }
                let d_length = d_optical * ray.density[k].to_f64() * ray.norm;
                let mut add = |column: usize, value: f64| {
                    let at = &mut d_t[i * ray.t_vals.len() + column];
                    *at = T::from_f64(at.to_f64() + value);
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

/// Returns the transmittance before each sample of one ray, as `transmittance` of `augnerf_nerf::render::volume`.
pub fn transmittance(t_vals: &[f64], density: &[f64], norm: f64, last_interval: f64) -> Vec<f64> {
    let ray = Ray { rgb: &[], density, t_vals, norm, last_interval };
    let mut before = Vec::with_capacity(density.len());
    ray.scan(|_, sample| before.push(sample.before));
    before
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
        macro_rules! forward {
            ($kind:ident) => {{
                let (rgb, density) = (slice(rgb, rgb_layout)?, slice(density, density_layout)?);
                let (out, _) = self.forward(rgb, density, slice(t_vals, t_layout)?);
                let n = out.len();
                Ok((CpuStorage::$kind(out), Shape::from(n)))
            }};
        }
        match rgb {
            CpuStorage::F32(_) => forward!(F32),
            CpuStorage::F64(_) => forward!(F64),
            _ => candle_core::bail!("compositing is for f32 and f64"),
        }
    }

    fn bwd(
        &self,
        rgb: &Tensor,
        density: &Tensor,
        t_vals: &Tensor,
        _out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        match gradient.dtype() {
            DType::F64 => self.gradients::<f64>([rgb, density, t_vals], gradient),
            _ => self.gradients::<f32>([rgb, density, t_vals], gradient),
        }
    }
}

impl Scan {
    fn gradients<T: Real>(
        &self,
        arguments: [&Tensor; 3],
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let values = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<T>();
        let [rgb, density, t_vals] = arguments;
        let (of_rgb, of_density, of_t) = (values(rgb)?, values(density)?, values(t_vals)?);
        let rays = self.direction_norm.len();
        let (out, behind) = self.forward(&of_rgb, &of_density, &of_t);
        let gradient = values(gradient)?;
        let (colours, rest) = gradient.split_at(3 * rays);
        let (depths, rest) = rest.split_at(rays);
        let (accs, weights) = rest.split_at(rays);
        let passed =
            Passed { rgb: &of_rgb, density: &of_density, t_vals: &of_t, weights: &out[5 * rays..], behind: &behind };
        let gradients = Gradients {
            colours,
            depths: Some(depths),
            accs: Some(accs),
            weights: Some(weights),
            wants_t_vals: t_vals.track_op(),
        };
        let [d_rgb, d_density, d_t] = self.backward(passed, gradients);
        let tensor = |values: Vec<T>, like: &Tensor| {
            like.track_op().then(|| Tensor::from_vec(values, like.shape(), like.device())).transpose()
        };
        Ok((tensor(d_rgb, rgb)?, tensor(d_density, density)?, tensor(d_t, t_vals)?))
    }
}
