//! The adapter, its buffers and its pipelines.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, mpsc};
use std::time::Duration;

use augnerf_base::{Error, Result};
use augnerf_nerf::runtime::{Accelerator, ListedDevice, Work};
use augnerf_nerf::settings::Precision;
use pollster::block_on;
use wgpu::{
    Backends, BindGroupDescriptor, BindGroupEntry, BindingResource, Buffer, BufferBinding, BufferDescriptor,
    BufferUsages, CommandEncoder, CommandEncoderDescriptor, ComputePassDescriptor, ComputePipeline,
    ComputePipelineDescriptor, Device, DeviceDescriptor, DeviceType, ErrorFilter, Features, Instance,
    InstanceDescriptor, Limits, MapMode, PipelineCompilationOptions, PollType, Queue, ShaderModuleDescriptor,
    ShaderRuntimeChecks, ShaderSource,
};

use crate::kernels::{Kernel, Tiles};
use crate::params::{Layouts, Params, layouts};

/// After a wait a device answers at once.
const ANSWERS_WITHIN: Duration = Duration::from_secs(60);
/// Storage buffers that the largest kernel binds.
const STORAGE_BUFFERS: u32 = 9;
/// Bytes that the threads of a group share in the sort of a ray's samples.
const SHARED_BYTES: u32 = 24_576;

/// An open device. A clone is the same device.
#[derive(Clone)]
pub struct Gpu(Arc<Opened>, usize);

struct Opened {
    device: Device,
    queue: Queue,
    adapter: ListedDevice,
    limits: Limits,
    pipelines: Mutex<HashMap<Kernel, Compiled>>,
    work: Mutex<Work>,
    /// How the device was lost, and what first went wrong outside of [`Gpu::checked`].
    failures: Arc<[OnceLock<String>; 2]>,
    /// Tiles of wide layers in f32.
    tiles: Tiles,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.description())
    }
}

fn backends() -> Backends {
    Backends::VULKAN | Backends::METAL | Backends::DX12
}

/// Lists the adapters that wgpu finds, hardware before software.
fn found() -> Vec<wgpu::Adapter> {
    let mut descriptor = InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends();
    let mut adapters = block_on(Instance::new(descriptor).enumerate_adapters(backends()));
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    });
    adapters
}

/// Returns the adapters of this machine, in the order of their numbers.
pub fn list() -> Vec<ListedDevice> {
    found().iter().enumerate().map(|(index, adapter)| listed(index, adapter)).collect()
}

fn listed(index: usize, adapter: &wgpu::Adapter) -> ListedDevice {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    let mut lacks = Vec::new();
    if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
        let found = limits.max_storage_buffers_per_shader_stage;
        lacks.push(format!("{STORAGE_BUFFERS} storage buffers a kernel (it has {found})"));
    }
    if limits.max_compute_invocations_per_workgroup < 256 {
        lacks.push("groups of 256 threads".into());
    }
    if limits.max_compute_workgroup_storage_size < SHARED_BYTES {
        let found = limits.max_compute_workgroup_storage_size;
        lacks.push(format!("{SHARED_BYTES} bytes shared by the threads of a group (it has {found})"));
    }
    let backend = format!("{:?}", info.backend).to_lowercase();
    ListedDevice {
        device: format!("gpu:{index}"),
        name: info.name,
        driver: format!("{backend}, {}", [info.driver, info.driver_info].join(" ").trim()),
        is_software: info.device_type == DeviceType::Cpu,
        largest_buffer: Some(limits.max_storage_buffer_binding_size),
        has_f16: has_matrices(adapter),
        lacks,
    }
}

/// Features of f16 products by matrix units.
const MATRICES: Features = Features::SHADER_F16.union(Features::EXPERIMENTAL_COOPERATIVE_MATRIX);

/// Returns whether subgroups of 32 multiply matrices of 16 x 16 in f16, with sums in f32.
fn has_matrices(adapter: &wgpu::Adapter) -> bool {
    let info = adapter.get_info();
    let is_wanted = |found: &wgpu::CooperativeMatrixProperties| {
        [found.m_size, found.n_size, found.k_size] == [16; 3]
            && found.ab_type == wgpu::CooperativeScalarType::F16
            && found.cr_type == wgpu::CooperativeScalarType::F32
    };
    adapter.features().contains(MATRICES)
        && info.subgroup_min_size == 32
        && info.subgroup_max_size == 32
        && adapter.cooperative_matrix_properties().iter().any(is_wanted)
}

/// The variable that sets the memory of a step, in GiB.
const MEMORY: &str = "AUGNERF_GPU_MEMORY";

/// Returns the bytes that the user lets a step have, by the text of the variable.
fn chosen_memory(text: Option<OsString>) -> Result<Option<usize>> {
    let Some(text) = text.filter(|text| !text.is_empty()) else { return Ok(None) };
    let gib = text.to_str().and_then(|text| text.trim().parse::<f64>().ok()).filter(|gib| *gib > 0.0 && *gib < 1e6);
    let wrong = || {
        Error::Config(format!(
            "device gpu: {MEMORY} = {text:?}: give the GiB of a step, above 0 and below 1e6, such as 4"
        ))
    };
    Ok(Some((gib.ok_or_else(wrong)? * f64::from(1 << 30)) as usize))
}

/// Returns the bytes of a card's own memory, which Vulkan alone tells.
#[cfg(not(target_vendor = "apple"))]
fn memory_of(adapter: &wgpu::Adapter) -> Option<usize> {
    const OF_DEVICE: u32 = 1;
    // SAFETY: neither handle is kept or destroyed.
    let properties = unsafe {
        let vulkan = adapter.as_hal::<wgpu::hal::api::Vulkan>()?;
        vulkan.shared_instance().raw_instance().get_physical_device_memory_properties(vulkan.raw_physical_device())
    };
    let heaps = properties.memory_heaps_as_slice().iter().filter(|heap| heap.flags.as_raw() & OF_DEVICE != 0);
    heaps.map(|heap| heap.size as usize).max()
}

#[cfg(target_vendor = "apple")]
fn memory_of(_adapter: &wgpu::Adapter) -> Option<usize> {
    None
}

/// A kernel's pipeline, and where its parameters are.
type Compiled = (ComputePipeline, Arc<Layouts>);

/// A dispatch that is recorded once and submitted many times.
pub(crate) struct Dispatch {
    #[cfg(test)]
    pub(crate) name: &'static str,
    pipeline: ComputePipeline,
    group: wgpu::BindGroup,
    size: [u32; 3],
    /// What it adds to the device's work.
    pub(crate) work: Work,
}

/// Groups after which a submission ends. With the tiles of integrated cards a group has at most a million multiply-adds, so that a
/// submission takes half a second at a quarter of a TFLOP/s.
const AT_ONCE: u64 = 1 << 16;

/// Groups an axis can have.
pub(crate) const MOST_GROUPS: u32 = 65_535;

/// Returns the groups of 64 threads for so many threads, in two dimensions.
pub(crate) fn groups(threads: usize) -> [u32; 3] {
    rows(threads.div_ceil(64))
}

/// Returns so many groups in two dimensions.
pub(crate) fn rows(groups: usize) -> [u32; 3] {
    let groups = groups as u32;
    [groups.min(MOST_GROUPS), groups.div_ceil(MOST_GROUPS).max(1), 1]
}

impl Gpu {
    /// Opens the adapter of a number.
    ///
    /// # Errors
    /// [`Error::Config`]: there is none, or it lacks what the kernels need.
    pub fn open(index: usize) -> Result<Gpu> {
        let refuse = |found: String| Error::Config(format!("device gpu:{index}: {found}"));
        let all = found();
        let count = all.len();
        let adapter = all.into_iter().nth(index).ok_or_else(|| {
            refuse(match count {
                0 => "no adapter found; install a driver for Vulkan (in containers of NVIDIA cards: the capability \
                      graphics, and libvulkan1), or use --device cpu"
                    .into(),
                _ => format!("this machine has {count} (0 to {}); `augnerf bench --devices` lists them", count - 1),
            })
        })?;
        let (known, info, limits) = (listed(index, &adapter), adapter.get_info(), adapter.limits());
        if !known.lacks.is_empty() {
            return Err(refuse(format!("{} lacks {}; use --device cpu", known.name, known.lacks.join(", "))));
        }
        let required = Limits {
            max_storage_buffer_binding_size: limits.max_storage_buffer_binding_size,
            max_buffer_size: limits.max_buffer_size,
            max_storage_buffers_per_shader_stage: STORAGE_BUFFERS,
            max_compute_workgroup_storage_size: limits.max_compute_workgroup_storage_size,
            ..Limits::default()
        };
        let descriptor = DeviceDescriptor {
            required_limits: required.clone(),
            required_features: if known.has_f16 { MATRICES } else { Features::empty() },
            // SAFETY: kernels with matrix units run only if field.precision = "f16" asks for them.
            experimental_features: match known.has_f16 {
                true => unsafe { wgpu::ExperimentalFeatures::enabled() },
                false => wgpu::ExperimentalFeatures::disabled(),
            },
            ..DeviceDescriptor::default()
        };
        let (device, queue) = block_on(adapter.request_device(&descriptor))
            .map_err(|e| refuse(format!("{} cannot be opened: {e}", known.name)))?;
        let (pipelines, work) = (Mutex::default(), Mutex::default());
        // wgpu's own handlers panic.
        let failures: Arc<[OnceLock<String>; 2]> = Arc::default();
        let (of_loss, of_error) = (failures.clone(), failures.clone());
        device.set_device_lost_callback(move |_, found| drop(of_loss[0].set(format!("was lost: {found}"))));
        device.on_uncaptured_error(Arc::new(move |error| drop(of_error[1].set(failure_of(&error)))));
        // Large tiles need the registers of a card; an H200's step of NeRF takes two thirds of the time with them.
        let (memory, tiles) = match info.device_type {
            DeviceType::DiscreteGpu => (memory_of(&adapter).map_or(6 << 30, |bytes| bytes / 2), Tiles::Large),
            DeviceType::Cpu => (1 << 28, Tiles::Small),
            _ => (1 << 30, Tiles::Small),
        };
        let budget = chosen_memory(std::env::var_os(MEMORY))?.unwrap_or(memory);
        Ok(Gpu(
            Arc::new(Opened { device, queue, adapter: known, limits: required, pipelines, work, failures, tiles }),
            budget,
        ))
    }

    /// Returns its adapter.
    pub fn adapter(&self) -> &ListedDevice {
        &self.0.adapter
    }

    /// Returns the bytes of all of a step's samples that are kept at once.
    pub(crate) fn budget(&self) -> usize {
        self.1
    }

    /// Returns the same device with another budget, for tests.
    #[doc(hidden)]
    pub fn with_budget(&self, bytes: usize) -> Gpu {
        Gpu(self.0.clone(), bytes)
    }

    /// Returns the tiles of wide layers. All tiles of f32 give the same bits.
    pub(crate) fn tiles(&self, precision: Precision) -> Tiles {
        // Tests of this crate run arrays in place of matrix units.
        if precision == Precision::F16 && (self.0.adapter.has_f16 || cfg!(test)) {
            Tiles::Matrices
        } else {
            self.0.tiles
        }
    }

    /// Returns the bytes that the threads of a group can share.
    pub(crate) fn shared_bytes(&self) -> usize {
        self.0.limits.max_compute_workgroup_storage_size as usize
    }

    pub(crate) fn largest_buffer(&self) -> usize {
        self.0.limits.max_storage_buffer_binding_size as usize
    }

    /// Returns an error if the closure's calls failed.
    pub(crate) fn checked<T>(&self, what: &str, work: impl FnOnce() -> T) -> Result<T> {
        let memory = self.0.device.push_error_scope(ErrorFilter::OutOfMemory);
        let validation = self.0.device.push_error_scope(ErrorFilter::Validation);
        let internal = self.0.device.push_error_scope(ErrorFilter::Internal);
        let value = work();
        let refused = |found: String| Error::Config(format!("device gpu ({}): {what}: {found}", self.0.adapter.name));
        let [internal, validation, memory] = [internal, validation, memory].map(|scope| block_on(scope.pop()));
        // Work on a buffer that could not be made is wrong as well.
        if memory.is_some() {
            return Err(refused(format!("out of memory; {SMALLER}")));
        }
        match internal.or(validation) {
            Some(error) => {
                // On a lost device everything is wrong.
                self.wait()?;
                Err(refused(error.to_string()))
            }
            None => self.still_works().map(|()| value),
        }
    }

    pub(crate) fn buffer(&self, bytes: usize) -> Buffer {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let size = bytes.max(16).next_multiple_of(16) as u64;
        self.0.device.create_buffer(&BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
    }

    /// Returns a buffer of so many numbers of 32 bits.
    pub(crate) fn numbers(&self, count: usize) -> Buffer {
        self.buffer(4 * count)
    }

    pub(crate) fn storage(&self, values: &[f32]) -> Buffer {
        let buffer = self.numbers(values.len());
        self.write(&buffer, bytemuck::cast_slice(values));
        buffer
    }

    pub(crate) fn uniform(&self, words: &[u32]) -> Buffer {
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let size = (4 * words.len()).next_multiple_of(16) as u64;
        let buffer =
            self.0.device.create_buffer(&BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
        self.write(&buffer, bytemuck::cast_slice(words));
        buffer
    }

    pub(crate) fn write(&self, buffer: &Buffer, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.0.queue.write_buffer(buffer, 0, bytes);
        }
    }

    /// Fills a buffer with zeros.
    pub(crate) fn clear(&self, buffer: &Buffer) {
        let mut encoder = self.encoder();
        encoder.clear_buffer(buffer, 0, None);
        self.0.queue.submit([encoder.finish()]);
    }

    /// Returns a kernel's pipeline, and where its parameters are.
    fn compiled(&self, kernel: &Kernel) -> Compiled {
        let mut known = self.0.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(compiled) = known.get(kernel) {
            return compiled.clone();
        }
        let text = kernel.text();
        let layouts = Arc::new(layouts(&text));
        let source = ShaderModuleDescriptor { label: Some(kernel.name), source: ShaderSource::Wgsl(text.into()) };
        // lavapipe compiles some kernels without bounds checks for minutes.
        let module = if self.0.adapter.is_software {
            self.0.device.create_shader_module(source)
        } else {
            let checks = ShaderRuntimeChecks { force_loop_bounding: true, ..ShaderRuntimeChecks::unchecked() };
            // SAFETY: the kernels check their bounds themselves, and tests run them with checks.
            unsafe { self.0.device.create_shader_module_trusted(source, checks) }
        };
        let pipeline = self.0.device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some(kernel.name),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..PipelineCompilationOptions::default()
            },
            cache: None,
        });
        let compiled = (pipeline, layouts);
        known.insert(kernel.clone(), compiled.clone());
        compiled
    }

    /// Returns the words of a kernel's parameters at a binding.
    pub(crate) fn words(&self, kernel: &Kernel, binding: u32, params: &Params) -> Vec<u32> {
        let (_, layouts) = self.compiled(kernel);
        layouts[&binding].words(kernel.name, params)
    }

    /// Records a dispatch of so many groups with its parameters at binding 0, and these buffers at theirs.
    pub(crate) fn dispatch(
        &self,
        kernel: &Kernel,
        params: &Params,
        buffers: &[(u32, &Buffer)],
        size: [u32; 3],
    ) -> Dispatch {
        let parts: Vec<_> =
            buffers.iter().map(|(binding, buffer)| (*binding, buffer.as_entire_buffer_binding())).collect();
        self.dispatch_parts(kernel, params, &parts, size)
    }

    /// The same with parts of buffers.
    pub(crate) fn dispatch_parts(
        &self,
        kernel: &Kernel,
        params: &Params,
        buffers: &[(u32, BufferBinding)],
        size: [u32; 3],
    ) -> Dispatch {
        #[cfg(test)]
        let kernel = &kernel.clone().emulated(!self.0.adapter.has_f16);
        let (pipeline, layouts) = self.compiled(kernel);
        let uniform = self.uniform(&layouts[&0].words(kernel.name, params));
        let parameters = std::iter::once((0, uniform.as_entire_buffer_binding()));
        let bound = parameters.chain(buffers.iter().cloned());
        let entries: Vec<BindGroupEntry> =
            bound.map(|(binding, part)| BindGroupEntry { binding, resource: BindingResource::Buffer(part) }).collect();
        let layout = pipeline.get_bind_group_layout(0);
        let descriptor = BindGroupDescriptor { label: Some(kernel.name), layout: &layout, entries: &entries };
        let group = self.0.device.create_bind_group(&descriptor);
        Dispatch {
            #[cfg(test)]
            name: kernel.name,
            pipeline,
            group,
            size,
            work: Work { dispatches: 1, ..Work::default() },
        }
    }

    fn encoder(&self) -> CommandEncoder {
        self.0.device.create_command_encoder(&CommandEncoderDescriptor::default())
    }

    /// Submits dispatches in their order, in several submissions if they are many: drivers end one that takes seconds.
    pub(crate) fn submit<'a>(&self, work: impl IntoIterator<Item = &'a Dispatch>) {
        let (mut dispatches, mut done) = (work.into_iter().peekable(), Work::default());
        while dispatches.peek().is_some() {
            let mut encoder = self.encoder();
            {
                let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
                let mut groups = 0;
                while groups < AT_ONCE
                    && let Some(Dispatch { pipeline, group, size: [x, y, z], work, .. }) = dispatches.next()
                {
                    done.add(*work);
                    pass.set_pipeline(pipeline);
                    pass.set_bind_group(0, group, &[]);
                    pass.dispatch_workgroups(*x, *y, *z);
                    groups += u64::from(*x) * u64::from(*y) * u64::from(*z);
                }
            }
            self.0.queue.submit([encoder.finish()]);
        }
        self.counted().add(done);
    }

    /// Returns what was submitted so far.
    pub(crate) fn counted(&self) -> MutexGuard<'_, Work> {
        self.0.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Copies complete buffers, one after another, into another one, after the work that was submitted.
    pub(crate) fn copy(&self, from: &[&Buffer], to: &Buffer) {
        let mut encoder = self.encoder();
        copy(&mut encoder, from, to);
        self.0.queue.submit([encoder.finish()]);
    }

    /// Waits until all submitted work is done.
    pub(crate) fn wait(&self) -> Result<()> {
        let waited = self.0.device.poll(PollType::wait_indefinitely());
        // The first failure says more than that nothing can be waited for.
        self.still_works()?;
        waited.map(drop).map_err(|e| self.failed(&format!("was lost: {e}")))
    }

    /// Returns an error if something went wrong since the device was opened.
    fn still_works(&self) -> Result<()> {
        // On a lost device everything goes wrong.
        let failure = self.0.failures.iter().find_map(OnceLock::get);
        failure.map_or(Ok(()), |failure| Err(self.failed(failure)))
    }

    fn failed(&self, how: &str) -> Error {
        let name = &self.0.adapter.name;
        let failed = format!("device gpu ({name}) {how}; `augnerf resume` continues from the last checkpoint");
        candle_core::Error::Msg(failed).into()
    }

    /// Takes the device away, for tests.
    #[doc(hidden)]
    pub fn destroy(&self) {
        self.0.device.destroy();
    }

    /// Reads buffers in one transfer.
    pub(crate) fn read(&self, buffers: &[&Buffer]) -> Result<Vec<Vec<u8>>> {
        let total: u64 = buffers.iter().map(|buffer| buffer.size()).sum();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let staging = self.0.device.create_buffer(&BufferDescriptor {
            label: None,
            size: total,
            usage,
            mapped_at_creation: false,
        });
        let mut encoder = self.encoder();
        copy(&mut encoder, buffers, &staging);
        self.0.queue.submit([encoder.finish()]);
        // Another thread's wait may call back for this one.
        let (told, outcome) = mpsc::channel();
        staging.slice(..).map_async(MapMode::Read, move |result| drop(told.send(result)));
        self.wait()?;
        match outcome.recv_timeout(ANSWERS_WITHIN) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(self.failed(&format!("was lost: {error}"))),
            Err(_) => return Err(self.failed("does not answer")),
        }
        let view = staging.slice(..).get_mapped_range().map_err(|e| self.failed(&format!("was lost: {e}")))?;
        let mut parts = Vec::with_capacity(buffers.len());
        let mut at = 0;
        for buffer in buffers {
            let size = buffer.size() as usize;
            parts.push(view[at..at + size].to_vec());
            at += size;
        }
        Ok(parts)
    }

    /// Reads the first numbers of a buffer.
    pub(crate) fn read_f32(&self, buffer: &Buffer, count: usize) -> Result<Vec<f32>> {
        let bytes = self.read(&[buffer])?.remove(0);
        Ok(bytemuck::pod_collect_to_vec(&bytes[..4 * count]))
    }
}

/// What helps where memory is short.
const SMALLER: &str = "let a step have less memory, as with AUGNERF_GPU_MEMORY=2 (GiB), or lower train.rays, field.width, \
     field.hash.log2_table or regularizer.lattice";

/// Returns the failure that an error outside of [`Gpu::checked`] is.
fn failure_of(error: &wgpu::Error) -> String {
    match error {
        wgpu::Error::OutOfMemory { .. } => format!("is out of memory; {SMALLER}"),
        error => format!("failed: {error}"),
    }
}

fn copy(encoder: &mut CommandEncoder, from: &[&Buffer], to: &Buffer) {
    let mut at = 0;
    for buffer in from {
        encoder.copy_buffer_to_buffer(buffer, 0, to, at, buffer.size());
        at += buffer.size();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_a_number_of_gib() {
        let of = |text: &str| chosen_memory(Some(text.into()));
        assert_eq!((of("0.5").unwrap(), of(" 4 ").unwrap(), of("").unwrap()), (Some(1 << 29), Some(4 << 30), None));
        for wrong in ["0", "-1", "abc", "NaN", "4GB"] {
            let error = of(wrong).unwrap_err().to_string();
            assert!(error.contains("AUGNERF_GPU_MEMORY = ") && error.contains(wrong), "{error}");
        }
    }
}
