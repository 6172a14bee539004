//! Making datasets, in a single test program so that the libraries are linked once.

mod capture;
mod check;
mod decompose;
mod device;
mod label_error;
mod long;
mod made;
mod recording;
mod regions;
mod shading_change;
mod shapes;
mod synth;
mod threads;
mod tiny;
mod tree;
