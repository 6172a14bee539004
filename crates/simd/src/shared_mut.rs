use std::marker::PhantomData;

/// A slice that several threads write at once, each its own elements.
#[derive(Clone, Copy)]
pub struct SharedMut<'a> {
    start: *mut f32,
    len: usize,
    slice: PhantomData<&'a mut [f32]>,
}

// SAFETY: only pointers are handed out, and using one is the caller's promise that no other thread uses its elements.
unsafe impl Send for SharedMut<'_> {}
// SAFETY: as above.
unsafe impl Sync for SharedMut<'_> {}

impl<'a> SharedMut<'a> {
    pub fn new(slice: &'a mut [f32]) -> Self {
        Self { start: slice.as_mut_ptr(), len: slice.len(), slice: PhantomData }
    }

    /// A vector whose memory nobody touches before `fill` does.
    ///
    /// # Safety
    /// `fill` writes each of the `len` elements, and reads none before.
    pub unsafe fn fill_new(len: usize, fill: impl FnOnce(SharedMut)) -> Vec<f32> {
        let mut out = Vec::with_capacity(len);
        fill(SharedMut { start: out.as_mut_ptr(), len, slice: PhantomData });
        // SAFETY: the capacity, and the caller's promise.
        unsafe { out.set_len(len) }
        out
    }

    /// The address of element `index`, which must be inside.
    ///
    /// # Safety
    /// What is written through it belongs to the calling thread alone while others write.
    pub unsafe fn at(&self, index: usize) -> *mut f32 {
        assert!(index < self.len, "element {index} of {}", self.len);
        // SAFETY: inside the slice.
        unsafe { self.start.add(index) }
    }
}
