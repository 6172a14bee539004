use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_avatar::capture::{Capture, CaptureView, HeadRecord, LANDMARKS_NAME, Landmarks, write_tracked};
use srflow_avatar::fit::{FitError, FitOptions, FitReport, FitStage, LandmarkView, Reach, fit};
use srflow_avatar::{HeadModel, HeadPose, HeadSource};
use srflow_core::excerpts;
use srflow_files::{create_folder, write_file};
use srflow_render::capture::TrueCapture;
use srflow_render::mesh_error::{MeshError, mesh_error};

use super::paths::from_to;
use super::scores::mesh_table;
use crate::Context;
use crate::commands::render::head_help;
use crate::output::{ensure_folder, ensure_free, print_json, print_tables};
use crate::progress::bar;
use crate::usage::wrong_usage;

/// Fit a head model to the landmarks of a capture
///
/// Identity, and expressions, joint rotations and translation at every timestep, from the 68 landmarks of dlib in pictures of
/// any number of calibrated cameras. Missing pictures and landmarks and wrong detections are survived and reported. Writes a
/// capture as VHAP exports it, whose pictures stay where they are. docs/reference/avatar-files.md describes the files.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow avatar fit capture --model builtin-average --out fitted
  srflow avatar fit capture --model ict:FaceXModel --landmarks-of 8=openface.csv --cameras 8 --out front")]
pub struct Fit {
    /// Folder of the capture: transforms.json or transforms_train.json with its cameras, and landmarks.csv
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Head model
    #[arg(long, value_name = "HEAD", help = head_help())]
    model: HeadSource,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Landmarks: a table as landmarks.csv, or a folder of iBUG's .pts named as the pictures (default: DATA/landmarks.csv)
    #[arg(long, value_name = "PATH", conflicts_with = "landmarks_of")]
    landmarks: Option<PathBuf>,
    /// Landmarks of one camera as written by OpenFace, or by MediaPipe as columns x_0, y_0, ...; may be repeated
    #[arg(long, value_name = "CAMERA=FILE")]
    landmarks_of: Vec<TableOf>,
    /// Use these cameras alone
    #[arg(long, value_name = "N,N,...", value_delimiter = ',')]
    cameras: Vec<u32>,
    /// Standard deviation of the landmarks' coordinates in pixels (default: estimated)
    #[arg(long, value_name = "PIXELS")]
    noise: Option<f64>,
    /// Fit at most this many shapes of the identity basis
    #[arg(long, value_name = "N", default_value_t = FitOptions::default().identities)]
    identities: usize,
    /// Fit at most this many shapes of the expression basis
    #[arg(long, value_name = "N", default_value_t = FitOptions::default().expressions)]
    expressions: usize,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Compare the mesh with that of the true head, which `srflow avatar capture` wrote into this folder: DATA, if that is it
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Overwrite an earlier fit in the folder
    #[arg(long)]
    force: bool,
}

/// `CAMERA=FILE`.
#[derive(Debug, Clone)]
struct TableOf {
    camera: u32,
    file: PathBuf,
}

impl FromStr for TableOf {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').filter(|(_, file)| !file.is_empty());
        let table =
            parts.and_then(|(camera, file)| Some(Self { camera: camera.parse().ok()?, file: file.into() }));
        table.ok_or_else(|| {
            format!("`{text}`: expected the number of a camera and a file, such as 8=front.csv")
        })
    }
}

/// What `fit.json` and `--json` hold.
#[derive(Serialize)]
struct Summary {
    data: PathBuf,
    model: String,
    out: PathBuf,
    timesteps: usize,
    cameras: usize,
    pictures: usize,
    /// Landmarks of pictures that the capture does not have.
    unused_faces: usize,
    /// Where the origin of the written files was in those of the capture, metres.
    origin: [f64; 3],
    #[serde(flatten)]
    report: FitReport,
    #[serde(skip)]
    has_truth: bool,
    /// `None` without a true head, or where that has another mesh.
    mesh_error: Option<MeshError>,
}

const FIT_NAME: &str = "fit.json";

pub fn run(args: Fit, context: &Context) -> anyhow::Result<()> {
    ensure_folder(&args.out)?;
    if args.noise.is_some_and(|noise| !(noise > 0.0 && noise.is_finite())) {
        wrong_usage!("--noise: expected a number of pixels above 0");
    }
    ensure_free([args.out.join("transforms.json")], args.force)?;
    let capture = Capture::read(&args.data)?;
    if same_folder(&args.out, &args.data) {
        wrong_usage!(
            "--out: expected another folder than that of the capture, whose parameters would be overwritten"
        );
    }
    let landmarks = landmarks(&args, &capture)?;
    let truth = args.truth.as_deref().map(TrueCapture::read).transpose().context("--truth")?;
    let model = args.model.model(args.seed).with_context(|| format!("reading {}", args.model))?;

    let used: Vec<&CaptureView> = capture
        .views()
        .iter()
        .filter(|view| args.cameras.is_empty() || args.cameras.contains(&view.camera_index))
        .collect();
    if let Some(unknown) = args.cameras.iter().find(|camera| !capture.camera_indices().contains(camera)) {
        wrong_usage!("--cameras {unknown}: the capture has the cameras {:?}", capture.camera_indices());
    }
    let faces: Vec<LandmarkView> = used
        .iter()
        .map(|view| LandmarkView {
            timestep: view.timestep,
            camera_index: view.camera_index,
            camera: view.camera,
            landmarks: landmarks.get(view.timestep, view.camera_index).copied().unwrap_or([None; 68]),
        })
        .collect();
    let known =
        capture.views().iter().filter(|view| landmarks.get(view.timestep, view.camera_index).is_some());
    let unused_faces = landmarks.len() - known.count();
    let options = FitOptions {
        identities: args.identities,
        expressions: args.expressions,
        noise: args.noise,
        ..FitOptions::default()
    };
    let fitted = fit_with_progress(&model, &faces, &options)?;

    create_folder(&args.out)?;
    let up = from_to(&args.out, capture.dir())?;
    let views: Vec<CaptureView> = used
        .into_iter()
        .map(|view| CaptureView {
            image: up.join(&view.image),
            mask: view.mask.as_ref().map(|mask| up.join(mask)),
            ..view.clone()
        })
        .collect();
    let record = HeadRecord::new(args.model.to_string(), args.seed, &model);
    let parameters = fitted.parameters(&model);
    let origin = write_tracked(&args.out, &model, &record, &views, &fitted.timesteps, parameters)?;
    let mesh_error = match &truth {
        None => None,
        Some(truth) => {
            let written = Capture::read(&args.out)?;
            let parameters = written.parameters()?;
            let poses: Vec<HeadPose> = parameters.poses.iter().map(|pose| pose.pose(&model)).collect();
            mesh_error(truth, &written, &model, &model.shaped(&parameters.shape), &poses)
        }
    };
    let summary = Summary {
        data: args.data,
        model: args.model.to_string(),
        out: args.out,
        timesteps: fitted.timesteps.len(),
        cameras: fitted.report.cameras.len(),
        pictures: faces.len(),
        unused_faces,
        origin: origin.to_array(),
        report: fitted.report,
        has_truth: truth.is_some(),
        mesh_error,
    };
    write_file(&summary.out.join(FIT_NAME), serde_json::to_string_pretty(&summary)? + "\n")?;
    if context.json { print_json(&summary) } else { print_summary(&summary) }
}

fn landmarks(args: &Fit, capture: &Capture) -> anyhow::Result<Landmarks> {
    if args.landmarks_of.is_empty() {
        let path = args.landmarks.clone().unwrap_or_else(|| args.data.join(LANDMARKS_NAME));
        let read = if path.is_dir() { Landmarks::read_points(&path) } else { Landmarks::read(&path) };
        let advice = "the landmarks of the capture; --landmarks and --landmarks-of read those of detectors";
        return read.context(advice);
    }
    let mut landmarks = Landmarks::default();
    for TableOf { camera, file } in &args.landmarks_of {
        let Some(view) = capture.views().iter().find(|view| view.camera_index == *camera) else {
            wrong_usage!(
                "--landmarks-of {camera}=: the capture has the cameras {:?}",
                capture.camera_indices()
            );
        };
        landmarks.add_table(file, *camera, (view.camera.width, view.camera.height))?;
    }
    Ok(landmarks)
}

fn fit_with_progress(
    model: &HeadModel,
    faces: &[LandmarkView],
    options: &FitOptions,
) -> Result<srflow_avatar::fit::Fit, FitError> {
    let bar = bar(1, "{msg} {bar:30} {pos}/{len}");
    let fitted = fit(model, faces, options, |stage, done, steps| {
        bar.set_message(match stage {
            FitStage::First => "first timestep",
            FitStage::Track => "tracking",
            FitStage::Refine => "all timesteps together",
        });
        bar.set_length(steps as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    fitted
}

fn same_folder(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

fn print_summary(summary: &Summary) -> anyhow::Result<()> {
    let Summary { timesteps, cameras, pictures, unused_faces, report, out, .. } = summary;
    let share = 100.0 * report.outliers as f64 / report.landmarks.max(1) as f64;
    say!(
        "Fitted timesteps: {timesteps}, pictures: {pictures}, cameras: {cameras}; written to {}",
        out.display()
    )?;
    say!(
        "{} landmarks, {} missing, {} outliers ({share:.1} %), noise {:.2} px",
        report.landmarks,
        report.missing,
        report.outliers,
        report.noise
    )?;
    for camera in &report.cameras {
        say!(
            "  camera {:>2}: {} landmarks, {} outliers, median distance {:.2} px",
            camera.camera_index,
            camera.landmarks,
            camera.outliers,
            camera.median
        )?;
    }
    if *unused_faces > 0 {
        say!(
            "The landmarks of {unused_faces} pictures were not used: the capture has no such timestep and camera."
        )?;
    }
    if !report.empty_timesteps.is_empty() {
        let names: Vec<String> = report.empty_timesteps.iter().map(u32::to_string).collect();
        say!("Without landmarks, following from their neighbours: timesteps {}", listed(&names))?;
    }
    if !report.suspect_views.is_empty() {
        let names =
            report.suspect_views.iter().map(|view| format!("{:05}_{:02}", view.timestep, view.camera_index));
        say!("Most landmarks are outliers in pictures {}", listed(&names.collect::<Vec<_>>()))?;
    }
    print_reach(&report.reach)?;
    if let Some(error) = &summary.mesh_error {
        say!("")?;
        print_tables(&[mesh_table(error)])?;
    } else if summary.has_truth {
        say!(
            "The true head has another mesh than {}: no points correspond, and no distance is known.",
            summary.model
        )?;
    }
    Ok(())
}

fn print_reach(reach: &Reach) -> anyhow::Result<()> {
    let Reach { timestep, cameras, depth, across, eye_corners: [corners, deviation], .. } = reach;
    let millimetres = |metres: f64| 1000.0 * metres;
    say!(
        "At timestep {timestep}, if the model can be this head: place known to {:.1} mm in depth and {:.1} mm across; outer corners \
         of the eyes {:.1} mm apart, known to {:.1} mm",
        millimetres(*depth),
        millimetres(*across),
        millimetres(*corners),
        millimetres(*deviation)
    )?;
    if *cameras == 1 {
        say!(
            "One camera sees no scale: size and distance of the head follow from what heads the model finds likely."
        )?;
    }
    for (what, unknown, of) in [
        ("identity weights", &reach.unknown_identities, Some(reach.identities)),
        ("expression weights", &reach.unknown_expressions, Some(reach.expressions)),
        ("joints", &reach.unknown_joints, None),
    ] {
        if !unknown.is_empty() {
            let of = of.map(|of| format!(" ({} of {of})", unknown.len())).unwrap_or_default();
            say!("Not determined by the landmarks: {what}{of}: {}", listed(unknown))?;
        }
    }
    Ok(())
}

fn listed(names: &[String]) -> String {
    excerpts(names.iter().map(String::as_str), 12)
}
