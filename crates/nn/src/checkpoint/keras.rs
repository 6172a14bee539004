//! Keras weights in HDF5 (`model.save_weights`, `model.save`): a group per layer, which contains the weights under names that
//! include the layer, such as `conv1/conv1/kernel:0`.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use burn::tensor::DType;
use srflow_files::{Hdf5Array, hdf5_arrays};

use super::tensorflow::layout::{reference_name, reference_order, reference_shape};
use super::{Contents, StoredBytes, StoredTensor};

/// Group of the weights in the file of a whole model.
const OF_MODEL: &str = "model_weights/";
/// Group of the optimizer state in the file of a whole model.
const OF_OPTIMIZER: &str = "optimizer_weights/";

/// Reads the whole file, as HDF5 is parsed by following addresses in it.
pub(super) fn contents(mut file: File, len: u64) -> Result<Contents, String> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    file.take(len).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    let arrays = hdf5_arrays(&bytes).map_err(|problem| problem.to_string())?;
    drop(bytes);
    let of_weights = |array: Hdf5Array| {
        let path = array.path.strip_prefix(OF_MODEL).unwrap_or(&array.path);
        let name = reference_name(without_layer(path)).filter(|_| !path.starts_with(OF_OPTIMIZER))?;
        let number = size_of::<f32>();
        let values = array.values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let bytes = StoredBytes::Memory(reference_order(values, &array.shape, number));
        let shape = reference_shape(&array.shape);
        Some((name, StoredTensor { dtype: DType::F32, shape, bytes }))
    };
    let tensors: std::collections::BTreeMap<_, _> = arrays.into_iter().filter_map(of_weights).collect();
    Ok(Contents::from(tensors))
}

/// Removes the group of a layer, since the name of a weight in it starts with the layer again.
fn without_layer(path: &str) -> &str {
    match path.split_once('/') {
        Some((layer, rest)) if rest.strip_prefix(layer).is_some_and(|rest| rest.starts_with('/')) => rest,
        _ => path,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_of_layers_are_removed() {
        assert_eq!(without_layer("conv1/conv1/kernel:0"), "conv1/kernel:0");
        assert_eq!(without_layer("conv1/conv10/kernel:0"), "conv1/conv10/kernel:0");
        assert_eq!(without_layer("conv1/kernel:0"), "conv1/kernel:0");
    }
}
