//! The plain path on devices: the graph of some rays at a time, made again in the backward pass.

use std::ops::Range;

use candle_core::{CpuStorage, CudaStorage, CustomOp2, Layout, MetalStorage, Result, Shape, Storage, Tensor, Var};

use super::March;

/// The result of a march as a function of template and warp.
pub(super) struct InParts {
    march: March,
    parts: Vec<Range<usize>>,
    has_warp: bool,
    /// `[rays, 5]`, without a graph.
    out: Tensor,
}

impl March {
    /// The same as [`March::plain`], with `rays` rays at once.
    pub(super) fn in_parts(&self, template: &Tensor, warp: Option<&Tensor>, rays: usize) -> Result<Tensor> {
        let starts = (0..self.lines.len()).step_by(rays);
        let parts: Vec<_> = starts.map(|start| start..self.lines.len().min(start + rays)).collect();
        let (still, still_warp) = (template.detach(), warp.map(Tensor::detach));
        let part = |rays: &Range<usize>| self.plain(&still, still_warp.as_ref(), rays.clone());
        let out = Tensor::cat(&parts.iter().map(part).collect::<Result<Vec<_>>>()?, 0)?;
        let nothing = Tensor::zeros(1, template.dtype(), template.device())?;
        let operation = InParts { march: self.clone(), parts, has_warp: warp.is_some(), out };
        template.apply_op2(warp.unwrap_or(&nothing), operation)
    }
}

/// Adds to a sum that may be empty.
fn add(sum: &mut Option<Tensor>, more: Option<&Tensor>) -> Result<()> {
    if let Some(more) = more {
        *sum = Some(match sum.take() {
            Some(sum) => (sum + more)?,
            None => more.clone(),
        });
    }
    Ok(())
}

impl InParts {
    fn values(&self) -> Result<(Storage, Shape)> {
        let (storage, layout) = self.out.storage_and_layout();
        Ok((storage.try_clone(layout)?, self.out.shape().clone()))
    }
}

impl CustomOp2 for InParts {
    fn name(&self) -> &'static str {
        "march-in-parts"
    }

    fn cpu_fwd(&self, _: &CpuStorage, _: &Layout, _: &CpuStorage, _: &Layout) -> Result<(CpuStorage, Shape)> {
        match self.values()? {
            (Storage::Cpu(storage), shape) => Ok((storage, shape)),
            _ => candle_core::bail!("march: what was marched through is on another device"),
        }
    }

    fn cuda_fwd(&self, _: &CudaStorage, _: &Layout, _: &CudaStorage, _: &Layout) -> Result<(CudaStorage, Shape)> {
        match self.values()? {
            (Storage::Cuda(storage), shape) => Ok((storage, shape)),
            _ => candle_core::bail!("march: what was marched through is on another device"),
        }
    }

    fn metal_fwd(&self, _: &MetalStorage, _: &Layout, _: &MetalStorage, _: &Layout) -> Result<(MetalStorage, Shape)> {
        match self.values()? {
            (Storage::Metal(storage), shape) => Ok((storage, shape)),
            _ => candle_core::bail!("march: what was marched through is on another device"),
        }
    }

    fn bwd(
        &self,
        template: &Tensor,
        warp: &Tensor,
        _out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (template, warp) = (Var::from_tensor(&template.detach())?, Var::from_tensor(&warp.detach())?);
        let (mut of_template, mut of_warp) = (None, None);
        for rays in &self.parts {
            let out = self.march.plain(&template, self.has_warp.then_some(warp.as_tensor()), rays.clone())?;
            let cotangent = gradient.narrow(0, rays.start, rays.len())?;
            let gradients = (out * cotangent)?.sum_all()?.backward()?;
            add(&mut of_template, gradients.get(&template))?;
            add(&mut of_warp, gradients.get(&warp))?;
        }
        Ok((of_template, of_warp))
    }
}
