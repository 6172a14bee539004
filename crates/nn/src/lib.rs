//! Foundation of all networks: layers, parameters under the names of the reference implementations, checkpoint files, AdamW.

mod checkpoint;
mod host;
mod initializer;
pub mod layers;
mod optimizer;
mod parameters;
mod weights;

pub use checkpoint::{
    About, Checkpoint, Format, StoredAs, masked_crc32c, parameters_of_safetensors, push_varint,
    read_safetensors, safetensors_bytes, save_pytorch, searchable_text,
};
pub use host::{HostGradients, Layout, Segment, filled, numbers};
pub use initializer::Initializer;
pub use layers::with_batch_statistics;
pub use optimizer::{AdamW, AdamWState, ModuleAdamW, Rounding, clip_norm, norm};
pub use parameters::{
    ParameterInfo, Parameters, ParametersError, compare, infos_of, parameter_infos, parameters,
    with_parameters,
};
pub use weights::{WeightsError, load, load_from, read_parameters, save_parameters, write_parameters};
