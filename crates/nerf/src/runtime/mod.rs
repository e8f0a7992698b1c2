//! The machine of a run: device, threads, memory, host, clocks.

use std::sync::Arc;

use candle_core::Device;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::base::{Error, Result};

mod accelerator;

pub use crate::base::machine::*;
pub use accelerator::{Accelerator, ListedDevice, Work};

/// The kind of an accelerator's name.
const GPU: &str = "gpu";

/// Size of a thread's stack: the usual size of a main thread.
const STACK_BYTES: usize = 8 << 20;

/// A device, and threads of its own that share the work. The device is candle's, or an [`Accelerator`] beside candle's
/// CPU.
///
/// Several runtimes may work in one process at the same time. Neither another runtime nor the number of threads changes
/// any numbers. A clone is the same runtime.
///
/// # What is set for the whole process
///
/// The first runtime of a process also sets what exists once per process. Later ones find it set.
///
/// - Freed memory stays with the process (glibc's `mallopt`). A training step would take twice as long without it.
/// - candle works on the calling thread only: `RAYON_NUM_THREADS` and `CANDLE_NUM_THREADS` become 1. candle 0.11 offers
///   no other way. Rayon's global pool is started first, with the threads that it would have had. [`with_own_variables`]
///   gives child processes the variables as they were.
/// - With `cuda-tf32`, matrix products of all CUDA devices are rounded. A process cannot have both `cuda` and
///   `cuda-tf32`.
///
/// The environment is written. Make the first runtime at the start of `main`, before C code on other threads reads it.
#[derive(Clone, Debug)]
pub struct Runtime {
    device: Device,
    accelerator: Option<Arc<dyn Accelerator>>,
    name: String,
    pool: Arc<ThreadPool>,
    counter: Arc<Counter>,
    /// No other job shares its threads.
    alone: bool,
}

impl Runtime {
    /// Opens `device` (`cpu`, `cuda`, `cuda:N`, `cuda-tf32` or `metal`) with this many threads. `None` is one thread
    /// per CPU of the process. A `gpu` is opened by `augnerf_run::open_runtime`.
    ///
    /// # Errors
    /// [`Error::Config`] if the device is unknown, absent or not built in, if the system denies the threads, or if the
    /// process rounds matrix products differently.
    ///
    /// ```
    /// # mod augnerf { pub use augnerf_base as base; pub use augnerf_nerf::*; }
    /// use augnerf::runtime::Runtime;
    ///
    /// let runtime = Runtime::new("cpu", Some(2))?;
    /// assert_eq!(runtime.threads(), 2);
    /// assert!(Runtime::new("abacus", None).is_err() && Runtime::new("cpu", Some(0)).is_err());
    /// # Ok::<(), augnerf::base::Error>(())
    /// ```
    pub fn new(device: &str, threads: Option<usize>) -> Result<Runtime> {
        let threads = prepared(threads)?;
        Runtime::with_threads(open(device)?, device.to_string(), threads)
    }

    /// Returns a runtime of an open accelerator with its `name`, `gpu` or `gpu:N`. Work that the accelerator does not do
    /// runs on the CPU with this many threads. `None` is one thread per CPU of the process.
    ///
    /// # Errors
    /// [`Error::Config`] if the name is no accelerator's, or if the system denies the threads.
    pub fn with_accelerator(
        accelerator: Arc<dyn Accelerator>,
        name: String,
        threads: Option<usize>,
    ) -> Result<Runtime> {
        if Runtime::accelerator_index(&name)?.is_none() {
            return Err(refused(&name, "an accelerator is named gpu or gpu:N"));
        }
        let own = Runtime::with_threads(Device::Cpu, name, prepared(threads)?)?;
        Ok(Runtime { accelerator: Some(accelerator), ..own })
    }

    /// Returns the number of the accelerator that a name stands for: 1 for `gpu:1`. `None` for a device of candle. Opens
    /// neither: another machine may use the name.
    ///
    /// # Errors
    /// [`Error::Config`] for a name that is no device's.
    pub fn accelerator_index(device: &str) -> Result<Option<usize>> {
        let (kind, index) = kind_and_index(device)?;
        Ok((kind == GPU).then_some(index))
    }

    fn with_threads(device: Device, name: String, threads: usize) -> Result<Runtime> {
        let counter = Arc::new(Counter::default());
        let own = counter.clone();
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .stack_size(STACK_BYTES)
            .start_handler(move |_| own.clone().adopt_thread())
            .build()
            .map_err(|e| Error::Config(format!("threads {threads}: cannot start the threads: {e}")))?;
        Ok(Runtime { device, accelerator: None, name, pool: Arc::new(pool), counter, alone: true })
    }

    /// Returns a runtime on the same device for one of `jobs` that share this one's threads. Each has at least one
    /// thread.
    ///
    /// # Errors
    /// [`Error::Config`] if the system denies the threads.
    pub fn share(&self, jobs: usize) -> Result<Runtime> {
        let own = Runtime::with_threads(self.device.clone(), self.name.clone(), (self.threads() / jobs).max(1))?;
        Ok(Runtime { alone: jobs == 1, accelerator: self.accelerator.clone(), ..own })
    }

    /// Returns a runtime on the processor, on the same threads.
    pub fn on_cpu(&self) -> Runtime {
        match self.is_cpu() {
            true => self.clone(),
            false => Runtime { device: Device::Cpu, accelerator: None, name: "cpu".into(), ..self.clone() },
        }
    }

    /// Returns whether no other job shares these threads, so that the process's memory is this job's.
    pub fn is_alone(&self) -> bool {
        self.alone
    }

    /// Does `work` on the runtime's threads, and waits for it. If called on one of them, it works there.
    pub fn install<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.pool.install(work)
    }

    /// Does `work` once on each of the runtime's threads, and waits for all.
    pub fn on_every_thread(&self, work: impl Fn() + Sync) {
        self.pool.broadcast(|_| work());
    }

    /// Returns the device of tensors: the CPU beside an accelerator.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the accelerator, or `None` if a device of candle computes.
    pub fn accelerator(&self) -> Option<&Arc<dyn Accelerator>> {
        self.accelerator.as_ref()
    }

    /// Returns whether the CPU alone computes.
    pub fn is_cpu(&self) -> bool {
        self.device.is_cpu() && self.accelerator.is_none()
    }

    /// Waits until the work of its device is done.
    ///
    /// # Errors
    /// Those of the device.
    pub fn synchronize(&self) -> Result<()> {
        match &self.accelerator {
            Some(accelerator) => accelerator.synchronize(),
            None => Ok(self.device.synchronize()?),
        }
    }

    /// Does `work` on parts of so many `items`, as [`over_parts`] does. On an accelerator the parts come in turn.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn over_parts<T: Sync, R: Send>(
        &self,
        items: &[T],
        size: usize,
        work: impl Fn(&[T]) -> Result<R> + Sync + Send,
    ) -> Result<Vec<R>> {
        in_parts(self.is_cpu(), items, size, work)
    }

    /// Returns the name under which the device was opened.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the device's kind: `cpu`, `gpu`, `cuda`, `cuda-tf32` or `metal`.
    pub fn kind(&self) -> &str {
        self.name.split_once(':').map_or(self.name(), |(kind, _)| kind)
    }

    /// Returns the CPU's instruction set for which kernels are chosen. `None` if another device computes.
    pub fn instructions(&self) -> Option<&'static str> {
        self.is_cpu().then(instructions)
    }

    /// Returns the number of threads that share the work.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Returns the work of the accelerator so far, or the multiply-adds of the fused core on these threads.
    pub fn work(&self) -> Work {
        let of_threads = Work { multiply_adds: self.counter.read(), ..Work::default() };
        self.accelerator.as_ref().map_or(of_threads, |accelerator| accelerator.work())
    }
}

/// Prepares the process, and returns the number of threads.
fn prepared(threads: Option<usize>) -> Result<usize> {
    if threads == Some(0) {
        return Err(Error::Config("threads = 0 is out of range: it must be at least 1".into()));
    }
    prepare()?;
    Ok(threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)))
}

fn open(name: &str) -> Result<Device> {
    let refuse = |found: String| refused(name, &found);
    let (kind, index) = kind_and_index(name)?;
    match kind {
        "cpu" => Ok(Device::Cpu),
        GPU => Err(refuse("it needs the feature gpu, and `augnerf_run::open_runtime`, which opens it".into())),
        "cuda" | "cuda-tf32" if cfg!(feature = "cuda") => {
            round_products(kind == "cuda-tf32", name)?;
            Device::new_cuda(index).map_err(|e| refuse(e.to_string()))
        }
        "metal" if cfg!(feature = "metal") => Device::new_metal(index).map_err(|e| refuse(e.to_string())),
        "cuda" | "cuda-tf32" | "metal" => {
            let feature = kind.trim_end_matches("-tf32");
            Err(refuse(format!("this program was built without {feature}; build it with --features {feature}")))
        }
        _ => unreachable!("a kind of device"),
    }
}

/// Returns kind and number of a device's name, whether this program was built with it or not.
fn kind_and_index(name: &str) -> Result<(&str, usize)> {
    let (kind, index) = name.split_once(':').unwrap_or((name, "0"));
    if !["cpu", GPU, "cuda", "cuda-tf32", "metal"].contains(&kind) || (kind == "cpu" && name != kind) {
        return Err(refused(name, "choose cpu, gpu, gpu:N, cuda, cuda:N, cuda-tf32 or metal"));
    }
    let index = index.parse().map_err(|_| refused(name, &format!("'{index}' is not a device number")))?;
    Ok((kind, index))
}

fn refused(name: &str, found: &str) -> Error {
    Error::Config(format!("device {name}: {found}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_counted_by_the_runtime_that_does_it() {
        let [one, other] = [1, 3].map(|threads| Runtime::new("cpu", Some(threads)).unwrap());
        one.install(|| count_multiply_adds(5));
        other.install(|| count_multiply_adds(3));
        count_multiply_adds(100);
        assert_eq!((one.work().multiply_adds, other.work().multiply_adds), (5, 3));
    }

    #[derive(Debug)]
    struct Card;

    impl Accelerator for Card {
        fn description(&self) -> String {
            "a card, driver 1".into()
        }

        fn synchronize(&self) -> Result<()> {
            Err(Error::Config("the card is lost".into()))
        }
    }

    #[test]
    fn an_accelerator_stands_beside_the_cpu() {
        let open = |name: &str| Runtime::with_accelerator(Arc::new(Card), name.into(), Some(2));
        for name in ["gpu", "gpu:3"] {
            let runtime = open(name).unwrap();
            assert_eq!((runtime.name(), runtime.kind(), runtime.threads()), (name, "gpu", 2));
            assert!(runtime.device().is_cpu() && !runtime.is_cpu() && runtime.instructions().is_none());
            let shared = runtime.share(2).unwrap();
            let card = shared.accelerator().unwrap();
            assert_eq!(card.description(), "a card, driver 1");
            assert_eq!(shared.synchronize().unwrap_err().to_string(), "the card is lost");
            // In turn: a part sees those before it.
            let seen = std::sync::Mutex::new(Vec::new());
            let parts = runtime.over_parts(&[1, 2, 3], 1, |part| {
                seen.lock().unwrap().extend_from_slice(part);
                Ok(seen.lock().unwrap().len())
            });
            assert_eq!(parts.unwrap(), [1, 2, 3]);
        }
        for name in ["cpu", "cuda:1", "gpu:x", "gpus"] {
            let error = open(name).unwrap_err().to_string();
            assert!(error.starts_with(&format!("device {name}: ")), "{error}");
        }
        let cpu = Runtime::new("cpu", Some(1)).unwrap();
        assert!(cpu.accelerator().is_none() && cpu.is_cpu() && cpu.synchronize().is_ok());
    }

    #[test]
    fn a_gpu_is_a_device_that_is_opened_elsewhere() {
        let indices = ["gpu", "gpu:12", "cpu", "cuda:1"].map(|name| Runtime::accelerator_index(name).unwrap());
        assert_eq!(indices, [Some(0), Some(12), None, None]);
        for name in ["gpu:", "gpu:-1", "gpu:x", "GPU"] {
            assert!(Runtime::accelerator_index(name).is_err(), "{name}");
        }
        let error = Runtime::new("gpu:1", None).unwrap_err().to_string();
        assert_eq!(error, "device gpu:1: it needs the feature gpu, and `augnerf_run::open_runtime`, which opens it");
    }

    #[test]
    fn a_share_has_a_thread_at_least() {
        let runtime = Runtime::new("cpu", Some(3)).unwrap();
        assert_eq!([1, 2, 3, 4].map(|jobs| runtime.share(jobs).unwrap().threads()), [3, 1, 1, 1]);
    }
}
