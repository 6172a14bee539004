//! The flow between two pictures by the built-in network, shown as colours:
//!
//!     cargo run --release -p srflow --example two_pictures -- frame1.png frame2.png flow.png

use std::error::Error;
use std::path::PathBuf;

use srflow::Watch;
use srflow::core::flow_colors;
use srflow::files::{read_image, write_image_png};
use srflow::flow::{MethodParameters, MethodSpec, estimator};

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [first, second, colours] = &paths[..] else {
        return Err("expected two pictures and the picture to write".into());
    };
    // "tvl1" or "raft=raft-sintel.pth" parse as methods too.
    let method = estimator(&MethodSpec::default(), &MethodParameters::default(), &Watch::SILENT)?;
    let flow = method.estimate(&read_image(first)?, &read_image(second)?)?;
    let [u, v] = flow.get(flow.width() / 2, flow.height() / 2);
    println!("in the centre: {u:.2} px to the right, {v:.2} px down");
    write_image_png(colours, &flow_colors(&flow, None))?;
    Ok(())
}
