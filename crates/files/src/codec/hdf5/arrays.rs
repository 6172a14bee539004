use std::collections::HashSet;

use super::header::{LinkBudget, links, message, messages, root_group};
use super::read::{Layout, parse_sample, parse_shape};
use crate::FileProblem;
use crate::codec::claim::check_file_size;
use crate::codec::samples::convert_samples;
use srflow_core::excerpt;

/// Most groups and datasets in each other.
const MAX_DEPTH: usize = 32;

/// A floating-point dataset of an HDF5 file.
#[derive(Debug, Clone, PartialEq)]
pub struct Hdf5Array {
    /// Names of the groups around it and its own, with slashes between them, such as `conv1/conv1/kernel:0`.
    pub path: String,
    pub shape: Vec<usize>,
    /// Row-major.
    pub values: Vec<f32>,
}

/// Every floating-point dataset of an HDF5 file, in all its groups; others are left out.
///
/// # Errors
/// When the file is broken, or a dataset is stored in chunks.
pub fn hdf5_arrays(file: &[u8]) -> Result<Vec<Hdf5Array>, FileProblem> {
    let mut arrays = Vec::new();
    let mut budget = LinkBudget::new(file);
    // Neither headers nor values overlap: together they are no longer than the file.
    let (mut header_bytes, mut value_bytes) = (file.len(), file.len());
    let mut seen = HashSet::new();
    let mut waiting = vec![(Vec::new(), root_group(file)?)];
    while let Some((path, address)) = waiting.pop() {
        if !seen.insert(address) {
            continue; // a second name, or a cycle
        }
        let messages = messages(file, address)?;
        take(&mut header_bytes, messages.iter().map(|(_, data)| data.len() + 4).sum())?;
        if let Some(array) = array(file, &path, &messages, &mut value_bytes)? {
            arrays.push(array);
        }
        for (name, address) in links(file, &messages, &mut budget)? {
            let path: Vec<&[u8]> = path.iter().copied().chain([name]).collect();
            if path.len() > MAX_DEPTH {
                return Err(FileProblem::field(
                    "group",
                    format!("at most {MAX_DEPTH} groups in each other"),
                    "more",
                ));
            }
            waiting.push((path, address));
        }
    }
    arrays.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(arrays)
}

/// A dataset of floating-point numbers; nothing for groups and other datasets.
fn array(
    file: &[u8],
    path: &[&[u8]],
    messages: &[(u16, &[u8])],
    value_bytes: &mut usize,
) -> Result<Option<Hdf5Array>, FileProblem> {
    let find = |wanted: u16| messages.iter().find(|(kind, _)| *kind == wanted).map(|(_, data)| *data);
    let parts = (find(message::DATASPACE), find(message::DATATYPE), find(message::LAYOUT));
    let (Some(shape), Some(sample), Some(layout)) = parts else { return Ok(None) };
    let Ok(sample) = parse_sample(sample) else { return Ok(None) };
    let path = String::from_utf8_lossy(&path.join(&b'/')).into_owned();
    let shape: Option<Vec<usize>> =
        parse_shape(shape)?.into_iter().map(|side| side.try_into().ok()).collect();
    let values =
        shape.as_ref().and_then(|shape| shape.iter().try_fold(1_usize, |all, side| all.checked_mul(*side)));
    if values == Some(0) {
        return Ok(None); // without a place in the file
    }
    let Layout::Contiguous(bytes) = Layout::parse(file, layout)? else {
        let found = format!("chunks, as of compressed data, in {}", excerpt(&path));
        return Err(FileProblem::field("data layout", "numbers in one piece", found));
    };
    let promised = values.and_then(|values| values.checked_mul(sample.bytes()));
    check_file_size(promised.map_or(u64::MAX, |bytes| bytes as u64), bytes.len() as u64)?;
    take(value_bytes, bytes.len())?;
    let mut values = vec![0.0; bytes.len() / sample.bytes()];
    convert_samples(sample, bytes, &mut values);
    Ok(shape.map(|shape| Hdf5Array { path, shape, values }))
}

fn take(left: &mut usize, bytes: usize) -> Result<(), FileProblem> {
    let after = left.checked_sub(bytes);
    *left = after
        .ok_or_else(|| FileProblem::field("file", "parts with places of their own", "parts that overlap"))?;
    Ok(())
}
