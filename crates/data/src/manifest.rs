//! `dataset.json`: everything needed to read an SRFlow dataset and to render it again.
//!
//! The layout is that of a plain folder of scenes, once per split:
//!
//! ```text
//! dataset.json                                 this file
//! statistics.json                              once the dataset is complete
//! train/frames/scene-0003/00000.png            frame 0 of scene 3
//! train/flow/scene-0003/00000.npz16            flow from frame 0 to frame 1
//! train/flow_backward/scene-0003/00000.npz16   flow from frame 1 to frame 0, at frame 1's pixels (--backward)
//! train/head_flow/scene-0003/00000.npz16       flow with the head moving alone, its face as in frame 0 (--decompose)
//! train/expression_flow/scene-0003/00000.npz16 what the face adds to it: the two add up to the flow (--decompose)
//! train/shading_change/scene-0003/00000.png    change of brightness from frame 0 to frame 1 that is no motion (--shading-change)
//! train/alpha/scene-0003/00000.png             alpha of frame 0
//! train/mask/scene-0003/00000.png              alpha of frame 0 above one half
//! train/occlusion/scene-0003/00000.png         pixels of frame 0 that are not visible in frame 1
//! train/depth/scene-0003/00000.png             depth of frame 0 (--depth)
//! train/regions/scene-0003/00000.png           parts of the head in frame 0 (--regions)
//! train/pairs/scene-0003/00000.json            cameras, motion and action units of frames 0 and 1; written last
//! ```
//!
//! A scene of `n` pairs has `n + 1` frames, alphas, masks, depths and region maps, and `n` of everything else.

mod recording;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_core::Size;
use srflow_core::excerpt;
use srflow_files::{FileError, FileKind, FlowFormat, read_text};

pub use recording::Recording;
pub use srflow_pack::SceneSplit;

/// Name of the file in the dataset's folder.
pub const MANIFEST_NAME: &str = "dataset.json";

/// Name of the file with a dataset's statistics.
pub const STATISTICS_NAME: &str = "statistics.json";

/// Version of the layout and of this file's fields.
pub const LAYOUT_VERSION: u32 = 1;

/// Names of the folders of optional flow, which are also its fields in packed datasets.
const BACKWARD: &str = "flow_backward";
const HEAD_FLOW: &str = "head_flow";
const EXPRESSION_FLOW: &str = "expression_flow";
/// Also its field in packed datasets.
const SHADING_CHANGE: &str = "shading_change";

/// The contents of `dataset.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`LAYOUT_VERSION`] of the program that wrote the dataset.
    pub layout_version: u32,
    /// Version of srflow that wrote the dataset; another version may write other bytes.
    pub srflow_version: String,
    pub arguments: Arguments,
    /// The calibrated cameras. Sequences start and end with camera 9, which faces the subject.
    pub rig: Vec<RigCamera>,
    /// The scenes, by number.
    pub scenes: Vec<SceneEntry>,
}

/// The arguments that determine a dataset's bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Arguments {
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    /// File format of the flow; see [`FlowFormat`].
    pub flow_format: String,
    /// Whether there is backward flow.
    pub backward: bool,
    /// Whether there are depth maps.
    pub depth: bool,
    /// Whether there is the flow of the head and that of the expression.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub decompose: bool,
    /// Whether there is the change of brightness that is no motion.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub shading_change: bool,
    /// Whether there are [region maps](crate::region_map).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub regions: bool,
    /// The other settings of the job that rendered the dataset, which readers do not need. Where a setting names files, it is their
    /// kind with a fingerprint.
    #[serde(flatten)]
    pub others: serde_json::Map<String, serde_json::Value>,
}

impl Arguments {
    /// From the settings of the job as JSON and the `size` of the frames, which takes the place of the field `size`.
    ///
    /// # Errors
    /// When the settings lack what every dataset has.
    pub fn of_settings(mut settings: serde_json::Value, size: Size) -> Result<Self, serde_json::Error> {
        settings["width"] = size.width.into();
        settings["height"] = size.height.into();
        if let Some(settings) = settings.as_object_mut() {
            settings.remove("size");
        }
        serde_json::from_value(settings)
    }

    /// The settings of the job, with `size` in place of width and height.
    ///
    /// # Errors
    /// When a number is not finite.
    pub fn settings(&self) -> Result<serde_json::Value, serde_json::Error> {
        let mut settings = serde_json::to_value(self)?;
        settings["size"] = Size { width: self.width, height: self.height }.to_string().into();
        if let Some(settings) = settings.as_object_mut() {
            settings.retain(|name, _| name != "width" && name != "height");
        }
        Ok(settings)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RigCamera {
    /// Its number, from 1.
    pub number: u32,
    /// Intrinsics and extrinsics.
    #[serde(flatten)]
    pub camera: CameraRecord,
}

/// A camera as stored in files: the fields of `cam.json`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraRecord {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Horizontal focal length in pixels.
    pub fx: f64,
    /// Vertical focal length in pixels.
    pub fy: f64,
    /// Column of the principal point in pixels.
    pub cx: f64,
    /// Row of the principal point in pixels.
    pub cy: f64,
    /// Camera from world, 4x4, by rows.
    pub w2c: [[f64; 4]; 4],
}

/// One scene: a subject in motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneEntry {
    /// Name of its folders, e.g. `scene-0003`.
    pub name: String,
    pub split: SceneSplit,
    /// Seed of the subject's identity.
    pub subject: u64,
    /// Number of frame pairs; there is one more frame.
    pub pairs: u32,
    /// File name of the background image, when backgrounds are images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub background: Option<String>,
}

/// The files of one pair, as paths inside the dataset's folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PairFiles {
    /// First frame, sRGB PNG.
    pub frame1: PathBuf,
    pub frame2: PathBuf,
    /// Flow from frame 1 to frame 2.
    pub flow: PathBuf,
    /// Flow from frame 2 to frame 1, at frame 2's pixels.
    pub flow_backward: Option<PathBuf>,
    /// Flow from frame 1 to frame 2 with the head moving alone.
    pub head_flow: Option<PathBuf>,
    /// What the face adds to it.
    pub expression_flow: Option<PathBuf>,
    /// How much brighter the surface at each pixel of frame 1 is in frame 2: 16-bit PNG, 32768 and 128 times the change of the luma in levels of
    /// 255.
    pub shading_change: Option<PathBuf>,
    /// Alpha of frame 1, 8-bit PNG.
    pub alpha: PathBuf,
    /// Head mask of frame 1, 8-bit PNG, 0 or 255.
    pub mask: PathBuf,
    /// Pixels of frame 1 that are not visible in frame 2, 8-bit PNG, 0 or 255.
    pub occlusion: PathBuf,
    /// Depth of frame 1, 16-bit PNG.
    pub depth: Option<PathBuf>,
    /// [Region map](crate::region_map) of frame 1.
    pub regions: Option<PathBuf>,
    /// Cameras, motion and action units of both frames.
    pub record: PathBuf,
}

impl PairFiles {
    /// All files.
    pub fn all(&self) -> impl Iterator<Item = &PathBuf> {
        let of_frames = [&self.frame1, &self.frame2, &self.alpha, &self.mask];
        of_frames.into_iter().chain(self.of_pair()).chain(&self.depth).chain(&self.regions)
    }

    /// The files that are not those of one frame; the record first.
    pub fn of_pair(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.record, &self.flow, &self.occlusion]
            .into_iter()
            .chain(self.other_flows().map(|(_, path)| path))
            .chain(&self.shading_change)
    }

    /// The optional files of flow, with the names of their folders.
    pub fn other_flows(&self) -> impl Iterator<Item = (&'static str, &PathBuf)> {
        let optional = [
            (BACKWARD, &self.flow_backward),
            (HEAD_FLOW, &self.head_flow),
            (EXPRESSION_FLOW, &self.expression_flow),
        ];
        optional.into_iter().filter_map(|(kind, path)| Some((kind, path.as_ref()?)))
    }
}

/// The files of one frame, as paths inside the dataset's folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameFiles {
    /// The picture, sRGB PNG.
    pub frame: PathBuf,
    /// Alpha, 8-bit PNG.
    pub alpha: PathBuf,
    /// Head mask, 8-bit PNG, 0 or 255.
    pub mask: PathBuf,
    /// Depth, 16-bit PNG.
    pub depth: Option<PathBuf>,
    /// [Region map](crate::region_map), 8-bit PNG.
    pub regions: Option<PathBuf>,
}

impl FrameFiles {
    /// All files.
    pub fn all(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.frame, &self.alpha, &self.mask].into_iter().chain(&self.depth).chain(&self.regions)
    }
}

/// Errors of reading `dataset.json`.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The file is missing or could not be read.
    #[error("{0}; an SRFlow dataset has a dataset.json in its folder, which `srflow render` writes")]
    Read(#[source] FileError),
    /// The file does not have the format that `srflow render` writes.
    #[error("{}: {reason}", .path.display())]
    Content {
        path: PathBuf,
        /// The field, what was expected, and what was found.
        reason: String,
    },
}

impl Manifest {
    /// Reads `dataset.json` from the dataset's folder.
    ///
    /// # Errors
    /// When the file is missing, is not JSON with the expected fields, or names folders outside the dataset.
    pub fn read(dir: &Path) -> Result<Self, ManifestError> {
        let path = dir.join(MANIFEST_NAME);
        let text = read_text(&path, FileKind::Json).map_err(ManifestError::Read)?;
        let content = |reason| ManifestError::Content { path: path.clone(), reason };
        let broken = |reason: String| {
            content(format!(
                "{reason}; restore the file from a copy, or delete the folder and render the dataset again"
            ))
        };
        // The version is checked first, so that a later layout is not reported as a missing field.
        let value: serde_json::Value = serde_json::from_str(&text)
            .map_err(|error| broken(format!("not JSON: {}", excerpt(&error.to_string()))))?;
        match value.get("layout_version").and_then(serde_json::Value::as_u64) {
            Some(version) if version == u64::from(LAYOUT_VERSION) => {}
            Some(version) => {
                return Err(content(format!(
                    "layout_version is {version}, this program reads version {LAYOUT_VERSION}; use the version of srflow that wrote it"
                )));
            }
            None => {
                return Err(broken("no layout_version: not the dataset.json of an SRFlow dataset".into()));
            }
        }
        let manifest: Self = serde_json::from_value(value)
            .map_err(|error| broken(srflow_files::parse_error_in_words(&error)))?;
        manifest.validate().map_err(broken)?;
        Ok(manifest)
    }

    fn validate(&self) -> Result<(), String> {
        let plain =
            |name: &str| !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
        let Arguments { width, height, flow_format, .. } = &self.arguments;
        if *width == 0 || *height == 0 {
            return Err(format!("size {width}x{height}: expected at least 1x1"));
        }
        if let Err(error) = flow_format.parse::<FlowFormat>() {
            return Err(format!("flow_format: {error}"));
        }
        match self.scenes.iter().find(|scene| !plain(&scene.name)) {
            Some(scene) => {
                Err(format!("scene name `{}`: expected letters, digits and hyphens", excerpt(&scene.name)))
            }
            None => Ok(()),
        }
    }

    /// The scenes of one split, by number.
    pub fn scenes_of(&self, split: SceneSplit) -> impl Iterator<Item = &SceneEntry> {
        self.scenes.iter().filter(move |scene| scene.split == split)
    }

    /// Number of pairs in all scenes.
    pub fn pairs(&self) -> u64 {
        self.scenes.iter().map(|scene| u64::from(scene.pairs)).sum()
    }

    /// The folders of each split, one per kind of file.
    pub fn kinds(&self) -> impl Iterator<Item = &'static str> + use<> {
        let Arguments { backward, depth, decompose, shading_change, regions, .. } = self.arguments;
        let kinds = ["frames", "flow", "alpha", "mask", "occlusion", "pairs"];
        let optional = [
            (backward, BACKWARD),
            (depth, "depth"),
            (regions, "regions"),
            (decompose, HEAD_FLOW),
            (decompose, EXPRESSION_FLOW),
            (shading_change, SHADING_CHANGE),
        ];
        kinds.into_iter().chain(optional.into_iter().filter_map(|(has, kind)| has.then_some(kind)))
    }

    /// The files of pair `pair` (frames `pair` and `pair + 1`) of `scene`, in the dataset's folder `dir`. They need not exist.
    pub fn files(&self, dir: &Path, scene: &SceneEntry, pair: u32) -> PairFiles {
        let file = |kind: &str, ending: &str| file(dir, scene, kind, pair, ending);
        let FrameFiles { frame, alpha, mask, depth, regions } = self.frame_files(dir, scene, pair);
        let flow_ending = self.flow_ending();
        PairFiles {
            frame1: frame,
            frame2: self.frame_files(dir, scene, pair.saturating_add(1)).frame,
            flow: file("flow", flow_ending),
            flow_backward: self.arguments.backward.then(|| file(BACKWARD, flow_ending)),
            head_flow: self.arguments.decompose.then(|| file(HEAD_FLOW, flow_ending)),
            expression_flow: self.arguments.decompose.then(|| file(EXPRESSION_FLOW, flow_ending)),
            shading_change: self.arguments.shading_change.then(|| file(SHADING_CHANGE, "png")),
            alpha,
            mask,
            occlusion: file("occlusion", "png"),
            depth,
            regions,
            record: file("pairs", "json"),
        }
    }

    /// The files of frame `frame` of `scene`: a scene has one more frame than pairs.
    pub fn frame_files(&self, dir: &Path, scene: &SceneEntry, frame: u32) -> FrameFiles {
        let file = |kind: &str| file(dir, scene, kind, frame, "png");
        FrameFiles {
            frame: file("frames"),
            alpha: file("alpha"),
            mask: file("mask"),
            depth: self.arguments.depth.then(|| file("depth")),
            regions: self.arguments.regions.then(|| file("regions")),
        }
    }

    fn flow_ending(&self) -> &str {
        match self.arguments.flow_format.parse::<FlowFormat>() {
            Ok(format) => format.extension(),
            // `read` refuses an unknown format; for other manifests its name is the extension.
            Err(_) => &self.arguments.flow_format,
        }
    }
}

fn file(dir: &Path, scene: &SceneEntry, kind: &str, frame: u32, ending: &str) -> PathBuf {
    dir.join(scene.split.to_string()).join(kind).join(&scene.name).join(format!("{frame:05}.{ending}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Manifest {
        Manifest {
            layout_version: LAYOUT_VERSION,
            srflow_version: "0.1.0".into(),
            arguments: Arguments {
                width: 110,
                height: 160,
                flow_format: "flo".into(),
                backward: false,
                depth: true,
                decompose: true,
                shading_change: true,
                regions: true,
                others: [("head", "builtin".into()), ("seed", u64::MAX.into())]
                    .map(|(name, value): (&str, serde_json::Value)| (name.to_owned(), value))
                    .into_iter()
                    .collect(),
            },
            rig: vec![],
            scenes: vec![SceneEntry {
                name: "scene-0000".into(),
                split: SceneSplit::Train,
                subject: 1,
                pairs: 4,
                background: None,
            }],
        }
    }

    fn read(text: &str) -> Result<Manifest, String> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(MANIFEST_NAME), text).unwrap();
        Manifest::read(dir.path()).map_err(|error| error.to_string())
    }

    #[test]
    fn written_files_are_read_back() {
        let manifest = manifest();
        let text = serde_json::to_string_pretty(&manifest).unwrap();
        assert_eq!(read(&text).unwrap(), manifest);
    }

    #[test]
    fn a_dataset_without_regions_has_the_manifest_of_earlier_versions() {
        let mut without = manifest();
        without.arguments.regions = false;
        let text = serde_json::to_string(&without).unwrap();
        assert!(!text.contains("regions"), "{text}");
        assert_eq!(read(&text).unwrap(), without);
        assert!(!without.kinds().any(|kind| kind == "regions"));
        let files = without.files(Path::new("d"), &without.scenes[0], 3);
        assert_eq!(
            (files.regions, manifest().kinds().find(|kind| *kind == "regions")),
            (None, Some("regions"))
        );
    }

    #[test]
    fn a_dataset_without_parts_has_the_manifest_of_earlier_versions() {
        let mut without = manifest();
        without.arguments.decompose = false;
        let text = serde_json::to_string(&without).unwrap();
        assert!(!text.contains("decompose"), "{text}");
        assert_eq!(read(&text).unwrap(), without);
        assert!(without.kinds().all(|kind| kind != "head_flow" && kind != "expression_flow"));
        assert_eq!(without.files(Path::new("d"), &without.scenes[0], 3).other_flows().count(), 0);
        let with = manifest();
        let files = with.files(Path::new("d"), &with.scenes[0], 3);
        let expected =
            ["d/train/head_flow/scene-0000/00003.flo", "d/train/expression_flow/scene-0000/00003.flo"];
        assert_eq!(files.other_flows().map(|(_, path)| path).collect::<Vec<_>>(), expected.map(Path::new));
        assert!(
            files.other_flows().all(|(kind, path)| with.kinds().any(|known| known == kind)
                && files.all().any(|file| file == path))
        );
    }

    #[test]
    fn files_follow_the_layout() {
        let manifest = manifest();
        let files = manifest.files(Path::new("d"), &manifest.scenes[0], 3);
        assert_eq!(files.frame2, Path::new("d/train/frames/scene-0000/00004.png"));
        assert_eq!(files.flow, Path::new("d/train/flow/scene-0000/00003.flo"));
        assert_eq!(files.depth.as_deref(), Some(Path::new("d/train/depth/scene-0000/00003.png")));
        assert_eq!(files.regions.as_deref(), Some(Path::new("d/train/regions/scene-0000/00003.png")));
        assert_eq!(files.flow_backward, None);
        let last = manifest.frame_files(Path::new("d"), &manifest.scenes[0], 4);
        assert_eq!(last.mask, Path::new("d/train/mask/scene-0000/00004.png"));
        assert_eq!(last.frame, files.frame2);
    }

    #[test]
    fn errors_name_the_problem() {
        let error = |text: &str| read(text).unwrap_err();
        let not_json = error("{");
        assert!(not_json.contains("dataset.json: not JSON") && not_json.contains("restore the file"));
        assert!(error("{}").contains("no layout_version"));
        assert!(
            error(r#"{"layout_version": 9}"#).contains("layout_version is 9, this program reads version 1")
        );
        assert!(error(r#"{"layout_version": 1}"#).contains("missing key"));
        let mut outside = manifest();
        outside.scenes[0].name = "../../etc".into();
        assert!(error(&serde_json::to_string(&outside).unwrap()).contains("scene name `../../etc`"));
        assert!(
            Manifest::read(Path::new("/nowhere")).unwrap_err().to_string().contains("/nowhere/dataset.json")
        );
    }
}
