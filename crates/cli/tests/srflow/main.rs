//! The binary as its users run it, one module for each command: a single program, so that the libraries are linked once.

use std::path::PathBuf;
use std::process::Command;

mod ablation;
mod architecture;
mod demo;
mod eval;
mod flow;
mod flow_networks;
mod licences;
mod mer_data;
mod mer_run;
mod metrics_and_convert;
mod models;
mod rasterize;
mod render_check;
mod train;

/// The program under test. Cargo names it when the tests run: a path kept from the build would outlive a move of the checkout.
fn binary() -> PathBuf {
    std::env::var_os("CARGO_BIN_EXE_srflow").expect("cargo runs the tests").into()
}

fn srflow() -> Command {
    Command::new(binary())
}
