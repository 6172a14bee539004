//! Renders a small dataset with exact flow, with its progress, and checks it:
//!
//!     cargo run --release -p srflow --example dataset -- tiny

use srflow::check::CheckJob;
use srflow::render::{RenderJob, Settings};
use srflow::{Job, Watch};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let out = std::env::args_os().nth(1).ok_or("expected the folder of the dataset")?;
    let settings = Settings { scenes: 2, frames: 3.0, size: "220x320".parse()?, ..Settings::default() };
    let job = RenderJob { settings, ..RenderJob::new(&out) };
    // Running the program again continues a run that was stopped.
    let watch = Watch {
        on_progress: &|progress| eprintln!("{} of {} pairs", progress.done, progress.total.unwrap_or(0)),
        stop: &|| false,
    };
    println!("{}", job.run(&watch)?);
    println!(
        "{}",
        CheckJob { dir: out.into(), hashes: false, rerender: None, seed: None }.run(&Watch::SILENT)?
    );
    Ok(())
}
