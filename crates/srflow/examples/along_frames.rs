//! The mean motion between the frames of a video, given as pictures in order; each frame is encoded once:
//!
//!     cargo run --release -p srflow --example along_frames -- frames/*.png

use std::error::Error;
use std::path::Path;

use srflow::Watch;
use srflow::files::read_image;
use srflow::flow::{MethodParameters, MethodSpec, estimator};

fn main() -> Result<(), Box<dyn Error>> {
    let method = estimator(&MethodSpec::default(), &MethodParameters::default(), &Watch::SILENT)?;
    let mut video = method.sequence(false);
    for path in std::env::args_os().skip(1) {
        let frame = read_image(Path::new(&path))?;
        // The first frame has no flow.
        for estimate in video.push(&[frame])? {
            let lengths = estimate.flow.pixels().iter().map(|[u, v]| f64::from(u.hypot(*v)));
            let mean = lengths.sum::<f64>() / estimate.flow.pixels().len() as f64;
            println!("{}: {mean:.3} px", path.display());
        }
    }
    Ok(())
}
