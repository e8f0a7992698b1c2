//! Buffers that a thread reuses. New memory would be cleared, and cost page faults.

use std::cell::RefCell;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

/// Largest number of waiting buffers per thread.
const MOST: usize = 64;

/// A cache line, so that no vector crosses two.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Line {
    _bytes: [u8; 64],
}

impl Line {
    const ZERO: Line = Line { _bytes: [0; 64] };
}

thread_local! {
    static WAITING: RefCell<Vec<Vec<Line>>> = const { RefCell::new(Vec::new()) };
}

/// Numbers for buffers.
///
/// # Safety
/// Every bit pattern must be valid, and 64 bytes must hold a whole number of them.
pub unsafe trait Pooled: Copy {}

// SAFETY: as the trait says.
unsafe impl Pooled for f32 {}
// SAFETY: as the trait says.
unsafe impl Pooled for u16 {}

/// Frees the waiting buffers of this thread, because the next run may need less.
pub fn forget() {
    WAITING.take();
}

/// A buffer with arbitrary initial content.
pub struct Buffer<T: Pooled> {
    lines: Vec<Line>,
    len: usize,
    numbers: PhantomData<T>,
}

impl<T: Pooled> Buffer<T> {
    pub fn new(len: usize) -> Buffer<T> {
        if len == 0 {
            return Buffer::default();
        }
        let bytes = len.checked_mul(size_of::<T>()).expect("a buffer fits into memory");
        let count = bytes.div_ceil(size_of::<Line>());
        let mut lines = WAITING.with_borrow_mut(|waiting| {
            let fits = waiting.iter().position(|lines| lines.len() >= count);
            fits.map(|index| waiting.swap_remove(index)).unwrap_or_default()
        });
        if lines.len() < count {
            lines.resize(count, Line::ZERO);
        }
        Buffer { lines, len, numbers: PhantomData }
    }
}

impl<T: Pooled> Default for Buffer<T> {
    fn default() -> Buffer<T> {
        Buffer { lines: Vec::new(), len: 0, numbers: PhantomData }
    }
}

impl<T: Pooled> Drop for Buffer<T> {
    fn drop(&mut self) {
        if self.lines.capacity() == 0 {
            return;
        }
        let lines = std::mem::take(&mut self.lines);
        // A thread that ends may have no pool any more.
        let _ = WAITING.try_with(|waiting| {
            let mut waiting = waiting.borrow_mut();
            if waiting.len() < MOST {
                waiting.push(lines);
            }
        });
    }
}

impl<T: Pooled> Deref for Buffer<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        // SAFETY: the lines hold `len` numbers, aligned, and any bits are one.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl<T: Pooled> DerefMut for Buffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above; they are borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}
