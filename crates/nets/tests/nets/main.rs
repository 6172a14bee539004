//! Networks, in a single test program so that the libraries are linked once.

mod estimator;
mod features;
mod inputs;
mod memory;
mod network;
mod onnx;
mod parity;
mod weights;
