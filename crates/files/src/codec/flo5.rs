//! Spring's `.flo5`: an HDF5 file whose dataset `flow` has shape (H, W, 2), compressed with gzip; NaN where the flow is
//! unknown (`flow_IO.py` of the Spring development kit).

use std::io::{self, Read, Write};

use super::checks::check_finite_or_unknown;
use super::claim::{blank, check_size, read_all};
use super::hdf5;
use crate::FileProblem;
use srflow_core::{FlowField, Size};

pub(super) use super::hdf5::MAGIC;

const DATASET: &str = "flow";

pub(super) fn decode(reader: &mut dyn Read, len: u64) -> Result<FlowField, FileProblem> {
    let bytes = read_all(reader, len)?;
    let dataset = hdf5::Dataset::find(&bytes, DATASET)?;
    let [height, width, 2] = dataset.shape[..] else {
        let found = format!("{:?}", dataset.shape);
        return Err(FileProblem::field("shape of the dataset `flow`", "(H, W, 2)", found));
    };
    let side = |side| i64::try_from(side).unwrap_or(i64::MAX);
    let Size { width, height } = check_size(side(width), side(height))?;
    let mut flow = FlowField::from_buffer(width, height, blank(width * height)?);
    dataset.read(flow.pixels_mut().as_flattened_mut())?;
    check_finite_or_unknown(&flow)?;
    Ok(flow)
}

pub(super) fn encode(flow: &FlowField, writer: &mut impl Write) -> io::Result<()> {
    hdf5::write_image(DATASET, [flow.height(), flow.width(), 2], flow.pixels().as_flattened(), writer)
}
