//! PyTorch's files: a pickle that names the tensors, and their bytes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use burn::tensor::DType;
use pytorch_reader::PytorchReader;
use zip::ZipArchive;

use super::{Format, MOST_CLAIMED, StoredBytes, StoredTensor};

/// Largest pickle of a zip file. Those of real checkpoints are under a megabyte, as they hold no values; parsed, one
/// takes up to a hundred times its size.
const MAX_PICKLE_BYTES: u64 = 16 << 20;

pub(super) fn tensors(
    path: &Path,
    format: Format,
    len: u64,
) -> Result<BTreeMap<String, StoredTensor>, String> {
    if format == Format::PytorchZip {
        check_pickle_size(path, len)?;
    }
    let reader = PytorchReader::new(path).map_err(|error| error.to_string())?;
    let found = reader.into_tensors().into_iter().filter_map(|(name, tensor)| {
        let dtype = match tensor.dtype() {
            pytorch_reader::DType::F64 => DType::F64,
            pytorch_reader::DType::F32 => DType::F32,
            pytorch_reader::DType::F16 => DType::F16,
            pytorch_reader::DType::BF16 => DType::BF16,
            _ => return None,
        };
        let shape = tensor.shape().to_vec();
        Some((name, StoredTensor { dtype, shape, bytes: StoredBytes::Pytorch(tensor) }))
    });
    Ok(found.collect())
}

/// A deflated pickle may claim any size, of which the reader would take up to 100 MB.
fn check_pickle_size(path: &Path, len: u64) -> Result<(), String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| error.to_string())?;
    let most = MAX_PICKLE_BYTES.min(len.saturating_mul(MOST_CLAIMED));
    for index in 0..archive.len() {
        let entry = archive.by_index_raw(index).map_err(|error| error.to_string())?;
        let name = entry.name().map_err(|error| error.to_string())?;
        if name.ends_with("data.pkl") && entry.size() > most {
            return Err(format!(
                "its data.pkl claims {} bytes, of which at most {most} are read",
                entry.size()
            ));
        }
    }
    Ok(())
}
