//! For tests: values that a reference computed (`tools/parity`), and the rule by which both sides make up inputs.
//!
//! Everything here panics, with the name of the file or tensor, where a test would fail.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use safetensors::SafeTensors;

/// The tensors of a safetensors file, as `f32`.
pub struct Golden(BTreeMap<String, Stored>);

struct Stored {
    shape: Vec<usize>,
    values: Vec<f32>,
}

impl Golden {
    /// Reads a file; a relative path starts at the manifest of the crate that is tested.
    pub fn read(path: impl AsRef<Path>) -> Self {
        let path = path.as_ref();
        let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let file =
            SafeTensors::deserialize(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let stored = |(name, tensor): (&str, safetensors::tensor::TensorView)| {
            assert_eq!(tensor.dtype(), safetensors::Dtype::F32, "{name}");
            let values = tensor.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
            (name.to_owned(), Stored { shape: tensor.shape().to_vec(), values: values.collect() })
        };
        Self(file.iter().map(stored).collect())
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    pub fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    pub fn shape(&self, name: &str) -> &[usize] {
        &self.stored(name).shape
    }

    pub fn values(&self, name: &str) -> &[f32] {
        &self.stored(name).values
    }

    pub fn tensor<const D: usize>(&self, name: &str, device: &Device) -> Tensor<D> {
        let Stored { shape, values } = self.stored(name);
        Tensor::from_data(TensorData::new(values.clone(), shape.clone()), device)
    }

    fn stored(&self, name: &str) -> &Stored {
        self.0.get(name).unwrap_or_else(|| panic!("{name}: not among the golden values"))
    }
}

/// The numbers of a tensor, which holds `f32`.
pub fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("f32")
}

/// Uniform in -1..1, from a hash of the index and the seed.
pub fn noise(index: u32, seed: u32) -> f32 {
    let mut x = index.wrapping_mul(0x9E37_79B9) ^ seed;
    x = (x ^ (x >> 16)).wrapping_mul(0x85EB_CA6B);
    x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE35);
    x ^= x >> 16;
    (x >> 8) as f32 / 8_388_608.0 - 1.0
}

/// FNV-1a: the seed of what has this name.
pub fn name_hash(name: &str) -> u32 {
    name.bytes().fold(0x811C_9DC5, |value, byte| (value ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}
