//! Burnpack: Burn's own container.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use burn::tensor::DType;
use burn_pack::{Bytes, Reader};

use super::{StoredBytes, StoredTensor};

/// Reads the whole file, since the lazy reader of the format cannot report read errors.
pub(super) fn tensors(mut file: File, len: u64) -> Result<BTreeMap<String, StoredTensor>, String> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    file.take(len).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    let reader = Reader::from_bytes(Bytes::from_bytes_vec(bytes)).map_err(|error| error.to_string())?;
    let mut found = BTreeMap::new();
    let mut claimed = 0;
    for tensor in reader.into_tensors().map_err(|error| error.to_string())? {
        if !matches!(tensor.dtype, DType::F64 | DType::F32 | DType::F16 | DType::BF16) {
            continue;
        }
        claimed += tensor.byte_len() as u64;
        if claimed > len {
            return Err(format!("its tensors claim more than the {len} bytes of the file"));
        }
        let (name, dtype, shape, _, bytes) = tensor.into_parts().map_err(|error| error.to_string())?;
        let bytes = StoredBytes::Memory(bytes.to_vec());
        found.insert(without_variant(&name), StoredTensor { dtype, shape: shape.to_vec(), bytes });
    }
    Ok(found)
}

/// Removes the variant of an enum (in upper camel case) that Burn puts into the path; PyTorch has no such level.
fn without_variant(name: &str) -> String {
    match name.split_once('.') {
        Some((first, rest)) if first.starts_with(|c: char| c.is_ascii_uppercase()) => rest.to_owned(),
        _ => name.to_owned(),
    }
}
