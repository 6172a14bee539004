//! The `srflow` command.

use std::process::ExitCode;

use srflow_ops::ReusingAllocator;

#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

fn main() -> ExitCode {
    ExitCode::from(srflow_cli::run(std::env::args_os()))
}
