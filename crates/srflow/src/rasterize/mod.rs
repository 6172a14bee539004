//! Rasterizing of 3D Gaussians.

mod cameras;
mod head;
mod path;

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use srflow_core::{Color, longest_flow};
use srflow_files::{
    FileError, create_folder, write_flow, write_image_png, write_mask_png, write_npy, write_npy_plane,
};
use srflow_splat::{
    Frame, Gaussians, Next, Options, Outputs, PixelConvention, Rasterizer, Sorting, SplatFormat, Up,
    read_gaussians,
};

pub use self::cameras::{CameraArgs, Orbit};
pub use self::head::TwoPoses;
pub use self::path::RenderedPath;
use crate::clap::{Args, ValueEnum};
use crate::error::wrong_settings;
use crate::output::{ensure_folder, ensure_free};
use crate::video::{default_fps, is_video};
use crate::{Job, Report, Watch};

/// Rasterize a file of 3D Gaussians or a head: colour, flow, alpha and depth
///
/// Writes into OUT: color.png (8-bit), color.npy (H, W, 3, unclamped; 0 to 1 is displayable), alpha.npy, depth.npy (expected
/// depth, 0 where nothing is visible), mask.png (alpha above one half), flow.flo (blended displacement of the Gaussians, not
/// divided by alpha) and flow_normalized.flo (divided by alpha).
///
/// The flow goes to the Gaussians of --next, seen by the camera of --camera-next or --view-next. Without --next the Gaussians
/// do not move, and without another camera the camera does not; without both the flow is zero.
///
/// With --orbit or --path the camera moves: OUT gets frames/, flow/ (from each frame to the next) and mask/, numbered from
/// 000001, which `folder:OUT` reads as a dataset; an OUT such as clip.mp4 becomes a video of the frames.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow rasterize frame0.ply --next frame1.ply --camera cam.json --out rendered
  srflow rasterize point_cloud.ply --camera cameras.json --view 00012 --view-next 00013 --out rendered
  srflow rasterize head.ply --orbit 360x120 --size 720x720 --background white --out turn.mp4
  srflow rasterize --head avatar:DIR --timestep 12 --timestep-next 13 --out rendered

CAM is a file of cameras:
  cameras.json of 3D Gaussian Splatting
  transforms.json of NeRF, instant-ngp, nerfstudio or VHAP
  camera_params.json of NeRSemble
  a camera path that the viewer of nerfstudio saved
  the folder of a COLMAP model (cameras and images, .bin or .txt)
  or one pinhole camera (x right, y down, z forward; an integer coordinate is the centre of a pixel):
    {\"width\": 550, \"height\": 802, \"fx\": 1200, \"fy\": 1200, \"cx\": 274.5, \"cy\": 400.5,
     \"w2c\": [[1,0,0,0], [0,1,0,0], [0,0,1,1.5], [0,0,0,1]]}
  w2c is camera from world, a 4x4 matrix by rows.
FILE is a file of 3D Gaussian Splatting (spherical harmonics of degree 0 to 3), in the world of the cameras.")]
pub struct RasterizeJob {
    /// Gaussians of this frame: .ply, .splat, .spz, .glb, .ksplat or .sog
    #[arg(value_name = "FILE", required_unless_present = "head", conflicts_with = "head")]
    #[serde(default)]
    pub gaussians: Option<PathBuf>,
    /// Gaussians of the next frame: the same ones in the same order
    #[arg(long, value_name = "FILE")]
    #[serde(default)]
    pub next: Option<PathBuf>,
    #[command(flatten)]
    #[serde(flatten)]
    pub head: TwoPoses,
    #[command(flatten)]
    #[serde(flatten)]
    pub cameras: CameraArgs,
    /// Move the camera around the centre of the Gaussians; positive DEGREES move it to the right [default: a
    /// frame every 3 degrees]
    #[arg(long, value_name = "DEGREES[xFRAMES]", allow_hyphen_values = true, conflicts_with_all = ["next", "camera_next", "view_next"])]
    #[serde(default)]
    pub orbit: Option<Orbit>,
    /// Move through the cameras of this file, in their order
    #[arg(long, value_name = "CAM", conflicts_with_all = ["orbit", "camera", "next", "camera_next", "view_next"])]
    #[serde(default)]
    pub path: Option<PathBuf>,
    /// Folder to write into, created if missing; with a moving camera also a video file
    #[arg(long, value_name = "DIR|VIDEO")]
    pub out: PathBuf,
    /// Frames per second of the video
    #[arg(long, value_name = "RATE", default_value_t = default_fps(), value_parser = clap::value_parser!(u16).range(1..=1000))]
    #[serde(default = "default_fps")]
    pub fps: u16,
    /// Background colour: white, black, #rrggbb or R,G,B (0 to 255 each)
    #[arg(long, value_name = "COLOUR", default_value_t = black())]
    #[serde(default = "black")]
    pub background: Color,
    /// Convention for pixel coordinates of the flow
    #[arg(long, value_enum, default_value_t)]
    #[serde(default)]
    pub pixel_convention: Convention,
    /// Reduce the opacity of Gaussians smaller than a pixel, for Gaussians trained with antialiasing
    /// [default: as their file says]
    #[arg(long)]
    #[serde(default)]
    pub antialiased: bool,
    /// Sort the Gaussians along the ray of each pixel, to avoid popping when the camera moves
    #[arg(long)]
    #[serde(default)]
    pub sort_per_pixel: bool,
    /// Overwrite existing files in OUT
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

fn black() -> Color {
    Color([0; 3])
}

/// Convention for pixel coordinates.
#[derive(ValueEnum, Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Convention {
    /// ((ndc + 1) S - 1) / 2, the convention of the colour: flow and colour agree
    #[default]
    Splat,
    /// (ndc + 1) (S - 1) / 2, the SRFlow paper's: the flow is smaller by (S - 1) / S
    Paper,
}

/// What [`RasterizeJob`] has written.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
pub enum RasterizeReport {
    Frame(RenderedFrame),
    Path(RenderedPath),
}

/// One frame, in the files of a folder.
#[derive(Debug, Clone, Serialize)]
pub struct RenderedFrame {
    pub out: PathBuf,
    pub files: [&'static str; 7],
    pub width: usize,
    pub height: usize,
    pub gaussians: usize,
    /// Gaussians that can touch a pixel.
    pub visible: usize,
    /// Visible Gaussians whose next position is not in front of the next camera.
    pub without_displacement: usize,
    /// Number of blended (Gaussian, pixel) pairs.
    pub blended_pairs: u64,
    /// Pixels whose alpha is above one half.
    pub mask_pixels: usize,
    /// Length of the longest flow, not divided by alpha, in pixels.
    pub longest_flow: f32,
}

const FILES: [&str; 7] =
    ["color.png", "color.npy", "alpha.npy", "depth.npy", "mask.png", "flow.flo", "flow_normalized.flo"];

impl Report for RasterizeReport {}

impl fmt::Display for RasterizeReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Frame(frame) => {
                let RenderedFrame { out, width, height, gaussians, visible, longest_flow, .. } = frame;
                let (files, out) = (FILES.len(), out.display());
                writeln!(
                    f,
                    "{out}: {files} files of {width}x{height} pixels; {visible} of {gaussians} Gaussians visible, flow at most \
                     {longest_flow:.2} px long"
                )
            }
            Self::Path(path) => path.fmt(f),
        }
    }
}

impl Job for RasterizeJob {
    const NAME: &'static str = "rasterize";

    type Report = RasterizeReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<RasterizeReport> {
        let video = is_video(&self.out);
        let moves = self.orbit.is_some() || self.path.is_some();
        if video && !moves {
            wrong_settings!("{}: a video needs a moving camera: give `orbit` or `path`", self.out.display());
        }
        self.check_together()?;
        if !video {
            ensure_folder(&self.out)?;
        }
        let options = Options {
            background: self.background.map(|channel| f32::from(channel) / 255.0),
            convention: match self.pixel_convention {
                Convention::Splat => PixelConvention::Splat,
                Convention::Paper => PixelConvention::Paper,
            },
            sorting: if self.sort_per_pixel { Sorting::PerPixel } else { Sorting::Global },
            ..Options::default()
        };
        if !moves {
            return self.one_frame(&options).map(RasterizeReport::Frame);
        }
        let Scene { gaussians, up, .. } = Scene::open(self)?;
        let cameras = match (self.orbit, &self.path) {
            (Some(orbit), _) => self.cameras.orbit(orbit, &gaussians, up)?,
            (None, Some(file)) => self.cameras.path(file)?,
            (None, None) => Vec::new(),
        };
        let rendered = if video {
            path::write_video(&gaussians, &cameras, &options, &self.out, self.fps, self.force, watch)?
        } else {
            path::write_frames(&gaussians, &cameras, &options, &self.out, self.force, watch)?
        };
        Ok(RasterizeReport::Path(rendered))
    }
}

impl RasterizeJob {
    /// Fails where one setting would leave another without effect.
    fn check_together(&self) -> anyhow::Result<()> {
        if self.gaussians.is_some() && self.head.first.head.is_some() {
            wrong_settings!("`gaussians` and `head` cannot be used together");
        }
        if self.orbit.is_some() && self.path.is_some() {
            wrong_settings!("`orbit` and `path` cannot be used together");
        }
        let CameraArgs { camera_next, view_next, .. } = &self.cameras;
        let TwoPoses { timestep_next, action_units_next, .. } = &self.head;
        let has_next = self.next.is_some()
            || camera_next.is_some()
            || view_next.is_some()
            || timestep_next.is_some()
            || action_units_next.is_some();
        if has_next && (self.orbit.is_some() || self.path.is_some()) {
            wrong_settings!(
                "with `orbit` or `path` the next frame is that of the next camera: leave out settings of a next frame"
            );
        }
        Ok(())
    }

    fn one_frame(&self, options: &Options) -> anyhow::Result<RenderedFrame> {
        ensure_free(FILES.map(|name| self.out.join(name)), self.force)?;
        // Camera errors are reported before large files are read.
        let camera_next = self.cameras.next()?;
        let Scene { gaussians, moved, up } = Scene::open(self)?;
        let camera = self.cameras.first(&gaussians, up)?;

        create_folder(&self.out)?;

        let next = Next {
            gaussians: moved.as_ref().unwrap_or(&gaussians),
            camera: camera_next.as_ref().unwrap_or(&camera),
        };
        let options = Options { outputs: Outputs { depth_next: false, ..Outputs::ALL }, ..*options };
        let mut frame = Frame::new();
        Rasterizer::new().render(&gaussians, &camera, Some(next), &options, &mut frame)?;

        write(&frame, &self.out)?;
        if frame.statistics.without_displacement > 0 {
            log::warn!(
                "{} Gaussians are behind the next camera or nearer than 0.2 to it; they do not contribute to the flow",
                frame.statistics.without_displacement
            );
        }
        Ok(RenderedFrame::new(&self.out, &frame, gaussians.len()))
    }
}

/// What is rendered.
struct Scene {
    gaussians: Gaussians,
    /// Those of the next frame, if they move.
    moved: Option<Gaussians>,
    up: Up,
}

impl Scene {
    fn open(job: &RasterizeJob) -> anyhow::Result<Self> {
        if let Some((mut gaussians, moved)) = job.head.gaussians()? {
            gaussians.antialiased |= job.antialiased;
            return Ok(Self { gaussians, moved, up: Up::PlusY });
        }
        let Some(path) = &job.gaussians else { wrong_settings!("give `gaussians`, a file, or `head`") };
        if job.next.is_some() {
            for file in job.gaussians.iter().chain(&job.next) {
                ensure_ordered(file)?;
            }
        }
        let mut gaussians = read_gaussians(path)?;
        gaussians.antialiased |= job.antialiased;
        let moved = job.next.as_deref().map(read_gaussians).transpose()?;
        if let (Some(moved), Some(next)) = (&moved, &job.next) {
            ensure!(
                moved.len() == gaussians.len(),
                "{} holds {} Gaussians and {} holds {}: flow needs the same Gaussians in both, in the same order",
                path.display(),
                gaussians.len(),
                next.display(),
                moved.len()
            );
        }
        let up = SplatFormat::of(path).and_then(|format| format.up).unwrap_or(Up::PlusY);
        Ok(Self { gaussians, moved, up })
    }
}

/// Fails where Gaussians have lost their order, so that those of two files do not correspond.
fn ensure_ordered(file: &Path) -> anyhow::Result<()> {
    match SplatFormat::of(file).filter(|format| !format.keeps_order) {
        None => Ok(()),
        Some(format) => wrong_settings!(
            "{}: the Gaussians of a .{} file are sorted by their size, so there is no flow between two of them: give another format, such as .ply",
            file.display(),
            format.extension
        ),
    }
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

impl RenderedFrame {
    fn new(out: &Path, frame: &Frame, gaussians: usize) -> Self {
        Self {
            out: out.to_owned(),
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
}
