use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use srflow_field::{
    FileError, FileKind, create_folder, longest_flow, read_text, write_flow, write_image_png, write_mask_png,
    write_npy, write_npy_plane,
};
use srflow_read::manifest::CameraRecord;
use srflow_render::camera::camera_from_record;
use srflow_splat::{Camera, Frame, Next, Options, Outputs, PixelConvention, Rasterizer, read_ply};

use crate::Context;
use crate::output::ensure_free;

/// Rasterize a file of 3D Gaussians: colour, flow, alpha and depth
///
/// Into OUT go color.png (8-bit), color.npy (H, W, 3, before clamping, 0 to 1 is what can be shown), alpha.npy, depth.npy
/// (expected depth, 0 where nothing is seen), mask.png (alpha above one half), flow.flo (blended displacement of the
/// Gaussians, not divided by alpha) and flow_normalized.flo (divided by alpha).
///
/// The flow leads to the Gaussians of --next as --camera-next sees them. Without --next the Gaussians stay, without
/// --camera-next the camera stays; without both the flow is zero.
#[derive(Args)]
#[command(after_help = "Example:
  srflow rasterize frame0.ply --next frame1.ply --camera cam.json --out rendered

CAM is a JSON file of a pinhole camera (x right, y down, z forward; an integer coordinate is
the centre of a pixel):
  {\"width\": 550, \"height\": 802, \"fx\": 1200, \"fy\": 1200, \"cx\": 274.5, \"cy\": 400.5,
   \"w2c\": [[1,0,0,0], [0,1,0,0], [0,0,1,1.5], [0,0,0,1]]}
w2c is the camera's pose as a 4x4 matrix by rows, camera from world. PLY is a file of 3D Gaussian
splatting (spherical harmonics of degree 0 to 3).")]
pub struct Rasterize {
    /// Gaussians of this frame
    #[arg(value_name = "PLY")]
    gaussians: PathBuf,
    /// Gaussians of the next frame: the same ones, in the same order
    #[arg(long, value_name = "PLY")]
    next: Option<PathBuf>,
    /// Camera of this frame
    #[arg(long, value_name = "CAM")]
    camera: PathBuf,
    /// Camera of the next frame, of the same image size
    #[arg(long, value_name = "CAM")]
    camera_next: Option<PathBuf>,
    /// Folder to write into; made if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Colour behind the Gaussians, each of 0 to 255
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", value_parser = background)]
    background: [u8; 3],
    /// Pixels in which the flow is counted
    #[arg(long, value_enum, default_value_t = Convention::Splat)]
    pixel_convention: Convention,
    /// Overwrite files in DIR
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Convention {
    /// ((ndc + 1) S - 1) / 2, as colour is placed: flow and colour agree
    Splat,
    /// (ndc + 1) (S - 1) / 2, as the SRFlow paper writes: flow is smaller by (S - 1) / S
    Paper,
}

fn background(text: &str) -> Result<[u8; 3], String> {
    let channels: Option<Vec<u8>> = text.split(',').map(|channel| channel.trim().parse().ok()).collect();
    channels
        .and_then(|channels| channels.try_into().ok())
        .ok_or_else(|| "expected three whole numbers of 0 to 255, such as 255,255,255".to_owned())
}

/// What `--json` prints.
#[derive(Serialize)]
struct Rendered<'a> {
    out: &'a Path,
    files: [&'static str; 7],
    width: usize,
    height: usize,
    gaussians: usize,
    /// Gaussians that can touch a pixel.
    visible: usize,
    /// Visible Gaussians whose next position is not in front of the next camera.
    without_displacement: usize,
    /// (Gaussian, pixel) pairs that were blended.
    blended_pairs: u64,
    /// Pixels whose alpha is above one half.
    mask_pixels: usize,
    /// Length of the longest flow, not divided by alpha, in pixels.
    longest_flow: f32,
}

const FILES: [&str; 7] =
    ["color.png", "color.npy", "alpha.npy", "depth.npy", "mask.png", "flow.flo", "flow_normalized.flo"];

/// Runs the command.
pub fn run(args: Rasterize, context: &Context) -> anyhow::Result<()> {
    ensure_free(FILES.map(|name| args.out.join(name)), args.force)?;
    let camera = read_camera(&args.camera)?;
    let camera_next = args.camera_next.as_deref().map(read_camera).transpose()?;
    let gaussians = read_ply(&args.gaussians)?;
    let moved = args.next.as_deref().map(read_ply).transpose()?;
    if let (Some(moved), Some(path)) = (&moved, &args.next) {
        ensure!(
            moved.len() == gaussians.len(),
            "{} holds {} Gaussians and {} holds {}: flow needs the same Gaussians in both, in the same order",
            args.gaussians.display(),
            gaussians.len(),
            path.display(),
            moved.len()
        );
    }

    create_folder(&args.out)?;

    let next = Next {
        gaussians: moved.as_ref().unwrap_or(&gaussians),
        camera: camera_next.as_ref().unwrap_or(&camera),
    };
    let options = Options {
        background: args.background.map(|channel| f32::from(channel) / 255.0),
        convention: match args.pixel_convention {
            Convention::Splat => PixelConvention::Splat,
            Convention::Paper => PixelConvention::Paper,
        },
        outputs: Outputs { depth_next: false, ..Outputs::ALL },
    };
    let mut frame = Frame::new();
    Rasterizer::new().render(&gaussians, &camera, Some(next), &options, &mut frame)?;

    write(&frame, &args.out)?;
    if frame.statistics.without_displacement > 0 {
        eprintln!(
            "note: {} Gaussians are behind the next camera or nearer than 0.2 to it; they add nothing to the flow",
            frame.statistics.without_displacement
        );
    }
    if context.json {
        say!("{}", serde_json::to_string(&rendered(&args.out, &frame, gaussians.len()))?)?;
    }
    Ok(())
}

fn read_camera(path: &Path) -> anyhow::Result<Camera> {
    let text = read_text(path, FileKind::Settings)?;
    let record: CameraRecord = serde_json::from_str(&text).with_context(|| {
        format!(
            "{}: expected a camera with width, height, fx, fy, cx, cy and w2c (a 4x4 matrix by rows)",
            path.display()
        )
    })?;
    let camera = camera_from_record(&record);
    camera.validate().with_context(|| path.display().to_string())?;
    Ok(camera)
}

fn write(frame: &Frame, out: &Path) -> Result<(), FileError> {
    write_image_png(&out.join("color.png"), &frame.image)?;
    write_npy(&out.join("color.npy"), &[frame.height, frame.width, 3], frame.color.as_flattened())?;
    write_npy_plane(&out.join("alpha.npy"), &frame.alpha)?;
    write_npy_plane(&out.join("depth.npy"), &frame.depth)?;
    write_mask_png(&out.join("mask.png"), &frame.mask())?;
    write_flow(&out.join("flow.flo"), &frame.flow)?;
    write_flow(&out.join("flow_normalized.flo"), &frame.flow_normalized())
}

fn rendered<'a>(out: &'a Path, frame: &Frame, gaussians: usize) -> Rendered<'a> {
    Rendered {
        out,
        files: FILES,
        width: frame.width,
        height: frame.height,
        gaussians,
        visible: frame.statistics.visible,
        without_displacement: frame.statistics.without_displacement,
        blended_pairs: frame.statistics.blended,
        mask_pixels: frame.mask().pixels().iter().filter(|covered| **covered).count(),
        longest_flow: longest_flow(&frame.flow),
    }
}
