//! Opening datasets that may have millions of pairs.

use srflow_data::flow::{DatasetError, DatasetSpec, FlowDataset, Split};

use crate::Watch;

/// Lists the pairs of a dataset, and counts them.
///
/// # Errors
/// Those of [`FlowDataset::open`].
pub fn open_dataset(
    spec: &DatasetSpec,
    split: Option<Split>,
    watch: &Watch,
) -> Result<FlowDataset, DatasetError> {
    let listed = watch.count(format!("pairs of {spec} listed"), None);
    FlowDataset::open_watched(spec, split, |pairs| listed.set(pairs))
}
