//! Training, in a single test program so that the libraries are linked once.

mod augment;
mod config;
mod gradients;
mod losses;
mod optimizer;
mod pairs;
mod ranks;
