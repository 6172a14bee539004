//! Safetensors, the format of our own checkpoints: eight bytes of length, a JSON table of the tensors, their bytes without gaps.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::rc::Rc;

use burn::tensor::{DType, TensorData, f16};
use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorView};
use srflow_files::{FileKind, open_file};

use super::{About, Contents, Format, StoredBytes, StoredTensor, read_all};
use crate::parameters::Parameters;
use crate::weights::WeightsError;

/// Bytes of the length of the table.
const LENGTH: u64 = 8;
/// Metadata key of [`About`], stored as JSON. Only a single key makes the bytes of a file deterministic, as the format's writer
/// does not sort keys.
const ABOUT: &str = "srflow";

/// Reads only the table, and checks it against the length of the file.
pub(super) fn contents(mut file: File, len: u64) -> Result<Contents, String> {
    let mut table_len = [0; LENGTH as usize];
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    file.read_exact(&mut table_len).map_err(|error| error.to_string())?;
    let table_len = u64::from_le_bytes(table_len);
    let after = len.saturating_sub(LENGTH);
    if table_len > after {
        return Err(format!("its table claims {table_len} bytes, the file has {after} left"));
    }
    let mut table = Vec::new();
    (&mut file).take(table_len).read_to_end(&mut table).map_err(|error| error.to_string())?;
    let table: Metadata = serde_json::from_slice(&table).map_err(|error| {
        format!("in its table of tensors: {}", srflow_files::parse_error_in_words(&error))
    })?;
    let (claimed, left) = (table.data_len() as u64, after - table_len);
    if claimed != left {
        return Err(format!("its tensors claim {claimed} bytes, the file has {left} left"));
    }
    let file = Rc::new(file);
    let mut others = BTreeMap::new();
    let found = table.tensors().into_iter().filter_map(|(name, info)| {
        let Some(dtype) = dtype(info.dtype) else {
            others.insert(name.clone(), format!("tensors of {:?}", info.dtype));
            return None;
        };
        let (start, end) = info.data_offsets;
        let start_in_file = LENGTH + table_len + start as u64;
        let bytes = StoredBytes::Range { file: file.clone(), start: start_in_file, len: end - start };
        Some((name, StoredTensor { dtype, shape: info.shape.clone(), bytes }))
    });
    let tensors: BTreeMap<_, _> = found.collect();
    let about = table.metadata().as_ref().and_then(|metadata| metadata.get(ABOUT));
    let about: Option<About> = about.and_then(|about| serde_json::from_str(about).ok());
    let numbers =
        about.into_iter().flat_map(|about| about.settings.into_iter().chain(about.hyper_parameters));
    Ok(Contents {
        others,
        hyper_parameters: numbers.map(|(name, number)| (name, number as f64)).collect(),
        ..Contents::from(tensors)
    })
}

/// Reads the floating-point tensors of a safetensors file, with the names and types of the file.
///
/// # Errors
/// When the file cannot be read, or is truncated or corrupt.
pub fn read_safetensors(path: &Path) -> Result<Parameters, WeightsError> {
    let (file, len) = open_file(path, FileKind::Checkpoint)?;
    let contents =
        contents(file, len).map_err(|problem| WeightsError::broken(path, Format::Safetensors, &problem))?;
    read_all(path, Format::Safetensors, contents.tensors)
}

/// The floating-point tensors in the bytes of a safetensors file, as `f32`.
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn parameters_of_safetensors(bytes: &[u8]) -> Result<Parameters, String> {
    let file = safetensors::SafeTensors::deserialize(bytes).map_err(|error| error.to_string())?;
    let tensors = file.iter().filter_map(|(name, view)| {
        let data =
            TensorData::from_bytes_vec(view.data().to_vec(), view.shape().to_vec(), dtype(view.dtype())?);
        Some((name.to_owned(), data.convert::<f32>()))
    });
    Ok(tensors.collect())
}

/// The type of floating-point numbers; `None` for others.
fn dtype(stored: Dtype) -> Option<DType> {
    match stored {
        Dtype::F64 => Some(DType::F64),
        Dtype::F32 => Some(DType::F32),
        Dtype::F16 => Some(DType::F16),
        Dtype::BF16 => Some(DType::BF16),
        _ => None,
    }
}

/// Type of numbers in files that srflow writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StoredAs {
    F32,
    /// Rounded to the nearest.
    F16,
}

/// Serializes tensors (name, shape, values) and metadata in the safetensors format. The bytes do not depend on the order of the
/// tensors.
///
/// # Panics
/// When the number of values does not match a shape, or a name occurs twice.
pub fn safetensors_bytes<'a>(
    tensors: impl IntoIterator<Item = (String, &'a [usize], &'a [f32])>,
    stored_as: StoredAs,
    about: Option<&About>,
) -> Vec<u8> {
    let dtype = match stored_as {
        StoredAs::F32 => Dtype::F32,
        StoredAs::F16 => Dtype::F16,
    };
    let bytes_of = |values: &[f32]| -> Vec<u8> {
        match stored_as {
            StoredAs::F32 => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            StoredAs::F16 => values.iter().flat_map(|value| f16::from_f32(*value).to_le_bytes()).collect(),
        }
    };
    let tensors: Vec<(String, &[usize], Vec<u8>)> =
        tensors.into_iter().map(|(name, shape, values)| (name, shape, bytes_of(values))).collect();
    let views = tensors.iter().map(|(name, shape, bytes)| {
        let view = TensorView::new(dtype, shape.to_vec(), bytes).expect("as many values as the shape says");
        (name, view)
    });
    let about = about.map(|about| serde_json::to_string(about).expect("strings and numbers"));
    let metadata = about.map(|about| HashMap::from([(ABOUT.to_owned(), about)]));
    safetensors::serialize(views, metadata).expect("tensors that fit their shapes")
}
