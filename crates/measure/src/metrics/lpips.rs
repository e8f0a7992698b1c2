//! LPIPS v0.1: a perceptual distance from the features of a pretrained network
//! (Zhang et al. 2018, "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric").

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use candle_core::{D, Device, Tensor};
use sha2::{Digest, Sha256};

use super::check_same_shape;
use super::weights::Weights;
use augnerf_base::short_hash;
use augnerf_base::{Error, Image, Result};

/// Mean and deviation of the scaling layer, for inputs in -1..=1.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Added to the length of a feature vector before dividing by it.
const NORM_EPS: f64 = 1e-10;
/// Most values that an unfolded strip of a convolution or a strip of features may hold: rows
/// are handled in strips, so that memory beyond the feature maps does not grow with the image.
const STRIP_VALUES: usize = 1 << 24;

/// The networks that LPIPS v0.1 was fitted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backbone {
    /// AlexNet.
    Alex,
    /// VGG-16.
    Vgg,
    /// SqueezeNet 1.1.
    Squeeze,
}

/// One step through a network's `features`; `index` is the module's place there, as in the
/// tensor names of torchvision.
#[derive(Clone, Copy)]
enum Step {
    /// A convolution with bias, then ReLU.
    Conv { index: usize, inputs: usize, outputs: usize, kernel: usize, stride: usize, padding: usize },
    /// Max-pooling of stride 2; `ceil` keeps a last window that reaches over the border.
    Pool { kernel: usize, ceil: bool },
    /// SqueezeNet's fire module; gives `2 * expand` channels.
    Fire { index: usize, inputs: usize, squeeze: usize, expand: usize },
    /// Features of this many channels are compared here.
    Compare { channels: usize },
}

use Step::{Compare, Fire, Pool};

const fn conv(index: usize, inputs: usize, outputs: usize) -> Step {
    Step::Conv { index, inputs, outputs, kernel: 3, stride: 1, padding: 1 }
}

const ALEX: &[Step] = &[
    Step::Conv { index: 0, inputs: 3, outputs: 64, kernel: 11, stride: 4, padding: 2 },
    Compare { channels: 64 },
    Pool { kernel: 3, ceil: false },
    Step::Conv { index: 3, inputs: 64, outputs: 192, kernel: 5, stride: 1, padding: 2 },
    Compare { channels: 192 },
    Pool { kernel: 3, ceil: false },
    conv(6, 192, 384),
    Compare { channels: 384 },
    conv(8, 384, 256),
    Compare { channels: 256 },
    conv(10, 256, 256),
    Compare { channels: 256 },
];

const VGG: &[Step] = &[
    conv(0, 3, 64),
    conv(2, 64, 64),
    Compare { channels: 64 },
    Pool { kernel: 2, ceil: false },
    conv(5, 64, 128),
    conv(7, 128, 128),
    Compare { channels: 128 },
    Pool { kernel: 2, ceil: false },
    conv(10, 128, 256),
    conv(12, 256, 256),
    conv(14, 256, 256),
    Compare { channels: 256 },
    Pool { kernel: 2, ceil: false },
    conv(17, 256, 512),
    conv(19, 512, 512),
    conv(21, 512, 512),
    Compare { channels: 512 },
    Pool { kernel: 2, ceil: false },
    conv(24, 512, 512),
    conv(26, 512, 512),
    conv(28, 512, 512),
    Compare { channels: 512 },
];

const SQUEEZE: &[Step] = &[
    Step::Conv { index: 0, inputs: 3, outputs: 64, kernel: 3, stride: 2, padding: 0 },
    Compare { channels: 64 },
    Pool { kernel: 3, ceil: true },
    Fire { index: 3, inputs: 64, squeeze: 16, expand: 64 },
    Fire { index: 4, inputs: 128, squeeze: 16, expand: 64 },
    Compare { channels: 128 },
    Pool { kernel: 3, ceil: true },
    Fire { index: 6, inputs: 128, squeeze: 32, expand: 128 },
    Fire { index: 7, inputs: 256, squeeze: 32, expand: 128 },
    Compare { channels: 256 },
    Pool { kernel: 3, ceil: true },
    Fire { index: 9, inputs: 256, squeeze: 48, expand: 192 },
    Compare { channels: 384 },
    Fire { index: 10, inputs: 384, squeeze: 48, expand: 192 },
    Compare { channels: 384 },
    Fire { index: 11, inputs: 384, squeeze: 64, expand: 256 },
    Compare { channels: 512 },
    Fire { index: 12, inputs: 512, squeeze: 64, expand: 256 },
    Compare { channels: 512 },
];

impl Backbone {
    /// Every backbone, in the order in which results list them.
    pub const ALL: [Backbone; 3] = [Backbone::Alex, Backbone::Vgg, Backbone::Squeeze];

    /// The name in metric and file names.
    pub fn name(self) -> &'static str {
        match self {
            Backbone::Alex => "alex",
            Backbone::Vgg => "vgg",
            Backbone::Squeeze => "squeeze",
        }
    }

    /// Shortest image side, in pixels, for which every compared feature map has a pixel.
    pub fn min_side(self) -> usize {
        match self {
            Backbone::Alex => 31,
            Backbone::Vgg => 16,
            Backbone::Squeeze => 17,
        }
    }

    /// Whether an image of this size reaches [`Backbone::min_side`].
    pub fn fits(self, width: usize, height: usize) -> bool {
        width.min(height) >= self.min_side()
    }

    fn steps(self) -> &'static [Step] {
        match self {
            Backbone::Alex => ALEX,
            Backbone::Vgg => VGG,
            Backbone::Squeeze => SQUEEZE,
        }
    }

    /// Names, less their extension, of files with the network's weights.
    fn feature_stems(self) -> &'static [&'static str] {
        match self {
            Backbone::Alex => &["alexnet-owt-7be5be79"],
            Backbone::Vgg => &["vgg16-397923af"],
            Backbone::Squeeze => &["squeezenet1_1_features", "squeezenet1_1-b8a52dc0"],
        }
    }

    /// The files of the linear layers and of the network, where both are in `dir`.
    fn files(self, dir: &Path) -> Option<(PathBuf, PathBuf)> {
        let linear = find(dir, &format!("{}_lin_v0.1", self.name()))?;
        let features = self.feature_stems().iter().find_map(|stem| find(dir, stem))?;
        Some((linear, features))
    }
}

fn find(dir: &Path, stem: &str) -> Option<PathBuf> {
    ["pth", "safetensors"].iter().map(|extension| dir.join(format!("{stem}.{extension}"))).find(|path| path.is_file())
}

fn check_dir(dir: &Path) -> Result<()> {
    if dir.is_dir() {
        return Ok(());
    }
    Err(Error::Data(format!("the folder of LPIPS weights {} does not exist; name an existing one", dir.display())))
}

/// A network with the linear layers that LPIPS puts on its features.
pub struct Lpips {
    backbone: Backbone,
    layers: Vec<Layer>,
    shift: Tensor,
    scale: Tensor,
    device: Device,
    weights_hash: String,
}

enum Layer {
    Conv(Conv),
    Pool {
        kernel: usize,
        ceil: bool,
    },
    Fire {
        squeeze: Conv,
        expand1: Conv,
        expand3: Conv,
    },
    /// Weights of the squared differences, `[1, channels, 1, 1]`.
    Compare(Tensor),
}

struct Conv {
    weight: Tensor, // [outputs, inputs, kernel, kernel]
    bias: Tensor,   // [1, outputs, 1, 1]
    stride: usize,
    padding: usize,
}

impl Lpips {
    /// The backbones whose two weight files are both in `dir`.
    pub fn available(dir: &Path) -> Result<Vec<Backbone>> {
        check_dir(dir)?;
        Ok(Backbone::ALL.into_iter().filter(|backbone| backbone.files(dir).is_some()).collect())
    }

    /// Loads a backbone from `dir`: the linear layers `<name>_lin_v0.1` and the network's
    /// features (`alexnet-owt-7be5be79`, `vgg16-397923af`, or `squeezenet1_1_features` or
    /// `squeezenet1_1-b8a52dc0`), each `.pth` or `.safetensors`. `None` where one of the two
    /// files is absent; a folder that is missing or a file that is incomplete is an error.
    pub fn load(dir: &Path, backbone: Backbone, device: &Device) -> Result<Option<Lpips>> {
        check_dir(dir)?;
        let Some((linear, features)) = backbone.files(dir) else { return Ok(None) };
        let (linear, features) = (Weights::open(&linear)?, Weights::open(&features)?);
        let loader = Loader { linear, features, device, hash: RefCell::default() };
        let layers = loader.layers(backbone.steps())?;
        let weights_hash = short_hash(loader.hash.into_inner());
        let shift = Tensor::new(&SHIFT, device)?.reshape((1, 3, 1, 1))?;
        let scale = Tensor::new(&SCALE, device)?.reshape((1, 3, 1, 1))?;
        Ok(Some(Lpips { backbone, layers, shift, scale, device: device.clone(), weights_hash }))
    }

    /// A 12-digit hash of all weights, the same for a `.pth` and a `.safetensors` file of the same numbers.
    pub fn weights_hash(&self) -> &str {
        &self.weights_hash
    }

    /// The network this distance is measured on.
    pub fn backbone(&self) -> Backbone {
        self.backbone
    }

    /// The distance of two RGB images in 0..=1 of one shape: squared differences of features of
    /// unit length, weighted per channel, the mean over positions, summed over the compared
    /// layers. 0 for equal images.
    pub fn distance(&self, a: &Image, b: &Image) -> Result<f64> {
        check_same_shape(a, b)?;
        self.check_image(a)?;
        let mut features = [self.input(a)?, self.input(b)?];
        let mut distance = 0.0;
        // Both images go through the network together, so that only one layer's maps are alive.
        for layer in &self.layers {
            let [a, b] = &features;
            match layer {
                Layer::Compare(weights) => distance += compare(a, b, weights)?,
                layer => {
                    let a = layer.forward(a)?;
                    let b = layer.forward(b)?;
                    features = [a, b];
                }
            }
        }
        Ok(distance)
    }

    fn check_image(&self, image: &Image) -> Result<()> {
        let (width, height, name, side) = (image.width, image.height, self.backbone.name(), self.backbone.min_side());
        if image.channels != 3 {
            return Err(Error::Data(format!("LPIPS needs RGB images, found {} channels", image.channels)));
        }
        if !self.backbone.fits(width, height) {
            return Err(Error::Data(format!(
                "LPIPS on {name} needs images of at least {side}x{side} pixels, found {width}x{height}"
            )));
        }
        Ok(())
    }

    fn input(&self, image: &Image) -> Result<Tensor> {
        let pixels = Tensor::from_slice(&image.pixels, (1, image.height, image.width, 3), &self.device)?;
        let signed = pixels.permute((0, 3, 1, 2))?.affine(2.0, -1.0)?; // [1, 3, height, width]
        Ok(signed.broadcast_sub(&self.shift)?.broadcast_div(&self.scale)?.contiguous()?)
    }
}

struct Loader<'a> {
    linear: Weights,
    features: Weights,
    device: &'a Device,
    /// Of the weights so far.
    hash: RefCell<Sha256>,
}

impl Loader<'_> {
    /// A tensor of `from`, which counts in the hash.
    fn get(&self, from: &Weights, names: &[String], shape: &[usize]) -> Result<Tensor> {
        let tensor = from.get(names, shape, self.device)?;
        let mut hash = self.hash.borrow_mut();
        tensor.flatten_all()?.to_vec1::<f32>()?.iter().for_each(|value| hash.update(value.to_le_bytes()));
        Ok(tensor)
    }

    fn layers(&self, steps: &[Step]) -> Result<Vec<Layer>> {
        let mut compared = 0;
        let mut layers = Vec::with_capacity(steps.len());
        for step in steps {
            layers.push(self.layer(*step, compared)?);
            compared += usize::from(matches!(step, Compare { .. }));
        }
        Ok(layers)
    }

    fn layer(&self, step: Step, compared: usize) -> Result<Layer> {
        Ok(match step {
            Step::Conv { index, inputs, outputs, kernel, stride, padding } => {
                let conv = self.conv(&index.to_string(), inputs, outputs, kernel)?;
                Layer::Conv(Conv { stride, padding, ..conv })
            }
            Pool { kernel, ceil } => Layer::Pool { kernel, ceil },
            Fire { index, inputs, squeeze, expand } => Layer::Fire {
                squeeze: self.conv(&format!("{index}.squeeze"), inputs, squeeze, 1)?,
                expand1: self.conv(&format!("{index}.expand1x1"), squeeze, expand, 1)?,
                expand3: self.conv(&format!("{index}.expand3x3"), squeeze, expand, 3)?,
            },
            Compare { channels } => {
                let name = format!("lin{compared}.model.1.weight");
                Layer::Compare(self.get(&self.linear, &[name], &[1, channels, 1, 1])?)
            }
        })
    }

    /// A convolution of stride 1 that keeps the size.
    fn conv(&self, name: &str, inputs: usize, outputs: usize, kernel: usize) -> Result<Conv> {
        let get = |part: &str, shape: &[usize]| {
            let names = [format!("{name}.{part}"), format!("features.{name}.{part}")];
            self.get(&self.features, &names, shape)
        };
        let weight = get("weight", &[outputs, inputs, kernel, kernel])?;
        let bias = get("bias", &[outputs])?.reshape((1, outputs, 1, 1))?;
        Ok(Conv { weight, bias, stride: 1, padding: kernel / 2 })
    }
}

impl Layer {
    fn forward(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        match self {
            Layer::Conv(conv) => conv.forward(x),
            Layer::Pool { kernel, ceil } => max_pool(x, *kernel, *ceil),
            Layer::Fire { squeeze, expand1, expand3 } => {
                let x = squeeze.forward(x)?;
                Tensor::cat(&[expand1.forward(&x)?, expand3.forward(&x)?], 1)
            }
            Layer::Compare(_) => Ok(x.clone()),
        }
    }
}

impl Conv {
    /// Convolution, bias and ReLU, in strips of rows.
    fn forward(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        let (_, inputs, height, width) = x.dims4()?;
        let kernel = self.weight.dim(D::Minus1)?;
        let out = |size: usize| (size + 2 * self.padding - kernel) / self.stride + 1;
        let (out_height, out_width) = (out(height), out(width));
        let rows = (STRIP_VALUES / (inputs * kernel * kernel * out_width)).clamp(1, out_height);
        let strip = |start: usize| self.strip(x, start, rows.min(out_height - start));
        let strips = (0..out_height).step_by(rows).map(strip).collect::<candle_core::Result<Vec<Tensor>>>()?;
        if let [only] = strips.as_slice() { Ok(only.clone()) } else { Tensor::cat(&strips, 2) }
    }

    /// `rows` rows of the output from row `start` on.
    fn strip(&self, x: &Tensor, start: usize, rows: usize) -> candle_core::Result<Tensor> {
        let (height, kernel, pad) = (x.dim(2)?, self.weight.dim(D::Minus1)?, self.padding);
        // Rows of the input with its padding, so that row `pad` is the first one that exists.
        let (first, last) = (start * self.stride, (start + rows - 1) * self.stride + kernel);
        let (top, bottom) = (pad.saturating_sub(first), last.saturating_sub(pad + height));
        let x = x.narrow(2, first + top - pad, last - first - top - bottom)?;
        let x = x.pad_with_zeros(2, top, bottom)?.pad_with_zeros(3, pad, pad)?.contiguous()?;
        x.conv2d(&self.weight, 0, self.stride, 1, 1)?.broadcast_add(&self.bias)?.relu()
    }
}

/// Max-pooling of stride 2 over values that are not negative. With `ceil`, a last window that
/// reaches over the border counts; zeros fill it, which cannot exceed a ReLU's output.
fn max_pool(x: &Tensor, kernel: usize, ceil: bool) -> candle_core::Result<Tensor> {
    let (_, _, height, width) = x.dims4()?;
    let missing = |size: usize| match ceil {
        true => size.saturating_sub(kernel).div_ceil(2) * 2 + kernel - size,
        false => 0,
    };
    let x = x.pad_with_zeros(2, 0, missing(height))?.pad_with_zeros(3, 0, missing(width))?;
    x.contiguous()?.max_pool2d_with_stride(kernel, 2)
}

/// One compared layer's part of the distance: features `[1, channels, height, width]`, weights
/// `[1, channels, 1, 1]`.
fn compare(a: &Tensor, b: &Tensor, weights: &Tensor) -> candle_core::Result<f64> {
    let (_, channels, height, width) = a.dims4()?;
    let rows = (STRIP_VALUES / 4 / (channels * width)).clamp(1, height);
    let mut sum = 0.0;
    for start in (0..height).step_by(rows) {
        let strip = |x: &Tensor| unit(&x.narrow(2, start, rows.min(height - start))?.contiguous()?);
        let squared = strip(a)?.sub(&strip(b)?)?.sqr()?;
        let weighted = squared.broadcast_mul(weights)?.sum(1)?.flatten_all()?.to_vec1::<f32>()?;
        sum += weighted.iter().map(|v| f64::from(*v)).sum::<f64>();
    }
    Ok(sum / (height * width) as f64)
}

fn unit(x: &Tensor) -> candle_core::Result<Tensor> {
    let length = x.sqr()?.sum_keepdim(1)?.sqrt()?;
    x.broadcast_div(&(length + NORM_EPS)?)
}
