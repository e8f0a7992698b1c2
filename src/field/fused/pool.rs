//! Buffers that a thread uses again: fresh memory would be cleared, and paid for page by page.

use std::cell::RefCell;
use std::ops::{Deref, DerefMut};
use std::thread::LocalKey;

/// Buffers that wait on one thread, at most.
const MOST: usize = 64;

thread_local! {
    static FLOATS: RefCell<Vec<Vec<f32>>> = const { RefCell::new(Vec::new()) };
    static BYTES: RefCell<Vec<Vec<u8>>> = const { RefCell::new(Vec::new()) };
}

/// Numbers that buffers are made of.
pub trait Pooled: Copy + Default + 'static {
    fn pool() -> &'static LocalKey<RefCell<Vec<Vec<Self>>>>;
}

impl Pooled for f32 {
    fn pool() -> &'static LocalKey<RefCell<Vec<Vec<f32>>>> {
        &FLOATS
    }
}

impl Pooled for u8 {
    fn pool() -> &'static LocalKey<RefCell<Vec<Vec<u8>>>> {
        &BYTES
    }
}

/// Gives back what waits on this thread: the next run may need less.
pub fn forget() {
    FLOATS.take();
    BYTES.take();
}

/// A buffer whose first content is anything.
#[derive(Default)]
pub struct Buffer<T: Pooled>(Vec<T>);

impl<T: Pooled> Buffer<T> {
    pub fn new(len: usize) -> Buffer<T> {
        if len == 0 {
            return Buffer(Vec::new());
        }
        let mut values = T::pool().with_borrow_mut(|waiting| {
            let fits = waiting.iter().position(|values| values.capacity() >= len);
            fits.map(|index| waiting.swap_remove(index)).unwrap_or_default()
        });
        values.resize(len, T::default());
        Buffer(values)
    }
}

impl<T: Pooled> Drop for Buffer<T> {
    fn drop(&mut self) {
        if self.0.capacity() == 0 {
            return;
        }
        let values = std::mem::take(&mut self.0);
        // A thread that ends may have no pool any more.
        let _ = T::pool().try_with(|waiting| {
            let mut waiting = waiting.borrow_mut();
            if waiting.len() < MOST {
                waiting.push(values);
            }
        });
    }
}

impl<T: Pooled> Deref for Buffer<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T: Pooled> DerefMut for Buffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}
