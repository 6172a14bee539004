//! Training optical flow networks: losses, regularizers made for skin, trainer, exact resume, ablation.

pub mod loss;
