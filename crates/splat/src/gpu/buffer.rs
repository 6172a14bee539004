//! Arrays in the memory of a device.

use std::marker::PhantomData;

use bytemuck::{NoUninit, Pod};
use cubecl::client::Client;
use cubecl::prelude::BufferArg;
use cubecl::server::{Handle, ServerError};

/// An array of `len` numbers of type `T`.
pub(super) struct Buffer<T> {
    handle: Handle,
    pub len: usize,
    element: PhantomData<T>,
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self { handle: self.handle.clone(), len: self.len, element: PhantomData }
    }
}

impl<T: Pod> Buffer<T> {
    /// Uninitialised, of at least one number: devices have no empty buffers.
    pub(super) fn empty(client: &Client, len: usize) -> Self {
        let len = len.max(1);
        Self { handle: client.empty(len * size_of::<T>()), len, element: PhantomData }
    }

    /// A copy of `numbers`; a zero if there are none.
    pub(super) fn of(client: &Client, numbers: &[impl NoUninit]) -> Self {
        let bytes: &[u8] = bytemuck::cast_slice(numbers);
        let len = bytes.len() / size_of::<T>();
        if len == 0 {
            return Self::of(client, &[T::zeroed()]);
        }
        Self { handle: client.create_from_slice(bytes), len, element: PhantomData }
    }

    /// For a kernel, whose parameter must be a slice of `T`.
    pub(super) fn arg(&self) -> BufferArg {
        // SAFETY: both constructors allocate `len` numbers.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }

    /// Waits for the device.
    pub(super) fn read<const N: usize>(
        client: &Client,
        buffers: [&Self; N],
    ) -> Result<[Vec<T>; N], ServerError> {
        let mut read = client.read(buffers.map(|buffer| buffer.handle.clone()).to_vec())?.into_iter();
        Ok(buffers.map(|buffer| {
            let bytes = read.next().unwrap_or_else(|| unreachable!("one answer per buffer"));
            bytemuck::pod_collect_to_vec(&bytes[..buffer.len * size_of::<T>()])
        }))
    }
}
