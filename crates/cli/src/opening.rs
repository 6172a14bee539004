//! Opening datasets that may have millions of pairs.

use srflow_read::flow::{DatasetError, DatasetSpec, FlowDataset, Split};

use crate::progress::{Lines, bar};

/// Lists the pairs of a dataset, and counts them on standard error while that takes long.
///
/// # Errors
/// Those of [`FlowDataset::open`].
pub fn open_dataset(spec: &DatasetSpec, split: Option<Split>) -> Result<FlowDataset, DatasetError> {
    let (bar, lines) = (bar(None, "{spinner} {pos} pairs of {msg} listed, {elapsed}"), Lines::new());
    bar.set_message(spec.to_string());
    let counter = bar.clone();
    let units = format!("pairs of {spec} listed");
    let opened = FlowDataset::open_watched(spec, split, move |pairs| {
        counter.set_position(pairs);
        lines.now_and_then(&counter, &units);
    });
    bar.finish_and_clear();
    opened
}
