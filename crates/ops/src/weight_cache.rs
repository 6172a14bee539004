//! Weights in the kernels' layout, cached between calls.

use std::any::Any;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use burn::backend::TensorMetadata;
use burn::backend::flex::FlexTensor;
use srflow_simd::{Isa, Packed, Precision};

use crate::flex::CpuTensor;

/// Caches a converted weight while the weight remains the same tensor.
///
/// One cache belongs to one layer's weight, and keeps one version per pass. Clones share their cache; with another weight the cache
/// still works, but converts again.
#[derive(Clone, Default)]
pub struct WeightCache(Arc<Mutex<[Option<Kept>; 2]>>);

/// The purpose of a layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pass {
    Forward,
    /// The gradient of the input.
    Backward,
}

/// What the layout depends on, apart from the weight and its shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Packing {
    pub(crate) pass: Pass,
    pub(crate) isa: Isa,
    pub(crate) precision: Precision,
    pub(crate) stride: [usize; 2],
    pub(crate) padding: [usize; 2],
}

struct Kept {
    /// The weight's memory. A weak reference identifies it, and while there is one, the memory is neither modified in place nor
    /// reused.
    source: Weak<dyn Any + Send + Sync>,
    start: usize,
    shape: Vec<usize>,
    packing: Packing,
    made: Arc<Packed>,
}

impl fmt::Debug for WeightCache {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("WeightCache")
    }
}

impl WeightCache {
    /// The result of `make` for the weight's elements, computed now or earlier.
    pub(crate) fn get(
        &self,
        packing: Packing,
        weight: &FlexTensor,
        make: impl FnOnce(&[f32]) -> Packed,
    ) -> Arc<Packed> {
        let start = weight.layout().start_offset();
        let shape = weight.shape().to_vec();
        let memory: Arc<dyn Any + Send + Sync> = weight.data_arc();
        let mut both = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = &mut both[packing.pass as usize];
        if weight.is_contiguous()
            && let Some(kept) = kept.as_ref()
            && std::ptr::addr_eq(kept.source.as_ptr(), Arc::as_ptr(&memory))
            && kept.start == start
            && kept.shape == shape
            && kept.packing == packing
        {
            return kept.made.clone();
        }
        let made = Arc::new(make(CpuTensor::from(weight.clone()).slice()));
        *kept = weight.is_contiguous().then(|| Kept {
            source: Arc::downgrade(&memory),
            start,
            shape,
            packing,
            made: made.clone(),
        });
        made
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;

    fn forward() -> Packing {
        let (isa, precision) = (Isa::best(), Precision::F32);
        Packing { pass: Pass::Forward, isa, precision, stride: [1, 1], padding: [0, 0] }
    }

    fn weight(values: [f32; 4]) -> FlexTensor {
        FlexTensor::from_data(TensorData::new(values.to_vec(), [2, 2]))
    }

    /// What a cache gives for a weight, where `make` makes numbers.
    fn get(
        cache: &WeightCache,
        packing: Packing,
        weight: &FlexTensor,
        make: impl FnOnce(&[f32]) -> Vec<f32>,
    ) -> Vec<f32> {
        cache.get(packing, weight, |weight| Packed::of_numbers(make(weight))).numbers().to_vec()
    }

    #[test]
    fn a_weight_is_made_once_until_it_changes() {
        let cache = WeightCache::default();
        let mut first = weight([1., 2., 3., 4.]);
        let twice = |values: &[f32]| values.iter().map(|x| 2.0 * x).collect();
        assert_eq!(get(&cache, forward(), &first, twice), [2., 4., 6., 8.]);
        let not_again = |_: &[f32]| unreachable!("the weight is the same");
        assert_eq!(get(&cache.clone(), forward(), &first.clone(), not_again), [2., 4., 6., 8.]);
        let thrice = |values: &[f32]| values.iter().map(|x| 3.0 * x).collect();
        assert_eq!(
            get(&cache, Packing { pass: Pass::Backward, ..forward() }, &first, thrice),
            [3., 6., 9., 12.]
        );
        assert_eq!(get(&cache, forward(), &first, not_again), [2., 4., 6., 8.]);

        first.storage_mut::<f32>()[0] = 5.0;
        assert_eq!(get(&cache, forward(), &first, twice), [10., 4., 6., 8.]);
        drop(first);
        assert_eq!(get(&cache, forward(), &weight([0., 1., 0., 1.]), twice), [0., 2., 0., 2.]);
    }

    #[test]
    fn another_stride_padding_precision_or_instruction_set_makes_it_again() {
        let cache = WeightCache::default();
        let weight = weight([1., 2., 3., 4.]);
        let portable = Isa::to_test().next().expect("the portable one");
        for (number, packing) in [
            forward(),
            Packing { stride: [2, 1], ..forward() },
            Packing { padding: [0, 1], ..forward() },
            Packing { isa: portable, padding: [1, 1], ..forward() },
            Packing { precision: Precision::Bf16, ..forward() },
        ]
        .into_iter()
        .enumerate()
        {
            assert_eq!(
                get(&cache, packing, &weight, |_| vec![number as f32]),
                [number as f32],
                "{packing:?}"
            );
        }
    }

    #[test]
    fn views_of_one_memory_are_told_apart() {
        let cache = WeightCache::default();
        let whole = weight([1., 2., 3., 4.]);
        let copy = |values: &[f32]| values.to_vec();
        assert_eq!(get(&cache, forward(), &whole.narrow(0, 0, 1), copy), [1., 2.]);
        assert_eq!(get(&cache, forward(), &whole.narrow(0, 1, 1), copy), [3., 4.]);
        assert_eq!(get(&cache, forward(), &whole.transpose(0, 1), copy), [1., 3., 2., 4.]);
        assert_eq!(get(&cache, forward(), &whole, copy), [1., 2., 3., 4.]);
    }
}
