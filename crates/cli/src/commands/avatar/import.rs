use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;
use srflow_avatar::capture::{
    CaptureSplit, CaptureView, ImportRequest, Imported, PicturePattern, import, write_transforms,
};
use srflow_core::excerpts;
use srflow_files::create_folder;

use super::paths::from_to;
use crate::Context;
use crate::output::{ensure_folder, ensure_free, print_json};
use crate::usage::wrong_usage;

/// Make a capture from pictures in folders and a file of their cameras
///
/// Writes the lists of a capture as VHAP exports it; the pictures stay where they are. Camera 8, or else the last one, and the last 30 % of
/// the timesteps are held out. `srflow avatar fit` adds a head. docs/reference/avatar-files.md describes the files.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow avatar import video --pattern 'cam_{camera}/frame_{timestep}' --cameras camera_params.json --out capture
  srflow avatar import frames --pattern '{timestep}_{camera}.png' --cameras colmap/sparse/0 --metres-per-unit 0.21 --out capture

Cameras: camera_params.json of NeRSemble, a COLMAP model, cameras.json of 3D Gaussian Splatting, or transforms.json, whose cameras are
named as in the pictures.")]
pub struct Import {
    /// Folder of the pictures
    #[arg(value_name = "PICTURES")]
    pictures: PathBuf,
    /// How pictures are named below PICTURES, with {camera} and {timestep}; without an ending, PNG and JPEG
    #[arg(long, value_name = "PATTERN")]
    pattern: PicturePattern,
    /// How masks are named below PICTURES, white where the head is
    #[arg(long, value_name = "PATTERN")]
    masks: Option<PicturePattern>,
    /// File of the cameras, or folder of a COLMAP model
    #[arg(long, value_name = "FILE")]
    cameras: PathBuf,
    /// Metres in a unit of the cameras: heads have sizes in metres
    #[arg(long, value_name = "METRES", default_value_t = 1.0)]
    metres_per_unit: f64,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite the lists in the folder
    #[arg(long)]
    force: bool,
}

pub fn run(args: Import, context: &Context) -> anyhow::Result<()> {
    ensure_folder(&args.out)?;
    let unit = args.metres_per_unit;
    if !(unit > 0.0 && unit.is_finite()) {
        wrong_usage!("--metres-per-unit: expected a number above 0");
    }
    ensure_free([args.out.join("transforms.json")], args.force)?;
    let request = ImportRequest {
        pictures: &args.pictures,
        pattern: &args.pattern,
        masks: args.masks.as_ref(),
        cameras: &args.cameras,
        unit,
    };
    let imported = import(&request)?;
    create_folder(&args.out)?;
    let below = from_to(&args.out, &args.pictures)?;
    let moved = |path: &Path| below.join(path);
    let views: Vec<CaptureView> = imported
        .views
        .iter()
        .map(|view| CaptureView {
            image: moved(&view.image),
            mask: view.mask.as_deref().map(moved),
            ..view.clone()
        })
        .collect();
    write_transforms(&args.out, &views)?;
    print(&args, &imported, context)
}

fn print(args: &Import, imported: &Imported, context: &Context) -> anyhow::Result<()> {
    let Imported { views, cameras, unknown_cameras, unused_cameras, without_mask, distorted } = imported;
    let mut timesteps: Vec<u32> = views.iter().map(|view| view.timestep).collect();
    timesteps.dedup();
    let of = |split: CaptureSplit| views.iter().filter(|view| view.split == split).count();
    let [train, val, test] = CaptureSplit::ALL.map(of);
    if context.json {
        return print_json(&json!({
            "out": args.out,
            "pictures": views.len(),
            "timesteps": timesteps.len(),
            "cameras": cameras.iter().map(|(index, name)| (index.to_string(), name.as_str())).collect::<BTreeMap<_, _>>(),
            "unknown_cameras": unknown_cameras,
            "unused_cameras": unused_cameras,
            "without_mask": without_mask,
            "train": train,
            "val": val,
            "test": test,
        }));
    }
    let listed = |names: &[String]| excerpts(names.iter().map(String::as_str), 16);
    say!(
        "{} pictures of {} cameras at {} timesteps: {train} for training, {val} of a held-out camera, {test} of held-out timesteps",
        views.len(),
        cameras.len(),
        timesteps.len()
    )?;
    let numbered: Vec<String> = cameras.iter().map(|(index, name)| format!("{index}: {name}")).collect();
    say!("Cameras: {}", listed(&numbered))?;
    if !unknown_cameras.is_empty() {
        say!("Left out, since {} lacks them: cameras {}", args.cameras.display(), listed(unknown_cameras))?;
    }
    if !unused_cameras.is_empty() {
        say!("Without pictures: cameras {}", listed(unused_cameras))?;
    }
    if *without_mask > 0 {
        say!("Without a mask: {without_mask} pictures")?;
    }
    if let Some((camera, how)) = distorted {
        say!(
            "The lens of camera {camera} distorts ({how}): the pictures must be undistorted, as by `colmap image_undistorter`"
        )?;
    }
    say!(
        "Written to {}; landmarks.csv there, or --landmarks, is what srflow avatar fit needs",
        args.out.display()
    )
}
