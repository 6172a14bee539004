//! Scores of held-out pictures, and errors of a mesh, as tables.

use srflow_avatar::capture::CaptureSplit;
use srflow_avatar::train::{Score, SplitScore};
use srflow_render::mesh_error::{MeshError, PartDistance};
use srflow_report::{Column, Row, Table};

/// What the columns of the tables are.
pub const SCORE_DEFINITIONS: &str = "PSNR of the whole picture is that of GaussianAvatars' metrics.py; the mean of the ratios of the three \
                                     channels is that of its train.py and its paper. SSIM has a window of 11 by 11 pixels.";

/// What a split holds out.
pub fn split_words(split: CaptureSplit) -> &'static str {
    match split {
        CaptureSplit::Train => "pictures for training",
        CaptureSplit::Val => "held-out camera",
        CaptureSplit::Test => "held-out timesteps",
    }
}

/// A row for each split.
pub fn split_table<'a>(splits: impl IntoIterator<Item = &'a SplitScore>) -> Table {
    let row = |split: &SplitScore| Row {
        name: format!("{} ({})", split_words(split.split), split.split),
        ..row(split.pictures, &split.mean)
    };
    Table { title: "Mean scores".to_owned(), rows: splits.into_iter().map(row).collect(), ..empty_table() }
}

/// A row for each camera of a split.
pub fn camera_table(split: &SplitScore) -> Table {
    let row = |camera: &srflow_avatar::train::CameraScore| Row {
        name: format!("camera {}", camera.camera),
        ..row(camera.pictures, &camera.mean)
    };
    let title = format!("Mean scores by camera, {}", split_words(split.split));
    Table { title, rows: split.cameras.iter().map(row).collect(), ..empty_table() }
}

/// A row for each part of the head.
pub fn mesh_table(error: &MeshError) -> Table {
    let row = |part: &PartDistance| {
        let any = [part.mean_mm, part.percentile_95_mm];
        let normal = [part.normal_mean_mm, part.normal_percentile_95_mm];
        let aligned = [part.aligned_mean_mm, part.aligned_percentile_95_mm];
        let values = [&any[..], &normal, &aligned, &[part.motion_px]].concat();
        let values = values.into_iter().map(|value| Some(value).filter(|value| value.is_finite())).collect();
        Row { name: part.part.to_string(), values, baseline: false }
    };
    Table {
        title: format!("Distance of the mesh from the true one, mm (timesteps: {})", error.timesteps),
        columns: vec![
            Column::plain("mean_mm", "mean", 2),
            Column::plain("percentile_95_mm", "95 %", 2),
            Column::plain("normal_mean_mm", "along the normal, mean", 2),
            Column::plain("normal_percentile_95_mm", "95 %", 2),
            Column::plain("aligned_mean_mm", "aligned, mean", 2),
            Column::plain("aligned_percentile_95_mm", "95 %", 2),
            Column::plain("motion_px", "motion, px", 3),
        ],
        rows: error.parts.iter().map(row).collect(),
        notes: vec![
            "Between corresponding points, over the whole surface; along the normal: what is left if points may slide along it; \
             aligned: along the normal, after the skin was moved, turned and scaled onto the true one."
                .to_owned(),
        ],
        ..Table::default()
    }
}

fn row(pictures: usize, Score { psnr, psnr_channels, ssim }: &Score) -> Row {
    let values = [pictures as f64, *psnr, *psnr_channels, *ssim].map(Some).to_vec();
    Row { name: String::new(), values, baseline: false }
}

fn empty_table() -> Table {
    let columns = vec![
        Column::plain("pictures", "pictures", 0),
        Column::plain("psnr", "PSNR, whole picture", 2),
        Column::plain("psnr_channels", "PSNR, mean of channels", 2),
        Column::plain("ssim", "SSIM", 4),
    ];
    Table { columns, ..Table::default() }
}
