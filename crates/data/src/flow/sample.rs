//! Decoding one pair.

use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Image, Labels, Mask, Plane, Size};

use super::entry::{Entry, Occlusion};
use super::error::DatasetError;
use super::file::{EntryFile, Opened};
use crate::region_map::check_region_map;

/// One decoded pair of frames; all parts have the same size.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    pub frame1: Image,
    pub frame2: Image,
    /// True flow from frame 1 to frame 2 in pixels, NaN where unknown; `None` when no truth is published.
    pub flow: Option<FlowField>,
    /// `true` on the head in frame 1, if the dataset has masks.
    pub mask: Option<Mask>,
    /// `true` where a pixel of frame 1 is occluded in frame 2 or leaves the image, if the dataset has occlusions.
    pub occlusion: Option<Mask>,
}

/// Validity and resolution of the published ground truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Truth {
    /// A pixel with `|u|` or `|v|` at or above this is unknown, in pixels.
    pub max_flow: f32,
    /// Flow samples per image pixel along each axis; the top left one of each block is used.
    pub samples_per_pixel: usize,
    pub density: TruthDensity,
}

/// Density of the ground truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TruthDensity {
    /// Nearly all pixels.
    Dense,
    /// Some pixels, measured by a laser scanner or a tracker (KITTI, HD1K).
    Sparse,
}

impl Truth {
    /// The rule of ptlflow 0.4.2 (data/datasets.py, `BaseFlowDataset`).
    pub const USUAL: Self = Self { max_flow: 10_000.0, samples_per_pixel: 1, density: TruthDensity::Dense };
}

/// What a file says about occlusion.
enum Hidden {
    Mask(Mask),
    /// The flow of the pixels that are visible.
    VisibleFlow(FlowField),
}

impl Truth {
    /// Decodes the files of one pair, with the threads of the current rayon pool.
    pub fn read(self, entry: &Entry) -> Result<Sample, DatasetError> {
        let occlusion = entry.occlusion.as_ref().map(Occlusion::file);
        let optional = [entry.flow.as_ref(), entry.mask.as_ref(), occlusion].into_iter().flatten();
        let files = Opened::of([&entry.frame1, &entry.frame2].into_iter().chain(optional))?;
        let frame = |file| files.image(file);
        let ((frame1, frame2), (flow, (mask, occlusion))) = rayon::join(
            || rayon::join(|| frame(&entry.frame1), || frame(&entry.frame2)),
            || {
                let masks = || {
                    let mask = entry.mask.as_ref().map(|file| files.mask(file));
                    let occlusion = entry.occlusion.as_ref().map(|occlusion| match occlusion {
                        Occlusion::Picture(file) => files.mask(file).map(Hidden::Mask),
                        Occlusion::VisibleFlow(file) => files.flow(file).map(Hidden::VisibleFlow),
                    });
                    (mask, occlusion)
                };
                rayon::join(|| entry.flow.as_ref().map(|file| files.flow(file)), masks)
            },
        );
        // Of several files that are broken, the first is reported.
        let frame1 = frame1?;
        let size = frame1.size();
        let fits = |file: &EntryFile, found: Size, samples: usize| {
            let expected = Size::new(size.width * samples, size.height * samples);
            if found == expected {
                return Ok(());
            }
            Err(DatasetError::SizeMismatch { path: file.path(), found, frame: entry.frame1.path(), expected })
        };
        let frame2 = frame2?;
        fits(&entry.frame2, frame2.size(), 1)?;

        let truth = |file: &EntryFile, published: FlowField| {
            fits(file, published.size(), self.samples_per_pixel)?;
            Ok::<_, DatasetError>(self.counted(published, size))
        };
        let flow = entry.flow.as_ref().zip(flow).map(|(file, found)| truth(file, found?)).transpose()?;
        let mask = mask.transpose()?;
        let occlusion = match (&entry.occlusion, occlusion.transpose()?, &flow) {
            (Some(occlusion), Some(Hidden::VisibleFlow(visible)), Some(flow)) => {
                Some(hidden(flow, &truth(occlusion.file(), visible)?))
            }
            (_, Some(Hidden::Mask(mask)), _) => Some(mask),
            (_, Some(Hidden::VisibleFlow(_)) | None, _) => None,
        };
        if let (Some(path), Some(mask)) = (&entry.mask, &mask) {
            fits(path, mask.size(), 1)?;
        }
        if let (Some(Occlusion::Picture(path)), Some(occlusion)) = (&entry.occlusion, &occlusion) {
            fits(path, occlusion.size(), 1)?;
        }
        Ok(Sample { frame1, frame2, flow, mask, occlusion })
    }

    /// The published flow on the image's grid, unknown where it is not valid.
    fn counted(self, published: FlowField, Size { width, height }: Size) -> FlowField {
        let mut flow = match self.samples_per_pixel {
            1 => published,
            step => FlowField::from_fn(width, height, |x, y| published.get(x * step, y * step)),
        };
        for pixel in flow.pixels_mut() {
            if !pixel.iter().all(|component| component.abs() < self.max_flow) {
                *pixel = [f32::NAN; 2];
            }
        }
        flow
    }
}

impl Entry {
    /// Decodes the [region map](crate::region_map) of frame 1; `None` when there is none. It is not a part of [`Sample`], since few
    /// readers of samples need it.
    ///
    /// # Errors
    /// When the file cannot be read, is no region map, or has another size than frame 1.
    pub fn read_regions(&self) -> Result<Option<Labels>, DatasetError> {
        let Some(file) = &self.regions else { return Ok(None) };
        let files = Opened::of([file, &self.frame1])?;
        let map = files.labels(file)?;
        check_region_map(&map).map_err(|problem| problem.in_file(&file.path()))?;
        self.check_size(&files, file, map.size())?;
        Ok(Some(map))
    }

    /// Decodes the true flow from frame 1 to frame 2 with the head moving alone, by its rotation, translation and camera, its face as in
    /// frame 1, in pixels, NaN where unknown; `None` when there is none.
    ///
    /// # Errors
    /// When the file cannot be read, or has another size than frame 1.
    pub fn read_head_flow(&self) -> Result<Option<FlowField>, DatasetError> {
        self.read_part(self.head_flow.as_deref())
    }

    /// As [`Entry::read_head_flow`], what the motion of the face adds to it: the two add up to the true flow.
    ///
    /// # Errors
    /// Those of [`Entry::read_head_flow`].
    pub fn read_expression_flow(&self) -> Result<Option<FlowField>, DatasetError> {
        self.read_part(self.expression_flow.as_deref())
    }

    fn read_part(&self, file: Option<&EntryFile>) -> Result<Option<FlowField>, DatasetError> {
        let Some(file) = file else { return Ok(None) };
        let files = Opened::of([file, &self.frame1])?;
        let flow = files.flow(file)?;
        self.check_size(&files, file, flow.size())?;
        let size = flow.size();
        Ok(Some(Truth::USUAL.counted(flow, size)))
    }

    /// Decodes the depth of frame 1 in metres, 0 where there is none (16-bit grey PNG in tenths of a millimetre, as `srflow render
    /// --depth` writes it); `None` when there is no file.
    ///
    /// # Errors
    /// When the file cannot be read, is no 16-bit grey picture, or has another size than frame 1.
    pub fn read_depth(&self) -> Result<Option<Plane>, DatasetError> {
        let Some(file) = &self.depth else { return Ok(None) };
        let files = Opened::of([file, &self.frame1])?;
        let depth = files.grey16(file)?;
        self.check_size(&files, file, depth.size())?;
        Ok(Some(Plane::from_fn(depth.width(), depth.height(), |x, y| depth.get(x, y) * 1e-4)))
    }

    /// Size of frame 1.
    ///
    /// # Errors
    /// When its file cannot be read, or its header is corrupt.
    pub fn read_size(&self) -> Result<Size, DatasetError> {
        Opened::of([&self.frame1])?.image_size(&self.frame1)
    }

    fn check_size(&self, files: &Opened, file: &EntryFile, found: Size) -> Result<(), DatasetError> {
        let expected = files.image_size(&self.frame1)?;
        if found == expected {
            return Ok(());
        }
        let [path, frame] = [file, &self.frame1].map(|file| file.path());
        Err(DatasetError::SizeMismatch { path, found, frame, expected })
    }
}

/// Pixels whose flow is known but not among the visible ones.
fn hidden(flow: &FlowField, visible: &FlowField) -> Mask {
    Mask::from_fn(flow.width(), flow.height(), |x, y| flow.is_known(x, y) && !visible.is_known(x, y))
}
